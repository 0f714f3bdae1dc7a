"""Has the patient, or one marker, moved since the registration? A test of later readings against the first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray, Points
from ronnaplan.registration.movement import explain_movement
from ronnaplan.registration.registration import register_points
from ronnaplan.rigid import spans_a_plane

DRIFT_PROBABILITY = 1e-6
"""A displacement rarer than this by the markers' errors alone is a movement. Small, as every frame is tested."""
SHARE_OF_ALL = 0.1
"""Of the false alarms so many come from the sum of all displacements, the others from the largest: a body that moves
shows in every marker, a marker by itself in one only."""
SUSPECT_PROBABILITY = 0.01
"""Where a marker moved by itself, every one that is this likely to be it is named."""


class DriftStatus(StrEnum):
    """What later readings tell about the markers of a registration."""

    STILL = "nothing moved"
    PATIENT_MOVED = "all markers moved together: the patient or the tracker moved; register again"
    MARKER_MOVED = "the markers moved against each other: a marker is loose; do not trust the registration"
    TOO_FEW = "no three markers off one line are seen, so a movement cannot be told"


@dataclass(frozen=True)
class Drift:
    """Comparison of one later reading with the reference reading."""

    status: DriftStatus
    probability: float
    """At most so likely do resting markers with the stated errors differ by this much; NaN if too few are seen."""
    rotation_deg: float
    shift_mm: float
    """Displacement of the markers' centroid."""
    largest_mm: float
    """Largest displacement of a marker."""
    together: float
    """If anything moved: the probability that all markers moved as one; else NaN."""
    loose: tuple[str, ...]
    """If a marker moved by itself: which may be it (or, where several did, them), likeliest first."""
    missing: tuple[str, ...]
    """Markers of the reference that this reading lacks."""


def check_drift(reference: Points, later: Points) -> Drift:
    """Compare ``later`` with ``reference``, the markers (same frame, same labels) as they were registered.

    Raises `FrameMismatchError` for readings of another frame, `InputError` where two markers have one label, and
    `UsageError` for what is no `Points`.
    """
    for points, what in ((reference, "the reference"), (later, "the later reading")):
        check_type(points, Points, what, "give the points of what find_markers returned: found.points")
    reference.frame.require(later.frame)
    for labels in (reference.labels, later.labels):
        if len(set(labels)) < len(labels):
            told = ", ".join(labels)
            raise InputError(f"readings are labelled {told}; expected another label for each, name them apart")
    then = {label: i for i, label in enumerate(reference.labels)}
    shared = [(then[label], i) for i, label in enumerate(later.labels) if label in then]
    missing = tuple(label for label in reference.labels if label not in later.labels)
    before, after = np.array(shared, dtype=np.intp).reshape(-1, 2).T
    places = (reference.positions_mm[before], later.positions_mm[after])
    if len(shared) < 3 or not all(spans_a_plane(seen) for seen in places):
        return Drift(DriftStatus.TOO_FEW, np.nan, np.nan, np.nan, np.nan, np.nan, (), missing)
    errors = (reference.covariances_mm2[before], later.covariances_mm2[after])
    moved = places[1] - places[0]
    probability = _chance(moved, errors[0] + errors[1])
    motion = register_points(*places, errors)
    status, together, suspects = _judge(probability, places, errors)
    return Drift(
        status,
        probability,
        motion.pose.turn_deg,
        float(np.linalg.norm(moved.mean(axis=0))),
        float(np.linalg.norm(moved, axis=1).max()),
        together,
        tuple(reference.labels[before[i]] for i in suspects),
        missing,
    )


def drift_over_time(reference: Points, frames: Iterable[Points]) -> list[Drift]:
    """Return the `Drift` of each of ``frames`` against ``reference``; raises what `check_drift` does."""
    check_type(frames, Iterable, "the later frames", "labelled_frames(recording) gives some")
    return [check_drift(reference, frame) for frame in frames]


def _chance(moved_mm: FloatArray, covariances_mm2: FloatArray) -> float:
    """Bound the chance of displacements (N, 3) like these or rarer, all taken together or the largest by itself.

    Two questions are asked of a reading, the second of every marker, so each gets its share (Bonferroni; see
    `SHARE_OF_ALL`).
    """
    from scipy.special import gammaincc

    try:
        whitened = np.linalg.solve(covariances_mm2, moved_mm[..., None])[..., 0]
    except np.linalg.LinAlgError as error:
        raise InputError("a marker's covariance is singular; a drift check needs the readings' errors") from error
    squares = (whitened * moved_mm).sum(axis=-1)
    of_all = gammaincc(moved_mm.size / 2, squares.sum() / 2)
    of_one = gammaincc(3 / 2, squares.max() / 2)
    return float(min(1.0, of_all / SHARE_OF_ALL, len(moved_mm) * of_one / (1 - SHARE_OF_ALL)))


def _judge(
    probability: float, places_mm: tuple[FloatArray, FloatArray], errors_mm2: tuple[FloatArray, FloatArray]
) -> tuple[DriftStatus, float, NDArray[np.intp]]:
    """Return what moved, the probability that all did as one, and the rows that may have moved by themselves."""
    nobody = np.zeros(0, dtype=np.intp)
    if probability >= DRIFT_PROBABILITY:
        return DriftStatus.STILL, np.nan, nobody
    explained = explain_movement(*places_mm, *errors_mm2)
    if explained.together > 1 - explained.together:
        return DriftStatus.PATIENT_MOVED, explained.together, nobody
    likeliest = np.argsort(-explained.loose)
    suspects = likeliest[explained.loose[likeliest] >= SUSPECT_PROBABILITY]
    return DriftStatus.MARKER_MOVED, explained.together, suspects
