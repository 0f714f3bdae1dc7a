"""Places that programs fill in for a marker that is not seen, such as 0, 0, 0: no reading, and nothing says so."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.tracking.recording import Recording
from ronnaplan.tracking.stray import GATE_MM


def flag_fillers(recording: Recording) -> Recording:
    """Flag readings whose three coordinates are one number, told more than once, where their marker stands elsewhere.

    Without names, those that stand more than once in a frame, or not in each: a marker may be the origin.
    """
    places_mm = np.array([one.position_mm for one in recording.points]).reshape(-1, 3)
    alike = np.ptp(places_mm, axis=1) == 0.0
    if not alike.any():
        return recording
    labels = np.array([one.label for one in recording.points])
    frames = np.array([one.frame for one in recording.points])
    points = list(recording.points)
    for label, value in {*zip(labels[alike].tolist(), places_mm[alike, 0].tolist(), strict=True)}:
        of_one = labels == label
        found = np.flatnonzero(of_one & alike & (places_mm[:, 0] == value))
        others_mm = places_mm[of_one & ~alike & np.isfinite(places_mm).all(axis=1)]
        if len(found) > 1 and (_is_elsewhere(others_mm, value) if label else _is_no_marker(found, frames)):
            told = f"{value:g}, {value:g}, {value:g}, as is filled in for a marker that is not seen"
            for k in found.tolist():
                points[k] = replace(points[k], status=told) if points[k].usable else points[k]
    return replace(recording, points=tuple(points))


def _is_elsewhere(others_mm: NDArray[np.float64], value: float) -> bool:
    """Whether a marker's other readings (N, 3) lie beside the place (value, value, value)."""
    return len(others_mm) > 0 and bool(np.linalg.norm(np.median(others_mm, axis=0) - value) > 2 * GATE_MM)


def _is_no_marker(found: NDArray[np.intp], frames: NDArray[np.intp]) -> bool:
    """Whether the readings without a name that were ``found`` at one place are not one in each of the ``frames``."""
    counts = Counter(frames[found].tolist())
    return max(counts.values()) > 1 or len(counts) < len(set(frames.tolist()))
