"""Products and equations come out as NumPy's do."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.localization.algebra import add_products, solve


@pytest.mark.parametrize(("first", "size", "count"), [(1, 1, 1), (3, 7, 5), (14, 14, 504), (19, 44, 333)])
def test_products_of_rows_are_added(first: int, size: int, count: int) -> None:
    draws = np.random.default_rng(first)
    told, products = draws.normal(size=(size, count)), draws.normal(size=(first, size))
    expected = products + told[:first] @ told.T
    add_products(told, products)
    np.testing.assert_allclose(products, expected, atol=1e-11)


def test_normal_equations_are_solved_whatever_their_units() -> None:
    draws = np.random.default_rng(0)
    rows, units = draws.normal(size=(60, 14)), 10.0 ** draws.uniform(-4.0, 4.0, 14)
    normal, right, solved = (rows * units).T @ (rows * units), draws.normal(size=14), np.empty(14)
    solve(np.column_stack([normal, right]), solved)
    np.testing.assert_allclose(solved * units, np.linalg.solve(rows.T @ rows, right / units), rtol=1e-9)


def test_equations_that_tell_nothing_have_no_solution() -> None:
    solved = np.zeros(3)
    solve(np.column_stack([np.ones((3, 3)), np.arange(3.0)]), solved)
    assert not np.isfinite(solved).any()
