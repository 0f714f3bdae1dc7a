"""Products and equations come out as NumPy's do."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.localization.fit.algebra import add_products, expected_gain, inverse, quantile, ranked, solve


@pytest.mark.parametrize(("first", "size", "count"), [(1, 1, 1), (3, 7, 5), (14, 14, 504), (19, 44, 333)])
def test_products_of_rows_are_added(first: int, size: int, count: int) -> None:
    draws = np.random.default_rng(first)
    told, products = draws.normal(size=(size, count)), draws.normal(size=(first, size))
    expected, room = products + told[:first] @ told.T, np.full((size, 3), np.nan)
    add_products(np.hstack([told, room]), count, products)
    np.testing.assert_allclose(products, expected, atol=1e-11)


def test_normal_equations_are_solved_whatever_their_units() -> None:
    draws = np.random.default_rng(0)
    rows, units = draws.normal(size=(60, 14)), 10.0 ** draws.uniform(-4.0, 4.0, 14)
    normal, right, solved = (rows * units).T @ (rows * units), draws.normal(size=14), np.empty(14)
    solve(np.column_stack([normal, right]), solved)
    np.testing.assert_allclose(solved * units, np.linalg.solve(rows.T @ rows, right / units), rtol=1e-9)


def test_a_step_lessens_a_sum_of_squares_by_what_its_equations_tell() -> None:
    draws = np.random.default_rng(2)
    rows, values, step = draws.normal(size=(60, 5)), draws.normal(size=60), draws.normal(size=5)
    less = 0.5 * np.sum(values**2) - 0.5 * np.sum((values - rows @ step) ** 2)
    assert expected_gain(rows.T @ rows, rows.T @ values, step) == pytest.approx(less)


def test_equations_that_tell_nothing_have_no_solution() -> None:
    solved = np.zeros(3)
    solve(np.column_stack([np.ones((3, 3)), np.arange(3.0)]), solved)
    assert not np.isfinite(solved).any()


def test_normal_equations_are_inverted_whatever_their_units() -> None:
    draws = np.random.default_rng(1)
    rows, units = draws.normal(size=(60, 14)), 10.0 ** draws.uniform(-6.0, 6.0, 14)
    inverted = inverse((rows * units).T @ (rows * units))
    np.testing.assert_allclose(inverted * np.outer(units, units), np.linalg.inv(rows.T @ rows), atol=1e-12)


def test_what_equations_do_not_tell_is_held_and_all_else_told_as_without_it() -> None:
    rows = np.random.default_rng(2).normal(size=(60, 6))
    rows[:, 1], rows[:, 4] = (
        0.0,
        2.0 * rows[:, 0] - rows[:, 3],
    )  # nothing is seen of one, and one looks like others
    told = [0, 2, 3, 5]
    expected = np.zeros((6, 6))
    expected[np.ix_(told, told)] = np.linalg.inv(rows[:, told].T @ rows[:, told])
    np.testing.assert_allclose(inverse(rows.T @ rows), expected, atol=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 1.0])
def test_quantiles_are_those_of_numpy_without_what_is_not_known(share: float) -> None:
    values = np.random.default_rng(3).normal(size=97)
    values[::7] = np.nan
    assert quantile(values, share) == pytest.approx(np.nanquantile(values, share), abs=1e-12)
    assert np.isnan(quantile(np.full(3, np.nan), share))


@pytest.mark.parametrize("count", [1, 2, 5, 96])
def test_a_value_of_any_rank_is_found_without_sorting(count: int) -> None:
    draws = np.random.default_rng(count)
    for values in (draws.normal(size=count), draws.integers(0, 3, count).astype(float), np.zeros(count)):
        ordered = np.sort(values)
        assert [ranked(values.copy(), rank) for rank in range(count)] == ordered.tolist()
