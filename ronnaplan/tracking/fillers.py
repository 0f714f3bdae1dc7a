"""Places that programs fill in for a marker that is not seen, such as 0, 0, 0: no reading, and nothing says so."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.tracking.recording import Recording
from ronnaplan.tracking.stray import GATE_MM


def flag_fillers(recording: Recording) -> Recording:
    """Flag readings whose three coordinates are one number, told more than once, where their marker stands elsewhere.

    Without names, those that stand more than once in a frame, or for others in some: a marker may be the origin, and
    may itself be hidden at times.
    """
    places_mm = np.array([one.position_mm for one in recording.points]).reshape(-1, 3)
    alike = np.ptp(places_mm, axis=1) == 0.0
    if not alike.any():
        return recording
    found: dict[tuple[str, float], list[int]] = defaultdict(list)
    others: dict[str, list[int]] = defaultdict(list)
    points = list(recording.points)
    for k in np.flatnonzero(np.isfinite(places_mm).all(axis=1)).tolist():
        if alike[k]:
            found[points[k].label, float(places_mm[k, 0])].append(k)
        else:
            others[points[k].label].append(k)
    middles_mm = {label: np.median(places_mm[of_one], axis=0) for label, of_one in others.items()}
    sizes = Counter(one.frame for one in points)
    frames_of_size = Counter(sizes.values())
    for (label, value), alike_ones in found.items():
        if len(alike_ones) < 2:
            continue
        if label:
            is_filler = label in middles_mm and _is_elsewhere(middles_mm[label], value)
        else:
            is_filler = _stands_for_others([points[k].frame for k in alike_ones], sizes, frames_of_size)
        told = f"{value:g}, {value:g}, {value:g}, as is filled in for a marker that is not seen"
        for k in alike_ones if is_filler else ():
            points[k] = replace(points[k], status=told) if points[k].usable else points[k]
    return replace(recording, points=tuple(points))


def _is_elsewhere(middle_mm: FloatArray, value: float) -> bool:
    """Whether the middle (3,) of a marker's other readings lies beside the place (value, value, value)."""
    return bool(np.linalg.norm(middle_mm - value) > 2 * GATE_MM)


def _stands_for_others(frames: Sequence[int], sizes: Mapping[int, int], frames_of_size: Mapping[int, int]) -> bool:
    """Whether one place without a name, read in ``frames``, is more than once in one, or takes the place of others.

    It does where it is not in each frame, unless the others are as many with it as without: then it is a marker that
    is hidden at times. ``sizes`` are the readings of each frame, ``frames_of_size`` the frames that have as many.
    """
    within = set(frames)
    if len(within) < len(frames):
        return True
    with_it = Counter(sizes[frame] for frame in within)
    without_it = {size for size, count in frames_of_size.items() if count > with_it[size]}
    return bool(without_it) and {size - 1 for size in with_it} != without_it
