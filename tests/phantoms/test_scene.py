from __future__ import annotations

import numpy as np
import pytest

from phantoms.anatomy import Foot
from phantoms.errors import PhantomError
from phantoms.markers import marker
from phantoms.scene import Part, Scene
from phantoms.solids import box, cone, cylinder, half_space, sphere

WATER = Part(sphere((0, 0, 0), 40), "water", "tank")


@pytest.mark.parametrize(
    "other",
    [
        Part(sphere((0, 0, 0), 10), "air"),
        Part(sphere((5, 5, 5), 22), "acrylic"),
        Part(sphere((0, 0, 26), 11.5), "ceramic"),
        Part(cylinder((0, 0, 20), (0, 0, 1), 5, 8), "titanium"),
        Part(cylinder((0, 0, 10), (0, 0, 1), 20, 8), "titanium", embedded=True),
        Part(sphere((0, 0, 15), 20), "water"),
    ],
    ids=["inside", "inside off center", "apart", "touching", "embedded", "same material"],
)
def test_nested_and_separate_parts_are_accepted(other: Part) -> None:
    assert Scene((WATER, other)).check().parts[1] is other


@pytest.mark.parametrize(
    "other",
    [
        Part(sphere((0, 0, 15), 20), "acrylic"),
        Part(cylinder((0, 0, 10), (0, 0, 1), 20, 8), "titanium"),
        Part(box((20, 0, 0), (5, 5, 5)), "acrylic"),
        Part(cone((0, 30, 0), (0, -1, 0), 25, 10), "acrylic"),
        Part(cylinder((-50, 0, 0), (1, 0, 0), 100, 2), "steel"),
        Part(sphere((0, 0, 0), 60), "acrylic"),
        Part(half_space((0, 0, 0), (0, 0, 1)), "water", "pool"),
    ],
    ids=["sphere", "cylinder", "box", "cone", "needle through", "outer listed last", "half-space"],
)
def test_parts_that_overlap_without_nesting_are_refused(other: Part) -> None:
    parts = (WATER, other) if other.name != "pool" else (Part(WATER.solid, "acrylic"), other)
    with pytest.raises(PhantomError, match=r"overlaps .* without lying inside it; list the outer part first"):
        Scene(parts).check()


def test_unknown_materials_and_doubtful_markers_are_refused() -> None:
    with pytest.raises(PhantomError, match="unknown material 'unobtainium'"):
        Scene((Part(sphere((0, 0, 0), 1), "unobtainium"),)).check()
    with pytest.raises(PhantomError, match="empty"):
        Scene().check()
    up = np.array([0.0, 0.0, 1.0])
    one = marker("M1", Foot(np.zeros(3), up))
    with pytest.raises(PhantomError, match="two markers are called 'M1'"):
        (one + marker("M1", Foot(np.array([50.0, 0, 0]), up))).check()
    with pytest.raises(PhantomError, match=r"markers M1 and M2 overlap: their centers are 11.00 mm apart"):
        (one + marker("M2", Foot(np.array([11.0, 0, 0]), up))).check()
    (one + marker("M2", Foot(np.array([12.5, 0, 0]), up))).check()


@pytest.mark.parametrize("size", [0.0, -1.0, float("nan")])
def test_impossible_sizes_are_refused(size: float) -> None:
    with pytest.raises(PhantomError, match="expected positive lengths"):
        sphere((0, 0, 0), size)
    with pytest.raises(PhantomError, match="expected three finite coordinates"):
        sphere((0, 0, float("inf")), 1.0)
    with pytest.raises(PhantomError, match="has no direction"):
        cylinder((0, 0, 0), (0, 0, 0), 1, 1)
