"""Distances and angles against plain trigonometry, and points that measure nothing are refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.planning import Ruler


@pytest.mark.parametrize("degrees", [0.001, 30.0, 90.0, 135.0, 179.999, 180.0])
def test_an_angle_is_that_at_the_second_point(degrees: float) -> None:
    turned = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0])
    corner = np.array([40.0, -30.0, 900.0])
    found = Ruler("A", np.array([corner + np.array([7.0, 0, 0]), corner, corner + 50.0 * turned]))
    assert found.is_angle
    assert found.value == pytest.approx(degrees, abs=1e-6)


def test_a_distance_is_in_millimetres() -> None:
    found = Ruler("D", np.array([[1.0, 2.0, 3.0], [3.0, 5.0, 9.0]]))
    assert (found.value, found.told) == (7.0, "7.0 mm")


@pytest.mark.parametrize(
    ("points", "told"),
    [
        (np.zeros((1, 3)), "has 1 points"),
        (np.arange(12.0).reshape(4, 3), "has 4 points"),
        (np.ones((2, 3)), "one place"),
        (np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]]), "one place"),
        (np.array([[0.0, 0, 0], [math.nan, 0, 0]]), "finite"),
    ],
)
def test_points_that_measure_nothing_are_refused(points: np.ndarray, told: str) -> None:
    with pytest.raises(InputError, match=told):
        Ruler("D1", points)
