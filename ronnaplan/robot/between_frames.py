"""How fast what is recorded moves, and where it was between the frames of its recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.twists import apart
from ronnaplan.transforms import exponential

TELL_BETWEEN = 4
"""So many poses beside each tell where it was between frames: of two, half a frame along a swift way errs by more than
poses do."""


def moving(robot_from_m: FloatArray, sds: FloatArray, frames: Sequence[int]) -> tuple[FloatArray, float]:
    """Return (N, 6, 2): what a delay, and half of its square, add to poses; and the delay that adds one, RMS.

    Both are told by the nearest two poses, as ``frames`` (N,) number them.
    """
    times, others = _nearest(frames, 2)
    before, after = (times[others] - times[:, None]).T[..., None]
    first, second = (apart(robot_from_m, robot_from_m[other]) for other in others.T)
    nodes = before * after * (after - before)
    speed = (first * after**2 - second * before**2) / nodes
    gain = 2 * (second * before - first * after) / nodes
    gain[:, 3:] -= 2 * np.cross(speed[:, :3], speed[:, 3:])
    added = np.stack([speed, -gain], axis=2) / sds[:, None]
    unit = 1 / max(float(np.sqrt((added[..., 0] ** 2).mean())), np.finfo(float).tiny)
    return added * [unit, unit**2 / 2], unit


def earlier(poses: FloatArray, delay: float, frames: Sequence[int]) -> FloatArray:
    """Return ``poses`` (N, 4, 4), which ``frames`` (N,) number, as they were by a ``delay`` in frames earlier.

    Between frames they go as the polynomial through each and the nearest `TELL_BETWEEN` others does.
    """
    times, others = _nearest(frames, min(TELL_BETWEEN, len(frames) - 1))
    nodes = times[others] - times[:, None]
    ahead = np.zeros((len(poses), 6))
    for at, other in enumerate(others.T):
        rest = np.delete(nodes, at, axis=1)
        share = -delay / nodes[:, at] * ((-delay - rest) / (nodes[:, [at]] - rest)).prod(axis=1)
        ahead += share[:, None] * apart(poses, poses[other])
    then = poses.copy()
    then[:, :3, :3] = poses[:, :3, :3] @ exponential(ahead[:, :3])
    then[:, :3, 3] += (poses[:, :3, :3] @ ahead[:, 3:, None])[..., 0]
    return then


def within(frames: Sequence[int], delay: float) -> NDArray[np.intp]:
    """Return which of ``frames`` (N,) are later, by a ``delay`` in frames, than some of the recording, or earlier."""
    times = _times(frames)
    then = times - delay
    inside: NDArray[np.intp] = np.flatnonzero((then >= times.min()) & (then <= times.max()))
    return inside


def _times(frames: Sequence[int]) -> FloatArray:
    """Return ``frames`` (N,) from the first on: time stamps have more digits than a float."""
    numbers = np.asarray(frames, dtype=object)
    return np.asarray(numbers - numbers[0], dtype=np.float64)


def _nearest(frames: Sequence[int], neighbours: int) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the times (N,) of ``frames`` (N,), from the first, and which (N, k) poses lie next to each."""
    times, count = _times(frames), len(frames)
    first = np.clip(np.arange(count) - neighbours // 2, 0, count - 1 - neighbours)
    nearest = first[:, None] + np.arange(neighbours + 1)
    return times, nearest[nearest != np.arange(count)[:, None]].reshape(count, neighbours)
