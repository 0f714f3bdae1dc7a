"""Whether a trajectory lies on the side that its name tells: a slip of the name, or of LPS and RAS."""

from __future__ import annotations

import re

import numpy as np

from ronnaplan.planning.angles import RAS_IN_LPS, acpc_axes
from ronnaplan.planning.head import Head
from ronnaplan.planning.landmarks import Landmarks
from ronnaplan.planning.trajectory import Trajectory

NAMED = re.compile(r"(?<![a-z])(left|right)(?![a-z])", re.IGNORECASE)
"""The words that tell a side; a letter alone does not, for electrodes are called so."""

CLEARLY_MM = 10.0
"""A path whose ends stay nearer than this to the middle lies on no side for certain: heads lie askew in scanners."""


def side_doubt(trajectory: Trajectory, head: Head, landmarks: Landmarks | None) -> str | None:
    """Return what is wrong where the name tells one side and both ends lie on the other; None where nothing is.

    The middle is the midsagittal plane of ``landmarks``, or without them the scanner's sagittal plane through the
    head's centroid.
    """
    named = {word.lower() for word in NAMED.findall(trajectory.name)}
    if len(named) != 1:
        return None
    if landmarks is None:
        to_right, middle_mm, what = RAS_IN_LPS[0], head.center_mm, "the middle of the head"
    else:
        to_right, middle_mm, what = acpc_axes(landmarks)[0], landmarks.ac_mm, "the midsagittal plane"
    (side,) = named
    other, beyond = ("right", to_right) if side == "left" else ("left", -to_right)
    entry, target = (np.stack([trajectory.entry_mm, trajectory.target_mm]) - middle_mm) @ beyond
    if min(entry, target) <= 0.0 or max(entry, target) < CLEARLY_MM:
        return None
    return (
        f"it is named {side} but lies on the patient's {other} side, its entry {entry:.0f} and its target "
        f"{target:.0f} mm from {what}; check the name and the coordinates (LPS or RAS?)"
    )
