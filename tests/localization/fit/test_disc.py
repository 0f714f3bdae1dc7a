"""What a blurred disc shows, and how that changes, is what SciPy's functions tell."""

from __future__ import annotations

import numpy as np
from scipy.special import chndtr, i0e, i1e, ndtr

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.disc import CURVATURE_STEPS, EDGE_REACH, EDGE_STEPS, disc_table

DISTANCE = np.linspace(-EDGE_REACH, EDGE_REACH, EDGE_STEPS + 1)
R = (2.0 * CURVATURE_STEPS / np.arange(1, CURVATURE_STEPS + 1) - 2.0)[:, np.newaxis]
A = np.maximum(R + DISTANCE, 0.0)


def by_a_over_a(a: FloatArray, r: FloatArray) -> FloatArray:
    density: FloatArray = np.exp(-0.5 * (a - r) ** 2) * i0e(a * r)
    return density


def by_r(a: FloatArray, r: FloatArray) -> FloatArray:
    density: FloatArray = -a * np.exp(-0.5 * (a - r) ** 2) * i1e(a * r)
    return density


def along(a: FloatArray, r: FloatArray) -> FloatArray:
    both: FloatArray = a**2 * by_a_over_a(a, r) + r * by_r(a, r)
    return both


def test_discs_of_any_size_are_non_central_chi_square_probabilities() -> None:
    table = disc_table()[1:]
    np.testing.assert_allclose(table[..., 0], chndtr(A**2, 2, R**2), atol=1e-11)
    np.testing.assert_allclose(table[..., 1], by_a_over_a(A, R), atol=1e-11)
    np.testing.assert_allclose(table[..., 2], by_r(A, R), atol=1e-11)
    np.testing.assert_allclose(table[..., 3], along(A, R), atol=1e-9)


def test_what_edges_add_has_the_derivatives_that_the_table_says() -> None:
    few = slice(10, -1)  # of larger discs, differences are not told so exactly
    table, a, r, step = disc_table()[1:][few], A[few], R[few], 1e-5
    by_radius = (along(a + step, r) - along(a - step, r)) / (2.0 * step)
    by_place = (along(a, r + step) - along(a, r - step)) / (2.0 * step)
    np.testing.assert_allclose(a * table[..., 4], by_radius, atol=1e-6)
    np.testing.assert_allclose(table[..., 5], by_place, atol=1e-6)
    np.testing.assert_allclose(table[..., 6], a**2 * table[..., 4] + r * table[..., 5], atol=1e-6)


def test_a_straight_edge_is_a_normal_distribution_which_large_discs_come_to() -> None:
    table = disc_table()
    np.testing.assert_allclose(table[0, :, 0], ndtr(DISTANCE), atol=1e-15)
    np.testing.assert_allclose(table[0, :, (0, 2, 3)], table[1, :, (0, 2, 3)], atol=5e-3)
