"""Has anything moved since the registration, and what: all markers together, or one by itself."""

from collections.abc import Iterator

import numpy as np
import pytest

from ronnaplan.errors import FrameMismatchError, InputError, UsageError
from ronnaplan.geometry import Frame, Points
from ronnaplan.registration import DriftStatus, check_drift
from ronnaplan.registration.drift import DRIFT_PROBABILITY, drift_over_time
from ronnaplan.transforms import exponential
from tests.long import few_and_others, few_or_all

HEAD = np.array([[-60.0, 20, 40], [55, 30, 50], [5, -85, 60], [-20, 60, 75], [30, -10, 95], [-70, -30, 10]])
LABELS = ("F1", "F2", "F3", "F4", "F5", "F6")
TRACKER_SD = 0.17


def reading(
    positions: np.ndarray, labels: tuple[str, ...] = LABELS, frame: str = "OTS", sd: float = 0.1
) -> Points:
    return Points(positions, np.tile(sd**2 * np.eye(3), (len(positions), 1, 1)), labels, Frame(frame))


def heads(seed: int, count: int, cases: int) -> Iterator[tuple[np.random.Generator, Points, np.ndarray]]:
    """Random layouts of ``count`` markers on a head: their first reading, and a second before anything is moved."""
    rng = np.random.default_rng(seed)
    for _ in range(cases):
        places = 80 * unit_vectors(rng, count) * (1, 1, 0.6)
        first, second = (places + TRACKER_SD * rng.normal(size=places.shape) for _ in range(2))
        yield rng, reading(first, LABELS[:count], sd=TRACKER_SD), second


def unit_vectors(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    found: np.ndarray = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return found


@few_or_all("count", 100, 250)
def test_noise_alone_is_no_drift(count: int) -> None:
    rng = np.random.default_rng(4)
    frames = [reading(HEAD + 0.1 * rng.normal(size=HEAD.shape)) for _ in range(count)]
    reference = reading(HEAD + 0.1 * rng.normal(size=HEAD.shape))
    drifts = drift_over_time(reference, frames)
    assert {drift.status for drift in drifts} == {DriftStatus.STILL}
    assert min(drift.probability for drift in drifts) < 0.05  # and the test is not blind


def test_a_moved_patient_is_told_with_the_motion() -> None:
    rng = np.random.default_rng(5)
    turn = exponential(np.radians([0.0, 0.0, 1.0]))
    center = HEAD.mean(axis=0)
    moved = (HEAD - center) @ turn.T + center + (1.0, 0, 0)
    drift = check_drift(reading(HEAD), reading(moved + 0.1 * rng.normal(size=HEAD.shape)))
    assert drift.status is DriftStatus.PATIENT_MOVED
    assert drift.rotation_deg == pytest.approx(1.0, abs=0.2)
    assert drift.shift_mm == pytest.approx(1.0, abs=0.15)
    assert drift.together > 0.99
    assert drift.loose == ()


def test_a_loose_marker_is_told_from_a_moved_patient_in_any_order_of_labels() -> None:
    moved = HEAD.copy()
    moved[2] += (0, 1.5, 1.5)
    order = [3, 2, 5, 0, 4, 1]
    drift = check_drift(reading(HEAD), reading(moved[order], tuple(LABELS[i] for i in order)))
    assert drift.status is DriftStatus.MARKER_MOVED
    assert drift.loose == ("F3",)
    assert drift.largest_mm == pytest.approx(np.hypot(1.5, 1.5))


def test_hidden_markers_are_listed_and_too_few_are_said() -> None:
    drift = check_drift(reading(HEAD), reading(HEAD[:2], LABELS[:2]))
    assert drift.status is DriftStatus.TOO_FEW
    assert drift.missing == ("F3", "F4", "F5", "F6")


def test_of_markers_on_one_line_nothing_is_told() -> None:
    """Whatever turns about it; a reading of no others was an error, which ended the comparison of all later ones."""
    row = np.array([[-60.0, 0, 0], [0, 0, 0], [70, 0, 0], [0, 80, 30]])
    line = reading(row[:3], LABELS[:3])
    first, other = drift_over_time(reading(row, LABELS[:4]), [line, reading(row, LABELS[:4])])
    assert first.status is DriftStatus.TOO_FEW
    assert other.status is DriftStatus.STILL


def test_two_markers_of_one_label_are_refused() -> None:
    """A marker was said to be loose: each was held against the last of its label."""
    twice = reading(HEAD, ("F1", "F1", *LABELS[2:]))
    for first, second in ((twice, twice), (reading(HEAD), twice)):
        with pytest.raises(InputError, match=r"F1, F1, .*another label for each"):
            check_drift(first, second)


def test_readings_of_another_frame_are_refused() -> None:
    with pytest.raises(FrameMismatchError):
        check_drift(reading(HEAD), reading(HEAD, frame="R"))


@few_and_others("count", [4], [6])
def test_two_millimetres_of_one_marker_are_not_taken_for_the_patient(count: int) -> None:
    """A rigid fit of all markers would absorb much of it; the resting ones tell otherwise."""
    for rng, reference, places in heads(count, count, 60):
        places[0] += 2 * unit_vectors(rng, 1)[0]
        drift = check_drift(reference, reading(places, LABELS[:count], sd=TRACKER_SD))
        assert drift.status in (
            DriftStatus.MARKER_MOVED,
            DriftStatus.STILL,
        )  # chance hides a few below one in a million
        assert drift.status is DriftStatus.STILL or "F1" in drift.loose


def test_a_moved_head_is_not_taken_for_a_loose_marker() -> None:
    for rng, reference, places in heads(9, 5, 60):
        turn = exponential(np.radians(rng.choice([0.0, 1.0, 5.0])) * unit_vectors(rng, 1)[0])
        moved = places @ turn.T + rng.choice([2.0, 20.0]) * unit_vectors(rng, 1)[0]
        drift = check_drift(reference, reading(moved, LABELS[:5], sd=TRACKER_SD))
        assert drift.status is DriftStatus.PATIENT_MOVED


def test_two_loose_markers_are_both_named() -> None:
    for rng, reference, places in heads(10, 6, 30):
        places[:2] += 3 * unit_vectors(rng, 2)
        drift = check_drift(reference, reading(places, sd=TRACKER_SD))
        assert drift.status is DriftStatus.MARKER_MOVED
        assert {"F1", "F2"} <= set(drift.loose)


@few_or_all("cases", 300, 600)
def test_false_alarms_are_one_in_a_million(cases: int) -> None:
    """Importance sampling: the noise of all or of one is drawn too large, and an alarm counts as its true rarity."""
    rng = np.random.default_rng(11)
    tilt = exponential(np.array([0.3, -0.8, 0.5]))
    reference_mm2, later_mm2 = (tilt @ np.diag(s) @ tilt.T for s in ([0.01, 0.02, 0.09], [0.04, 0.01, 0.16]))
    spread = np.linalg.cholesky(reference_mm2 + later_mm2)
    markers, labels = HEAD[:4], LABELS[:4]
    reference = Points(markers, np.tile(reference_mm2, (4, 1, 1)), labels, Frame("OTS"))
    scales = np.vstack([np.full(4, 2.2), np.full((4, 4), 1.0) + 2.4 * np.eye(4)])
    counted = []
    for _ in range(cases):
        normal = rng.normal(size=(4, 3)) * scales[rng.integers(len(scales))][:, None]
        later = Points(markers + normal @ spread.T, np.tile(later_mm2, (4, 1, 1)), labels, Frame("OTS"))
        alarm = check_drift(reference, later).status is not DriftStatus.STILL
        gain = (normal**2).sum(axis=1) * (1 - scales**-2.0) / 2 - 3 * np.log(scales)
        counted.append(alarm / np.exp(gain.sum(axis=1)).mean())
    error = np.std(counted) / np.sqrt(len(counted))
    assert error < 0.2 * DRIFT_PROBABILITY
    assert 0.8 * DRIFT_PROBABILITY - 3 * error < np.mean(counted) < DRIFT_PROBABILITY + 3 * error


def test_what_is_no_reading_is_told_in_one_sentence() -> None:
    with pytest.raises(UsageError, match="list is given for the later reading, expected Points"):
        check_drift(Points(np.eye(3), np.tile(np.eye(3), (3, 1, 1)), ("a", "b", "c")), [])  # type: ignore[arg-type]
