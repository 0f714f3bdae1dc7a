"""The error to expect of planned markers, and the radius that holds it."""

from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk
from scipy.special import chdtri

from ronnaplan.ct import CTVolume
from ronnaplan.errors import InputError, UsageError
from ronnaplan.registration import predict_tre, predict_tre_map, radius_95_mm, register_batch, register_points
from tests.long import few_and_others
from tests.registration.test_register_points import HEAD, covariances

GRID = CTVolume.from_array(
    np.zeros((3, 4, 5)), [[0, 0, 9.0, -50], [0, 8.0, 0, -40], [12.0, 0, 0, -60], [0, 0, 0, 1.0]]
)
TARGETS = np.array([[0.0, 0, 0], [20, 30, -50]])


def test_planned_and_fitted_tre_are_one_prediction() -> None:
    errors = covariances(np.random.default_rng(2), 6, 0.3)
    np.testing.assert_allclose(
        predict_tre(HEAD, errors, TARGETS), register_points(HEAD, HEAD, errors).tre(TARGETS), atol=1e-12
    )


def test_a_tuple_of_scan_and_tracker_is_their_sum_to_first_order() -> None:
    rng = np.random.default_rng(4)
    scan, tracker = covariances(rng, len(HEAD), 0.5), covariances(rng, len(HEAD), 0.2)
    both = predict_tre(HEAD, (scan, tracker), TARGETS)
    for other in (
        predict_tre(HEAD, scan + tracker, TARGETS),
        register_points(HEAD, HEAD, (scan, tracker)).tre(TARGETS),
    ):
        assert np.abs(both - other).max() < 2e-3 * np.abs(both).max()
    np.testing.assert_allclose(
        predict_tre_map(HEAD, (scan, tracker), GRID).values,
        predict_tre_map(HEAD, scan + tracker, GRID).values,
        rtol=2e-3,
    )


@few_and_others("count", [12, 60], [300])
def test_the_errors_of_both_readings_turn_against_each_other(count: int) -> None:
    """Of 300 points whose rotation is known to 5 degrees, first order predicts a fifth too little."""
    rng = np.random.default_rng(count)
    points = np.column_stack([np.linspace(-70, 70, count), 6 * rng.normal(size=(count, 2))])
    targets = np.array([[0.0, 40, 20], [30, -50, 10]])
    first_order = register_points(points, points, np.eye(3)).rotation_sd_deg
    sigma = (
        5 / first_order * np.sqrt(2 / (1 + np.sqrt(1 + 2 * count * np.radians(5) ** 2)))
    )  # 5 degrees in the end
    moving, fixed = (points + sigma * np.sqrt(0.5) * rng.normal(size=(3000, count, 3)) for _ in range(2))
    found = register_batch(moving, fixed).transforms
    error = targets @ found[:, :3, :3].swapaxes(1, 2) + found[:, None, :3, 3] - targets
    half = 0.5 * sigma**2 * np.eye(3)
    predicted = np.sqrt(np.trace(predict_tre(points, (half, half), targets), axis1=1, axis2=2))
    np.testing.assert_allclose(predicted, np.sqrt((error**2).sum(-1).mean(0)), rtol=0.025)


def test_errors_in_no_shape_of_covariances_are_named_as_they_were_given() -> None:
    with pytest.raises(
        InputError,
        match=r"the number 0\.34; .* standard deviation of 0\.34 mm .* is 0\.34\*\*2 \* numpy\.eye\(3\), ",
    ):
        predict_tre(HEAD, 0.34, TARGETS)
    with pytest.raises(InputError, match=r"^covariances have shape \(3,\)"):
        predict_tre(HEAD, [0.1, 0.1, 0.1], TARGETS)
    with pytest.raises(InputError, match=r"^moving covariances came as the number 2"):
        register_points(HEAD, HEAD, (2, np.eye(3)))
    with pytest.raises(UsageError, match="no errors of the markers were stated"):
        predict_tre(HEAD, None, TARGETS)


def test_a_map_of_planned_markers_agrees_with_the_error_place_by_place() -> None:
    errors = np.diag([0.2, 0.3, 0.9])
    kji = np.moveaxis(np.indices((3, 4, 5)), 0, -1).reshape(-1, 3).astype(float)
    tre = predict_tre(HEAD, errors, GRID.grid.positions_mm(kji))
    expected = predict_tre_map(HEAD, errors, GRID)
    np.testing.assert_allclose(expected.values.ravel(), np.sqrt(np.trace(tre, axis1=1, axis2=2)), rtol=1e-5)
    assert expected.frame == GRID.frame
    assert "RMS" in repr(expected)
    np.testing.assert_array_equal(predict_tre_map(HEAD, errors, expected).values, expected.values)
    others: tuple[Any, ...] = (expected.values, GRID.to_sitk())
    for other in others:
        with pytest.raises(UsageError, match=r"expected CTVolume or ScalarMap; .*from_sitk and .*from_array"):
            predict_tre_map(HEAD, errors, other)
    again = predict_tre_map(HEAD, errors, CTVolume.from_sitk(GRID.to_sitk()))
    np.testing.assert_array_equal(sitk.GetArrayFromImage(again.to_sitk()), expected.values)


def test_the_radius_holds_95_of_100_errors() -> None:
    """Against chi-square where axes are alike or missing, against draws where they differ."""
    exact = np.sqrt(chdtri([1, 2, 3], 0.05))
    alike = [np.diag(axes) for axes in ([0.0, 4, 0], [4.0, 0, 4], [4.0, 4, 4])]
    np.testing.assert_allclose(radius_95_mm(alike), 2 * exact, rtol=1e-10)
    rng = np.random.default_rng(7)
    root = rng.normal(size=(4, 3, 3)) * [[[0.1]], [[0.5]], [[1.0]], [[3.0]]]
    root[3] *= [1.0, 0.1, 0.01]  # a needle
    covariance = root @ root.swapaxes(1, 2)
    drawn = rng.normal(size=(400_000, 3)) @ root.swapaxes(1, 2)
    held = (np.linalg.norm(drawn, axis=-1) <= radius_95_mm(covariance)[:, np.newaxis]).mean(axis=1)
    np.testing.assert_allclose(held, 0.95, atol=4 * np.sqrt(0.95 * 0.05 / 400_000))
    assert radius_95_mm(np.zeros((3, 3))) == 0.0
    for bad in ("x", np.eye(2), np.diag([1.0, 1, -1]), np.full((3, 3), np.nan)):
        with pytest.raises(InputError, match=r"^the covariances"):
            radius_95_mm(bad)
