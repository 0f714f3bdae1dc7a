"""Has the patient, or one marker, moved since the registration? A test of later readings against the first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, Points
from ronnaplan.registration.diagnosis import Doubt, doubted_marker
from ronnaplan.registration.registration import Registration, register_points

DRIFT_PROBABILITY = 1e-6
"""A displacement rarer than this by the markers' errors alone is a movement. Small, as every frame is tested."""


class DriftStatus(StrEnum):
    """What later readings tell about the markers of a registration."""

    STILL = "nothing moved"
    PATIENT_MOVED = "all markers moved together: the patient or the tracker moved; register again"
    MARKER_MOVED = "the markers moved against each other: a marker is loose; do not trust the registration"
    TOO_FEW = "fewer than three of the markers are seen, so a movement cannot be told"


@dataclass(frozen=True)
class Drift:
    """Comparison of one later reading with the reference reading."""

    status: DriftStatus
    probability: float
    """Chance that resting markers with the stated errors differ by this much or more; NaN if too few are seen."""
    rotation_deg: float
    shift_mm: float
    """Displacement of the markers' centroid."""
    largest_mm: float
    """Largest displacement of a marker."""
    doubt: Doubt | None
    """The marker that moved against the others, where one can be told."""
    missing: tuple[str, ...]
    """Markers of the reference that this reading lacks."""


def check_drift(reference: Points, later: Points) -> Drift:
    """Compare ``later`` with ``reference``, the markers (same frame, same labels) as they were registered.

    Raises `FrameMismatchError` for readings of another frame.
    """
    reference.frame.require(later.frame)
    then = {label: i for i, label in enumerate(reference.labels)}
    shared = [(then[label], i) for i, label in enumerate(later.labels) if label in then]
    missing = tuple(label for label in reference.labels if label not in later.labels)
    if len(shared) < 3:
        return Drift(DriftStatus.TOO_FEW, np.nan, np.nan, np.nan, np.nan, None, missing)
    before, after = (np.array(index) for index in zip(*shared, strict=True))
    moved = later.positions_mm[after] - reference.positions_mm[before]
    covariance = later.covariances_mm2[after] + reference.covariances_mm2[before]
    probability = _chance(moved, covariance)
    motion = register_points(
        reference.positions_mm[before],
        later.positions_mm[after],
        (reference.covariances_mm2[before], later.covariances_mm2[after]),
        labels=[reference.labels[i] for i in before],
    )
    return Drift(
        _judge(probability, motion),
        probability,
        _angle_deg(motion.pose.rotation),
        float(np.linalg.norm(moved.mean(axis=0))),
        float(np.linalg.norm(moved, axis=1).max()),
        doubted_marker(motion),
        missing,
    )


def drift_over_time(reference: Points, frames: Iterable[Points]) -> list[Drift]:
    """Return the `Drift` of each of ``frames`` against ``reference``."""
    return [check_drift(reference, frame) for frame in frames]


def _chance(moved_mm: FloatArray, covariances_mm2: FloatArray) -> float:
    from scipy.special import gammaincc

    try:
        whitened = np.linalg.solve(covariances_mm2, moved_mm[..., None])[..., 0]
    except np.linalg.LinAlgError as error:
        raise InputError("a marker's covariance is singular; a drift check needs the readings' errors") from error
    return float(gammaincc(moved_mm.size / 2, float((whitened * moved_mm).sum()) / 2))


def _judge(probability: float, motion: Registration) -> DriftStatus:
    if probability >= DRIFT_PROBABILITY:
        return DriftStatus.STILL
    fit = motion.fit_probability
    rigid = fit is not None and fit >= DRIFT_PROBABILITY
    return DriftStatus.PATIENT_MOVED if rigid else DriftStatus.MARKER_MOVED


def _angle_deg(rotation: FloatArray) -> float:
    from scipy.spatial.transform import Rotation

    return float(np.degrees(Rotation.from_matrix(rotation).magnitude()))
