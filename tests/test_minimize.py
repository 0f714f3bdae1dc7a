"""The one descent finds what is least, of a stack of problems at once, and says what did not come to rest."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ronnaplan.geometry import FloatArray
from ronnaplan.minimize import minimize


def residuals(at: FloatArray, steep: float) -> FloatArray:
    """Rosenbrock's valley: full steps overshoot its bend."""
    return np.array([steep * (at[1] - at[0] ** 2), 1.0 - at[0]])


def equations(at: FloatArray, steep: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    left = np.stack([residuals(one, s) for one, s in zip(at, steep.tolist(), strict=True)])
    slopes = np.stack([[[-2.0 * s * one[0], s], [-1.0, 0.0]] for one, s in zip(at, steep.tolist(), strict=True)])
    turned = slopes.swapaxes(-1, -2)
    return (left**2).sum(axis=-1), -(turned @ left[..., None])[..., 0], turned @ slopes


def near(step: FloatArray, _promise: FloatArray, _cost: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(np.abs(step).max(axis=-1) < 1e-10)


def test_a_stack_is_fitted_as_each_problem_alone_would_be() -> None:
    steep, start = np.array([1.0, 3.0, 10.0]), np.array([[-1.2, 1.0], [3.0, -4.0], [-0.5, 2.0]])
    found = minimize(lambda at: equations(at, steep), start, near, most_steps=200)
    assert found.settled.all()
    for place, s, first in zip(found.place, steep.tolist(), start, strict=True):
        peer = least_squares(residuals, first, args=(s,), xtol=1e-14, ftol=1e-14, gtol=1e-14)
        np.testing.assert_allclose(place, peer.x, atol=1e-8)


def test_no_step_raises_the_cost_and_what_did_not_come_to_rest_is_told() -> None:
    seen: list[float] = []
    steep, start = np.array([100.0]), np.array([[-1.2, 1.0]])
    for most in range(1, 12):
        found = minimize(lambda at: equations(at, steep), start, near, most_steps=most)
        seen.append(float(found.cost[0]))
        assert found.cost == pytest.approx(equations(found.place, steep)[0])
        assert not found.settled.all() or np.allclose(found.place, 1.0)
    assert np.diff(seen).max() <= 0.0
    assert not minimize(lambda at: equations(at, steep), start, near, most_steps=1).settled.any()


def test_a_place_may_be_more_than_numbers() -> None:
    def turned(place: FloatArray, step: FloatArray) -> FloatArray:
        c, s = np.cos(step[..., 0]), np.sin(step[..., 0])
        turn: FloatArray = np.moveaxis(np.array([[c, -s], [s, c]]), (0, 1), (-2, -1)) @ place
        return turn

    def off(place: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        angle = np.arctan2(place[..., 1, 0], place[..., 0, 0]) - np.array([0.4, -1.0])
        return angle**2, -angle[..., None], np.ones((2, 1, 1))

    found = minimize(off, np.tile(np.eye(2), (2, 1, 1)), near, most_steps=5, moved=turned)
    np.testing.assert_allclose(np.arccos(found.place[:, 0, 0]), [0.4, 1.0])


def test_where_the_cost_tells_nothing_of_a_direction_there_is_no_step_along_it() -> None:
    def valley(at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        off = at[..., 0] - 2.0
        return off**2, np.stack([-off, 0.0 * off], axis=-1), np.broadcast_to(np.diag([1.0, 0.0]), (len(at), 2, 2))

    found = minimize(valley, np.array([[5.0, 7.0], [-1.0, 3.0]]), near, most_steps=20)
    assert found.settled.all()
    np.testing.assert_allclose(found.place, [[2.0, 7.0], [2.0, 3.0]])
