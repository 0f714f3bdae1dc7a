"""Each tracker frame as labelled points, told by where known markers were: the input of the check for movement."""

from __future__ import annotations

import numpy as np

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray, Points, require_sigma
from ronnaplan.sigmas import SIGMA_OTS_MM
from ronnaplan.tracking.recording import PointReading, Recording
from ronnaplan.tracking.stray import MOST_MARKERS, MOST_STRAYS, assigned

LARGEST_STEP_MM = 20.0
"""A marker is not followed further than this between frames, nor than half the way to its nearest neighbour."""
TWICE_MM = 5.0
"""No two markers are so near to each other: one was read twice, or something beside it, and neither reading counts."""
MOST_SEEN = MOST_MARKERS + MOST_STRAYS
"""No tracker sees more in one frame; each is compared with each known marker."""


def labelled_frames(
    recording: Recording, reference: Points, *, sigma_mm: float = SIGMA_OTS_MM
) -> list[tuple[int, Points]]:
    """Return (frame number, markers seen) of each frame of ``recording``, with the labels of ``reference``.

    Each marker is followed from its reference position on. One that has two readings within `TWICE_MM`, of which
    either may be of before a movement, is not seen. ``sigma_mm`` is the error per axis of a reading that does not
    state its own. Raises `FrameMismatchError` for a recording in another frame, `InputError`
    for a reference of fewer than two markers and for more than `MOST_SEEN` readings in one frame.
    """
    from scipy.spatial.distance import pdist

    check_type(recording, Recording, "the recording", "read_recording returns one")
    check_type(reference, Points, "the reference", "give the points of what find_markers returned: found.points")
    require_sigma(sigma_mm, "the tracker error")
    reference.frame.require(recording.frame)
    if len(reference) < 2:
        raise InputError(f"{len(reference)} reference markers were given; expected the markers of a registration")
    gate = min(LARGEST_STEP_MM, 0.5 * float(pdist(reference.positions_mm).min()))
    last = reference.positions_mm.copy()
    by_frame: dict[int, list[PointReading]] = {r.frame: [] for r in recording.points}
    for reading in recording.points:
        if reading.usable:
            by_frame[reading.frame].append(reading)
    frames = []
    for number in sorted(by_frame):
        current = by_frame[number]
        if len(current) > MOST_SEEN:
            raise InputError(f"frame {number} holds {len(current)} readings; expected {MOST_SEEN} at most")
        places = np.array([r.position_mm for r in current]).reshape(-1, 3)
        pairs = [(i, j) for i, j in sorted(assigned(places, last, gate).items()) if not is_doubled(places, i)]
        for i, j in pairs:
            last[j] = current[i].position_mm
        frames.append((number, _points(current, pairs, reference, sigma_mm)))
    return frames


def is_doubled(places_mm: FloatArray, number: int) -> bool:
    """Whether another of the readings (N, 3) lies beside that of a ``number``; the same place told again does not."""
    apart_mm = np.linalg.norm(places_mm - places_mm[number], axis=1)
    return bool(((apart_mm > 0.0) & (apart_mm < TWICE_MM)).any())


def _points(
    current: list[PointReading], pairs: list[tuple[int, int]], reference: Points, sigma_mm: float
) -> Points:
    stated = [current[i].sigma_mm for i, _ in pairs]
    sds = [sigma_mm if one is None else one for one in stated]
    return Points(
        np.array([current[i].position_mm for i, _ in pairs]).reshape(-1, 3),
        np.array([sd**2 * np.eye(3) for sd in sds]).reshape(-1, 3, 3),
        tuple(reference.labels[j] for _, j in pairs),
        reference.frame,
    )
