"""Why poses of robot and tracker that contradict each other may do so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.hand_eye_late import Late, Matched, told_late
from ronnaplan.robot.hand_eye_start import closed_form, discrepancies, which_are_far
from ronnaplan.robot.hand_eye_step import Step
from ronnaplan.robot.misread import mistake_in

LARGEST_ROTATION_DEG, LARGEST_TRANSLATION_MM = 3.0, 10.0
"""Poses of robot and tracker that are off by more (RMS) do not belong together: no tracker errs so much."""
LEFT_BY_A_DELAY = 0.5
"""A delay explains what is left where it leaves less than this share of it."""
SAME_ANGLES_DEG = 0.5
"""Poses of other moments are seldom off by less (RMS), a tracker's errors seldom by more."""


def agree(error: FloatArray) -> bool:
    """Tell whether poses of which ``error`` (N, 6), rad and mm, is left belong together."""
    rotation_deg, translation_mm = rms(error)
    return rotation_deg <= LARGEST_ROTATION_DEG and translation_mm <= LARGEST_TRANSLATION_MM


def rms(error: FloatArray) -> tuple[float, float]:
    """Return the angle in degrees and the length in mm, RMS, of an ``error`` (N, 6), rad and mm."""
    angle, length = np.sqrt((error.reshape(-1, 2, 3) ** 2).sum(axis=2).mean(axis=0))
    return float(np.degrees(angle)), float(length)


def _explains(late: Late, error: FloatArray) -> bool:
    """Tell whether poses of which ``error`` (N, 6) is left would agree if they were not ``late``."""
    left = late.fit.error
    return agree(left) and bool(np.less(np.divide(rms(left), rms(error)), LEFT_BY_A_DELAY).all())


def _belong_together(seen: FloatArray, driven: FloatArray) -> bool:
    """Tell it by the closed form, which there is of any poses (N, 4, 4), also of such as turn about one axis."""
    return agree(discrepancies(seen, driven, *closed_form(seen, driven)))


def contradiction(
    error: FloatArray, poses: Matched, far: NDArray[np.bool_], step: Step | None, late: Late | None
) -> str:
    """Say by how much ``poses`` contradict each other, and which of their frames do if without these none does.

    ``error`` (N, 6) is left of them, some may be ``far`` off (N,), a ``step`` be in them, the tracker's be ``late``.
    """
    seen, driven, frames, _ = poses
    rotation_deg, translation_mm = rms(error)
    said = (
        f"the poses of robot and tracker contradict each other by {rotation_deg:.2f} degrees and "
        f"{translation_mm:.2f} mm RMS, expected at most {LARGEST_ROTATION_DEG:g} and "
        f"{LARGEST_TRANSLATION_MM:g}"
    )
    if late and _explains(late, error):
        advice = "record both at the same moments, or stand still for each"
        return f"{said}, but would agree if {told_late(late.delay)}: {advice}"
    if far.any() and _belong_together(seen[~far], driven[~far]):
        which, advice = which_are_far(frames, np.flatnonzero(far).tolist())
        return f"{said}: {which}; {advice}"
    if step and all(_belong_together(a, b) for a, b in zip(*map(step.parts, (seen, driven)), strict=True)):
        return f"{said}: {step.told(frames)}"
    if misread := mistake_in(seen, driven, _belong_together):
        return (
            f"{said}, but agree if {misread}; check that they are tracker from tool and robot from TCP, and turn "
            "rotations into matrices, or a quaternion, anew"
        )
    if rotation_deg <= SAME_ANGLES_DEG:
        return (
            f"{said}: the angles agree, and the places do not; check columns, signs and units of the places in both, "
            "and the order of a quaternion's numbers"
        )
    return (
        f"{said}; record both at the same moments, as tracker from tool and robot from TCP, and check how their "
        "rotations were turned into matrices"
    )
