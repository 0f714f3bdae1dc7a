"""A path on the other side than its name tells is doubted, and only that."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.geometry import Frame
from ronnaplan.planning import Landmarks, Trajectory, measure
from ronnaplan.planning.sides import side_doubt
from tests.planning.heads import scanned

FRAME = Frame("CT", "1.2.3")
RIGHT_MM = (np.array([-30.0, 0.0, 68.0]), np.array([-12.0, 0.0, 30.0]))
"""Entry and target on the patient's right: LPS counts to the left."""


def named(name: str, left_mm: float = 0.0) -> Trajectory:
    """The path on the right, moved by so much to the left."""
    entry, target = (end + np.array([left_mm, 0.0, 0.0]) for end in RIGHT_MM)
    return Trajectory(name, entry, target, FRAME)


def test_coordinates_of_the_wrong_hand_are_doubted_with_the_measures() -> None:
    """As RAS coordinates that are called LPS make them."""
    (doubt,) = measure(named("Left STN"), scanned("plain")).doubts
    assert doubt.startswith(
        "it is named left but lies on the patient's right side, its entry 30 and its target 12 mm"
    )
    assert measure(named("right STN"), scanned("plain")).doubts == ()


@pytest.mark.parametrize("name", ["left_1", "LEFT", "STN (left)"])
def test_the_word_tells_the_side_wherever_it_stands(name: str) -> None:
    assert side_doubt(named(name), scanned("plain"), None) is not None


@pytest.mark.parametrize("name", ["STN", "L", "R'", "leftover", "left to right", "right"])
def test_a_name_that_tells_no_side_or_the_true_one_is_not_doubted(name: str) -> None:
    assert side_doubt(named(name), scanned("plain"), None) is None


@pytest.mark.parametrize("left_mm", [13.0, 21.0])
def test_a_path_that_crosses_the_middle_or_stays_near_it_is_not_doubted(left_mm: float) -> None:
    assert side_doubt(named("left", left_mm), scanned("plain"), None) is None


def test_the_midsagittal_plane_counts_where_it_is_known() -> None:
    """A head whose middle is 50 mm to the right of the scan's."""
    ac, pc, above = (np.array(place) for place in ((-50.0, -12, 0), (-50.0, 12, 0), (-50.0, 0, 40)))
    midline = Landmarks(ac, pc, above)
    assert side_doubt(named("left"), scanned("plain"), midline) is None
    doubt = side_doubt(named("right"), scanned("plain"), midline)
    assert doubt is not None
    assert "entry 20 and its target 38 mm from the midsagittal plane" in doubt
