"""Which marker to doubt, and whether anything moved."""

import numpy as np
import pytest

from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame, Points
from ronnaplan.pose import exponential
from ronnaplan.registration import DriftStatus, check_drift, doubted_marker, leave_one_out, register_points
from ronnaplan.registration.drift import drift_over_time

HEAD = np.array([[-60.0, 20, 40], [55, 30, 50], [5, -85, 60], [-20, 60, 75], [30, -10, 95], [-70, -30, 10]])
LABELS = ("F1", "F2", "F3", "F4", "F5", "F6")
SD = 0.3


def test_leave_one_out_is_the_registration_of_the_others() -> None:
    rng = np.random.default_rng(1)
    fixed = HEAD + SD * rng.normal(size=HEAD.shape)
    errors = np.array([np.diag(rng.uniform(0.05, 0.3, 3)) for _ in HEAD])
    left = leave_one_out(register_points(HEAD, fixed, errors))
    for i in range(len(HEAD)):
        others = np.arange(len(HEAD)) != i
        alone = register_points(HEAD[others], fixed[others], errors[others])
        predicted = alone.pose.apply(HEAD[i : i + 1])[0]
        np.testing.assert_allclose(left.vectors_mm[i], fixed[i] - predicted, atol=1e-9)
        np.testing.assert_allclose(left.covariances_mm2[i], errors[i] + alone.tre(HEAD[i : i + 1])[0], atol=1e-9)


@pytest.mark.parametrize("stated", [True, False])
def test_leave_one_out_chances_are_uniform_for_good_markers(stated: bool) -> None:
    rng = np.random.default_rng(2)
    errors = SD**2 * np.eye(3) if stated else None
    chances = np.array(
        [
            leave_one_out(register_points(HEAD, HEAD + SD * rng.normal(size=HEAD.shape), errors)).probabilities
            for _ in range(150)
        ]
    )
    assert 0.05 < np.mean(chances < 0.1) < 0.15
    assert 0.42 < np.mean(chances < 0.5) < 0.58


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("bad", range(6))
def test_a_marker_knocked_by_three_millimetres_is_named(bad: int, stated: bool) -> None:
    rng = np.random.default_rng(10 + bad)
    fixed = HEAD + 0.1 * rng.normal(size=HEAD.shape)
    fixed[bad] += (2.0, -2.0, 1.0)
    doubt = doubted_marker(register_points(HEAD, fixed, 0.1**2 * np.eye(3) if stated else None, labels=LABELS))
    assert doubt is not None
    assert doubt.label == LABELS[bad]
    assert doubt.certain
    assert LABELS[bad] in str(doubt)


def test_good_markers_are_not_doubted() -> None:
    rng = np.random.default_rng(3)
    doubts = [
        doubted_marker(register_points(HEAD, HEAD + SD * rng.normal(size=HEAD.shape), SD**2 * np.eye(3)))
        for _ in range(100)
    ]
    assert sum(doubt is not None for doubt in doubts) <= 1


def test_two_bad_markers_are_not_blamed_on_one() -> None:
    fixed = HEAD.copy()
    fixed[0] += (4, 0, 0)
    fixed[4] -= (0, 0, 4)
    doubt = doubted_marker(register_points(HEAD, fixed, 0.1**2 * np.eye(3), labels=LABELS))
    assert doubt is not None
    assert not doubt.certain
    assert "measure again" in str(doubt)


def test_three_markers_cannot_doubt_one() -> None:
    three = register_points(HEAD[:3], HEAD[:3] + np.eye(3), 0.01 * np.eye(3))
    assert doubted_marker(three) is None
    with pytest.raises(InputError, match="at least four"):
        leave_one_out(three)


def test_a_marker_whose_absence_leaves_a_line_has_no_leave_one_out() -> None:
    row = np.array([[0.0, 0, 0], [50, 0, 0], [100, 0, 0], [40, 60, 0]])
    left = leave_one_out(register_points(row, row + 0.01 * np.eye(4, 3), 0.01 * np.eye(3)))
    assert np.isnan(left.vectors_mm[3]).all()
    assert np.isfinite(left.vectors_mm[:3]).all()


def reading(positions: np.ndarray, labels: tuple[str, ...] = LABELS, frame: str = "OTS") -> Points:
    return Points(positions, np.tile(0.1**2 * np.eye(3), (len(positions), 1, 1)), labels, Frame(frame))


def test_noise_alone_is_no_drift() -> None:
    rng = np.random.default_rng(4)
    frames = [reading(HEAD + 0.1 * rng.normal(size=HEAD.shape)) for _ in range(600)]
    reference = reading(HEAD + 0.1 * rng.normal(size=HEAD.shape))
    drifts = drift_over_time(reference, frames)
    assert {drift.status for drift in drifts} == {DriftStatus.STILL}
    assert min(drift.probability for drift in drifts) < 0.05  # and the test is not blind


def test_a_moved_patient_is_told_with_the_motion() -> None:
    rng = np.random.default_rng(5)
    turn = exponential(np.radians([0.0, 0.0, 1.0]))
    centre = HEAD.mean(axis=0)
    moved = (HEAD - centre) @ turn.T + centre + (1.0, 0, 0)
    drift = check_drift(reading(HEAD), reading(moved + 0.1 * rng.normal(size=HEAD.shape)))
    assert drift.status is DriftStatus.PATIENT_MOVED
    assert drift.rotation_deg == pytest.approx(1.0, abs=0.2)
    assert drift.shift_mm == pytest.approx(1.0, abs=0.15)
    assert drift.doubt is None


def test_a_loose_marker_is_told_from_a_moved_patient_in_any_order_of_labels() -> None:
    moved = HEAD.copy()
    moved[2] += (0, 1.5, 1.5)
    order = [3, 2, 5, 0, 4, 1]
    drift = check_drift(reading(HEAD), reading(moved[order], tuple(LABELS[i] for i in order)))
    assert drift.status is DriftStatus.MARKER_MOVED
    assert drift.doubt is not None
    assert drift.doubt.label == "F3"
    assert drift.largest_mm == pytest.approx(np.hypot(1.5, 1.5))


def test_hidden_markers_are_listed_and_too_few_are_said() -> None:
    drift = check_drift(reading(HEAD), reading(HEAD[:2], LABELS[:2]))
    assert drift.status is DriftStatus.TOO_FEW
    assert drift.missing == ("F3", "F4", "F5", "F6")


def test_readings_of_another_frame_are_refused() -> None:
    with pytest.raises(FrameMismatchError):
        check_drift(reading(HEAD), reading(HEAD, frame="R"))
