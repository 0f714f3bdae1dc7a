"""Cuts along any path are seen from where the standard ones are, and what is seen along it is upright."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray, unit
from ronnaplan.scene.cut import axes_along, axes_beside, letters

SIDES = {"front": [0, 1, 0], "behind": [0, -1, 0], "left": [-1, 0, 0], "right": [1, 0, 0], "above": [0, 0, -1]}
"""From where a path comes -> the way that it goes, LPS."""


def tilted(way: list[int]) -> FloatArray:
    """A way that is a little off the axes, as paths are."""
    return unit(np.add(way, [0.05, 0.1, -0.02]))


def test_an_oblique_edge_is_named_after_both_its_axes() -> None:
    assert letters(np.array([0.1, 0.7, -0.7])) in ("PI", "IP")


@pytest.mark.parametrize("way", SIDES.values(), ids=SIDES)
def test_cuts_that_hold_a_path_are_no_mirror_images_of_the_standard_ones(way: list[int]) -> None:
    """Seen from the feet, from the front and from the left: the patient's left is on the right in an upright one."""
    inward = tilted(way)
    seen = [letters(np.cross(right, inward))[0] for right in axes_beside(inward)]
    assert set(seen) < {"S", "P", "R"}
    for right in axes_beside(inward):
        assert right @ inward == pytest.approx(0.0, abs=1e-12)
    first, second = axes_beside(inward)
    assert first @ second == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("side", "edges"), [("front", "LS"), ("behind", "RS"), ("left", "PS"), ("right", "AS"), ("above", "RA")]
)
def test_along_a_path_the_head_is_seen_upright_and_from_above_with_its_face_up(side: str, edges: str) -> None:
    """Who stands before a patient has the patient's left on the right; who stands behind, above or beside does not."""
    right, down = axes_along(tilted(SIDES[side]))
    assert letters(right)[0] + letters(-down)[0] == edges
    assert np.cross(right, down) == pytest.approx(tilted(SIDES[side]))
