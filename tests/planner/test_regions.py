"""The outline of a region runs where its edge is, in every cut, and is not there where the cut misses it."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.planner.panes import Pane
from ronnaplan.planner.regions import Outlines
from ronnaplan.scene.cut import Cut
from tests import cases

MIDDLE, RADIUS = np.array([5.0, -10.0, 35.0]), 22.0


@pytest.fixture(scope="module")
def outlines() -> Outlines:
    """A ball as a label map of the scan."""
    scan = cases.volume()
    ball = np.zeros(scan.voxels_hu.shape, dtype=np.bool_)
    near = tuple(slice(int(at) - 30, int(at) + 30) for at in scan.grid.indices(MIDDLE))
    k, j, i = np.mgrid[near]
    places = scan.grid.positions_mm(np.stack([k, j, i], axis=-1).reshape(-1, 3).astype(float))
    ball[near] = (np.linalg.norm(places - MIDDLE, axis=1) < RADIUS).reshape(k.shape)
    return Outlines(scan, {"vessel": ball})


@pytest.mark.parametrize("away_mm", [0.0, 12.0])
@pytest.mark.parametrize(
    ("right", "down"),
    [([1.0, 0, 0], [0.0, 1, 0]), ([0.0, 1, 0], [0.0, 0, -1]), ([0.6, 0.8, 0], [0.0, 0, -1])],
    ids=["axial", "sagittal", "oblique"],
)
def test_an_outline_is_where_the_edge_is(
    outlines: Outlines, right: list[float], down: list[float], away_mm: float
) -> None:
    across = np.cross(right, down)
    cut = Cut(np.array(right), np.array(down), MIDDLE + away_mm * across + 7.0 * np.array(right), 120.0)
    (drawn,) = outlines.drawn("axial", cut, Pane(600, 400))
    assert drawn["name"] == "vessel"
    numbers = drawn["path"].removeprefix("M").removesuffix("Z").replace("L", " ").split()
    line = np.array(numbers, dtype=float).reshape(-1, 2)
    away = np.hypot(line[:, 0] + 7.0, line[:, 1])
    assert np.abs(away - np.sqrt(RADIUS**2 - away_mm**2)).max() < 1.2  # voxels are 1 x 1 x 1.5 mm


def test_a_cut_beside_the_region_shows_nothing_of_it(outlines: Outlines) -> None:
    cut = Cut(np.array([1.0, 0, 0]), np.array([0.0, 1, 0]), MIDDLE + np.array([0, 0, 30.0]), 120.0)
    assert outlines.drawn("axial", cut, Pane()) == []
