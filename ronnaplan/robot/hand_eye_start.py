"""Where a hand-eye calibration starts: Shah's closed form, and which poses are far off, or all of other moments.

The closed form (2013, J. Mech. Robot. 5:031007) is that of least squares, so that a few wrong poses turn it towards
them, and right ones then look as wrong. Which poses are far off is therefore told from the least sum of the lengths
that poses leave, as a pivot's slips are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.pivot import FEWEST_FOR_SCATTER
from ronnaplan.robot.scatter import MOST_WRONG, robust_sd, too_long_for_direction
from ronnaplan.robot.twists import apart
from ronnaplan.text import listed, runs
from ronnaplan.transforms import invert, nearest_rotations, rigid

FINEST = (1e-9, 1e-6)
"""No tracker errs less, in rad and mm; poses without errors are taken to err by so much."""
FEWEST_TO_SHIFT, MUCH_BETTER = 20, 0.8
"""Of so many poses those of the robot are tried one earlier and one later. Where they move little from one to the next
it changes nothing; where it makes the angles left smaller than this share, they are not of the same moments."""
ROUNDS, SETTLED = 50, 1e-3
"""So many rounds weigh the poses anew, or until no weight changes by more than this part of the largest."""


def closed_form(
    seen: FloatArray, driven: FloatArray, weight: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return ``robot_from_ots`` and ``m_from_tcp`` (4, 4): rotations from a Kronecker sum, then translations.

    Poses (N, 4, 4) count by ``weight`` (N,), alike where none is given.
    """
    share = np.ones(len(seen)) if weight is None else weight
    kronecker = np.einsum("n,nij,nkl->ikjl", share, driven[:, :3, :3], seen[:, :3, :3]).reshape(9, 9)
    u, _, vt = np.linalg.svd(kronecker)
    either = np.array([u[:, 0], vt[0]]).reshape(2, 3, 3)  # of either sign
    left, back = nearest_rotations(either * np.sign(np.linalg.det(either))[:, None, None])
    right = back.T
    design = np.concatenate([np.broadcast_to(np.eye(3), (len(seen), 3, 3)), left @ seen[:, :3, :3]], axis=2)
    goal = driven[:, :3, 3] - seen[:, :3, 3] @ left.T
    root = np.sqrt(share)[:, None]
    shifts = np.linalg.lstsq((root[:, None] * design).reshape(-1, 6), (root * goal).ravel(), rcond=None)[0]
    return rigid(left, shifts[:3]), rigid(right, shifts[3:])


def discrepancies(seen: FloatArray, driven: FloatArray, left: FloatArray, right: FloatArray) -> FloatArray:
    """Return (N, 6): rotation vectors and places that R from OTS ``left`` and M from TCP ``right`` leave at M."""
    return apart(seen, invert(left) @ driven @ invert(right))


def rms_per_axis(error: FloatArray) -> FloatArray:
    """Return (6,): the RMS per axis of an ``error`` (N, 6), that of rotations thrice, then that of places."""
    return np.asarray(np.repeat(np.sqrt((error.reshape(-1, 2, 3) ** 2).mean(axis=(0, 2))), 3))


def far_off(seen: FloatArray, driven: FloatArray) -> NDArray[np.bool_]:
    """Return which poses (N,) leave more, in angle or place, than is usual, of a few none.

    That is by how both scatter in each direction, of the tool or of the tracker.
    """
    if len(seen) < FEWEST_FOR_SCATTER:
        return np.zeros(len(seen), dtype=bool)
    in_tool = _left(seen, driven)
    in_tracker = in_tool @ seen[:, :3, :3].swapaxes(1, 2)
    usual = np.ones(len(seen), dtype=bool)
    of_each = [
        too_long_for_direction((in_tool[:, n], in_tracker[:, n]), least, usual) for n, least in enumerate(FINEST)
    ]
    return np.asarray(np.any(of_each, axis=0))


def which_are_far(frames: Sequence[int], far: Sequence[int]) -> tuple[str, str]:
    """Say which of the poses of ``frames`` (N,) are ``far`` off, and what to do about it."""
    named = listed(runs(frames, far))
    told = f"{len(far)} of {len(frames)} poses are far off what the others say (frames {named})"
    looked = "look whether the tool was hidden or moved there, and "
    if len(far) > MOST_WRONG * len(frames):
        return told, looked + "record anew: of so many it is not sure that they are wrong, and not the others"
    return told, looked + "leave them out of the recording"


def out_of_step(seen: FloatArray, driven: FloatArray, left: FloatArray, right: FloatArray) -> bool:
    """Tell whether poses (N, 4, 4) in the order of recording fit far better one earlier, or one later.

    ``left`` and ``right`` are R from OTS and M from TCP, their closed form as they are.
    """
    if len(seen) < FEWEST_TO_SHIFT:
        return False
    shifted = ((seen[1:], driven[:-1]), (seen[:-1], driven[1:]))
    left_by_others = (_angle_left(a, b, *closed_form(a, b)) for a, b in shifted)
    return min(left_by_others) < MUCH_BETTER * _angle_left(seen, driven, left, right)


def _left(seen: FloatArray, driven: FloatArray) -> FloatArray:
    """Return turns and shifts (N, 2, 3) that poses leave where their lengths, by what is usual, have the least sum."""
    weight = np.ones(len(seen))
    for _ in range(ROUNDS):
        error: FloatArray = discrepancies(seen, driven, *closed_form(seen, driven, weight)).reshape(-1, 2, 3)
        lengths = np.asarray(np.linalg.norm(error, axis=2))
        usual = [robust_sd(one, least) for one, least in zip(lengths.T, FINEST, strict=True)]
        # a length below the usual one counts as that: least squares among those that are right
        before, weight = weight, 1 / np.maximum((lengths / usual).max(axis=1), 1.0)
        if np.abs(weight - before).max() < SETTLED:
            break
    return error


def _angle_left(seen: FloatArray, driven: FloatArray, left: FloatArray, right: FloatArray) -> float:
    """Return the angle, in rad RMS, that R from OTS ``left`` and M from TCP ``right`` leave between poses."""
    error = discrepancies(seen, driven, left, right)
    return float(np.sqrt((error[:, :3] ** 2).sum(axis=1).mean()))
