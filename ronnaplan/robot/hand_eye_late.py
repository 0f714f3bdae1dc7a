"""Whether the tracker's poses, or the robot's, are late: by how many frames, and the poses of one moment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.pose import invert
from ronnaplan.robot.by_pose_fields import earlier, moving, within
from ronnaplan.robot.hand_eye_fit import Fit, refine
from ronnaplan.robot.hand_eye_start import FEWEST_TO_SHIFT, MUCH_BETTER

LATE_ROUNDS = 6
"""So often, at most, it is told how late poses are: 2 frames of a slow way are first taken for 1.74."""


class Matched(NamedTuple):
    """Poses of one moment: those ``seen`` and ``driven`` (N, 4, 4), their frames, and which of all poses they are."""

    seen: FloatArray
    driven: FloatArray
    frames: Sequence[int]
    rows: NDArray[np.intp]


class Late(NamedTuple):
    """The tracker's poses are so many ``frames`` late, or the robot's if these are negative."""

    frames: float
    poses: Matched
    """The robot's are of so much earlier."""
    fit: Fit
    """Of these."""


def how_late(fit: Fit, poses: Matched) -> Late | None:
    """Return how late the tracker's poses are, if that leaves far less than the ``fit`` of all ``poses`` as they are.

    It is told to first order about that fit, and then about the fit with the robot's poses of so much earlier, until no
    more is told; None, too, where that does not settle.
    """
    late, near, then = 0.0, fit, poses
    for _ in range(LATE_ROUNDS):
        if len(then.rows) < FEWEST_TO_SHIFT:
            return None
        more = _later(near, then)
        if more is None:
            return Late(late, then, near) if late else None
        late += more
        then = _matched(poses, late)
        near = refine(then.seen, then.driven, fit.left, fit.right)
    return None


def _matched(poses: Matched, late: float) -> Matched:
    """Return all ``poses`` with the robot's of so much earlier as the tracker's are late, where they were recorded."""
    rows = within(poses.frames, late)
    driven = earlier(poses.driven, late, poses.frames)
    return Matched(poses.seen[rows], driven[rows], [poses.frames[row] for row in rows], rows)


def told_late(frames: float) -> str:
    """Say whose poses are late where the tracker's are by so many ``frames``."""
    return f"{'the tracker' if frames > 0 else 'the robot'}'s poses are {abs(frames):.3f} frames late"


def _later(fit: Fit, poses: Matched) -> float | None:
    """Return by how many frames the tracker's are late, to first order about a fit; None if it leaves about as much.

    All else that is sought changes with it, which of a few poses leaves little of any.
    """
    error, design = fit.error, fit.design * fit.sds[:, None]
    sds = np.repeat(np.sqrt((error.reshape(-1, 2, 3) ** 2).mean(axis=(0, 2))), 3)
    late, unit = moving(poses.driven @ invert(fit.right), sds, poses.frames)
    columns = np.concatenate([design / sds[:, None], late], axis=2).reshape(error.size, -1)
    solution = np.linalg.lstsq(columns, (error / sds).ravel(), rcond=None)[0]
    left = (error / sds).ravel() - columns @ solution
    return None if np.sqrt((left**2).mean()) > MUCH_BETTER else float(solution[design.shape[2]] * unit)
