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
COPY_MM, COPY_TURN, COPY_AWAY_MM = 1.5, 0.3, 100.0
"""Three readings are three markers once more where they lie to each other as these do, to the first (five standard
deviations of a distance that a tracker tells), turned by less than the second (rad), and nearer than the third."""
MOST_COPIES = 1_000
"""So many pairs of a marker and another reading near it are compared with each other, in tens of milliseconds."""
MOST_SEEN = MOST_MARKERS + MOST_STRAYS
"""No tracker sees more in one frame; each is compared with each known marker."""


def labelled_frames(
    recording: Recording, reference: Points, *, sigma_mm: float = SIGMA_OTS_MM
) -> list[tuple[int, Points]]:
    """Return (frame number, markers seen) of each frame of ``recording``, with the labels of ``reference``.

    Each marker is followed from its reference position on. One that has two readings within `TWICE_MM`, of which
    either may be of before a movement, is not seen; nor is any where three are read once more elsewhere.
    ``sigma_mm`` is the error per axis of a reading that does not state its own. Raises `FrameMismatchError` for a
    recording in another frame, `InputError` for a reference of fewer than two markers and for more than `MOST_SEEN`
    readings in one frame.
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
        pairs = sorted(assigned(places, last, gate).items())
        pairs = [] if _is_copied(places, pairs) else [(i, j) for i, j in pairs if not is_doubled(places, i)]
        for i, j in pairs:
            last[j] = current[i].position_mm
        frames.append((number, _points(current, pairs, reference, sigma_mm)))
    return frames


def is_doubled(places_mm: FloatArray, number: int) -> bool:
    """Whether another of the readings (N, 3) lies beside that of a ``number``; the same place told again does not."""
    apart_mm = np.linalg.norm(places_mm - places_mm[number], axis=1)
    return bool(((apart_mm > 0.0) & (apart_mm < TWICE_MM)).any())


def are_read_twice(places_mm: FloatArray, last_mm: FloatArray) -> bool:
    """Whether readings (N, 3) tell markers, which were last at ``last_mm`` (M, 3), at two places each."""
    pairs = sorted(assigned(places_mm, last_mm, LARGEST_STEP_MM).items())
    return any(is_doubled(places_mm, i) for i, _ in pairs) or _is_copied(places_mm, pairs)


def _is_copied(places_mm: FloatArray, pairs: list[tuple[int, int]]) -> bool:
    """Whether three of the readings (N, 3) that are in no pair lie to each other as three do that are in one.

    Either may be of before a movement; the same places told again are no others. Of more than `MOST_COPIES` readings
    beside markers, each with each, nobody could tell: they are taken for copies.
    """
    from scipy.spatial.distance import cdist

    own = [i for i, _ in pairs]
    others = np.delete(places_mm, own, axis=0)
    if min(len(own), len(others)) < 3:
        return False
    away_mm = cdist(others, places_mm[own])
    told_again = (away_mm == 0.0).any(axis=1, keepdims=True)
    one, marker = np.nonzero((away_mm <= COPY_AWAY_MM) & ~told_again)
    if len(one) > MOST_COPIES:
        return True
    there, here = others[one], places_mm[own][marker]
    apart, copied, turned = (cdist(at, at) for at in (here, there, there - here))
    alike = (apart > 0.0) & (copied > 0.0) & (abs(apart - copied) < COPY_MM) & (turned < COPY_TURN * apart)
    two = alike.sum(axis=1) >= 2
    alike = alike[np.ix_(two, two)]
    both = alike.astype(np.float64)
    return bool((alike & (both @ both > 0.5)).any())


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
