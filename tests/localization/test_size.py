"""The size of the markers is found without being told, or refused."""

from __future__ import annotations

import pytest

from ronnaplan.errors import RefusedError
from ronnaplan.localization import common_diameter
from tests.scans import balls, scan, small_stack

PLACES = [(-14.3, -12.2, -3.1), (13.6, 11.7, 2.4), (15.1, -13.8, 5.3), (-13.0, 12.5, -6.0)]


def test_the_commonest_size_is_found() -> None:
    scene = balls(PLACES[:3], 9.0) + balls(PLACES[3:], 13.0)
    assert common_diameter(scan(scene, small_stack())) == pytest.approx(9.0, abs=0.03)


def test_too_few_balls_of_one_size_are_refused() -> None:
    scene = balls(PLACES[:2], 9.0) + balls(PLACES[2:], 13.0)
    with pytest.raises(RefusedError, match=r"2 of 9.0 mm.*state the diameter"):
        common_diameter(scan(scene, small_stack()))
