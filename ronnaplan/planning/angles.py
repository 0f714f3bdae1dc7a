"""Angles a surgeon sets: in the AC-PC frame, and on the arc and ring of a Leksell-style frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import LPS_FROM_RAS, FloatArray, unit
from ronnaplan.planning.landmarks import Landmarks

RAS_IN_LPS = np.diag(LPS_FROM_RAS)
"""Rows right, anterior, superior in LPS: the axes of a frame that sits square to the scanner."""


@dataclass(frozen=True)
class AcPcAngles:
    """A path in the AC-PC frame, seen from the target towards the entry.

    ``sagittal_deg``: projected on the midsagittal plane, from anterior (0) over superior (90) to posterior (180);
    ``coronal_deg``: projected on the coronal plane, from superior (0) to the patient's right (90), left negative.
    ``target_mm`` is the target's place (right, anterior, superior) from the mid-commissural point.
    """

    sagittal_deg: float
    coronal_deg: float
    target_mm: tuple[float, float, float]


@dataclass(frozen=True)
class ArcAngles:
    """Settings of a Leksell-style frame, mounted lateral right.

    ``arc_deg`` runs from the patient's right (0) over the midline plane (90) to the left (180); ``ring_deg`` from
    anterior (0) over superior (90) to posterior (180).
    """

    arc_deg: float
    ring_deg: float


def acpc_axes(landmarks: Landmarks) -> FloatArray:
    """Return right, anterior, superior of the AC-PC frame in LPS, as rows (3, 3).

    Anterior runs from PC to AC; right is the normal of the plane through AC, PC and the midline point. The
    midline point may lie on either side of the AC-PC line: superior is the side of the scanner's superior.
    """
    anterior = unit(landmarks.ac_mm - landmarks.pc_mm)
    across = landmarks.midline_mm - landmarks.pc_mm
    superior = unit(across - (across @ anterior) * anterior)
    if superior[2] < 0:
        superior = -superior
    return np.stack([np.cross(anterior, superior), anterior, superior])


def acpc_angles(landmarks: Landmarks, entry_mm: FloatArray, target_mm: FloatArray) -> AcPcAngles:
    """Return the angles of the path from ``target_mm`` (3,) out to ``entry_mm`` (3,)."""
    right, anterior, superior = acpc_axes(landmarks) @ (np.asarray(entry_mm) - target_mm)
    place = acpc_from_lps(landmarks, target_mm)
    return AcPcAngles(
        float(np.degrees(np.arctan2(superior, anterior))),
        float(np.degrees(np.arctan2(right, superior))),
        (float(place[0]), float(place[1]), float(place[2])),
    )


def acpc_from_lps(landmarks: Landmarks, place_mm: FloatArray) -> FloatArray:
    """Return how far right, anterior and superior (3,) of the mid-commissural point an LPS place (3,) lies."""
    place: FloatArray = acpc_axes(landmarks) @ (np.asarray(place_mm) - _middle_mm(landmarks))
    return place


def lps_from_acpc(landmarks: Landmarks, place_mm: FloatArray) -> FloatArray:
    """Return the LPS place (3,) that lies so far right, anterior and superior (3,) of the mid-commissural point."""
    place: FloatArray = acpc_axes(landmarks).T @ np.asarray(place_mm) + _middle_mm(landmarks)
    return place


def _middle_mm(landmarks: Landmarks) -> FloatArray:
    middle: FloatArray = (landmarks.ac_mm + landmarks.pc_mm) / 2
    return middle


def arc_angles(entry_mm: FloatArray, target_mm: FloatArray, axes: FloatArray = RAS_IN_LPS) -> ArcAngles:
    """Return arc and ring; rows of ``axes`` (3, 3) are the frame's right, anterior, superior in LPS."""
    right, anterior, superior = axes @ unit(np.asarray(entry_mm) - target_mm)
    return ArcAngles(
        float(np.degrees(np.arccos(np.clip(right, -1.0, 1.0)))),
        float(np.degrees(np.arctan2(superior, anterior))),
    )
