"""Whether the tracker's poses, or the robot's, are late: by how many frames, and the poses of one moment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.between_frames import earlier, moving, within
from ronnaplan.robot.hand_eye_fit import Fit, refine
from ronnaplan.robot.hand_eye_start import FEWEST_TO_SHIFT, MUCH_BETTER, rms_per_axis
from ronnaplan.transforms import invert

LATE_ROUNDS = 6
"""So often, at most, it is told how late poses are: 2 frames of a slow way are first taken for 1.74."""


class Matched(NamedTuple):
    """Poses of one moment: those ``seen`` and ``driven`` (N, 4, 4), their frames, and which of all poses they are."""

    seen: FloatArray
    driven: FloatArray
    frames: Sequence[int]
    rows: NDArray[np.intp]


class Late(NamedTuple):
    """The tracker's poses are late, or the robot's."""

    delay: float
    """Of the tracker's, in frames; negative where the robot's are late."""
    poses: Matched
    """The robot's are of so much earlier."""
    fit: Fit
    """Of these."""


def how_late(fit: Fit, poses: Matched) -> Late | None:
    """Return how late the tracker's poses are, if that leaves far less than the ``fit`` of all ``poses`` as they are.

    It is told to first order about that fit, and then about the fit with the robot's poses of so much earlier, until no
    more is told; None, too, where that does not settle.
    """
    delay, near, then = 0.0, fit, poses
    for _ in range(LATE_ROUNDS):
        if len(then.rows) < FEWEST_TO_SHIFT:
            return None
        more = _later(near, then)
        if more is None:
            return Late(delay, then, near) if delay else None
        delay += more
        then = _matched(poses, delay)
        near = refine(then.seen, then.driven, fit.left, fit.right)
    return None


def _matched(poses: Matched, delay: float) -> Matched:
    """Return all ``poses`` with the robot's of so much earlier as the tracker's are late, where they were recorded."""
    rows = within(poses.frames, delay)
    driven = earlier(poses.driven, delay, poses.frames)
    return Matched(poses.seen[rows], driven[rows], [poses.frames[row] for row in rows], rows)


def told_late(delay: float) -> str:
    """Say whose poses are late where the tracker's are by a ``delay`` in frames."""
    return f"{'the tracker' if delay > 0 else 'the robot'}'s poses are {abs(delay):.3f} frames late"


def _later(fit: Fit, poses: Matched) -> float | None:
    """Return by how many frames the tracker's are late, to first order about a fit; None if it leaves about as much.

    All else that is sought changes with it, which of a few poses leaves little of any.
    """
    error, design = fit.error, fit.design * fit.sds[:, None]
    sds = rms_per_axis(error)
    if not sds.all():  # angles or places are exact, of which nothing is left to explain
        return None
    late, unit = moving(poses.driven @ invert(fit.right), sds, poses.frames)
    columns = np.concatenate([design / sds[:, None], late], axis=2).reshape(error.size, -1)
    solution = np.linalg.lstsq(columns, (error / sds).ravel(), rcond=None)[0]
    left = (error / sds).ravel() - columns @ solution
    return None if np.sqrt((left**2).mean()) > MUCH_BETTER else float(solution[design.shape[2]] * unit)
