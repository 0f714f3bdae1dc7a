"""Which marker to doubt."""

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.registration import doubted_marker, leave_one_out, register_points
from tests.long import few_and_others

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


@few_and_others("stated", [True], [False])
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


def test_rounding_is_no_reason_to_doubt_a_marker() -> None:
    """Of points that fit exactly, their errors not stated, the last digits told one from the others."""
    for seed in range(20):
        exact = np.random.default_rng(seed).normal(size=(6, 3)) * 50
        assert doubted_marker(register_points(exact, exact + 3.0)) is None, seed


@few_and_others("off_line_mm", [0.2], [3.0, 1.0])
@pytest.mark.parametrize("stated", [True, False])
def test_a_marker_is_not_doubted_because_the_others_lie_nearly_on_a_line(off_line_mm: float, stated: bool) -> None:
    """They predict it only along an arc, which is no ellipse."""
    rng = np.random.default_rng(4)
    row = np.array([[-60.0, 0, 0], [0, off_line_mm, 0], [60, 0, 0], [10, 50, 20]])
    errors = SD**2 * np.eye(3) if stated else None
    noisy = row + SD * rng.normal(size=(150, *row.shape))
    chances = np.array([leave_one_out(register_points(row, fixed, errors)).probabilities[3] for fixed in noisy])
    assert chances.min() > 0.001 / 4
    assert np.mean(chances < 0.1) < 0.17
    assert np.mean(chances < 0.5) < 0.6


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
