"""The sphere about a place is found from where the image falls off, whatever size was thought of."""

from __future__ import annotations

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import sphere
from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.search.sphere import spheres_at
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack

CENTER = (3.2, -4.1, 1.7)
ASIDE_MM = np.array([1.2, -0.8, 1.0])


@few_and_others("thought_mm", [7.5, 11.0], [9.0])
@few_and_others("tilt_deg", [18.0], [0.0])
def test_center_and_size_of_a_ball_are_found_from_beside_it(thought_mm: float, tilt_deg: float) -> None:
    volume = scan(balls([CENTER], 9.0), small_stack(tilt_deg=tilt_deg))
    centers, diameters, shares = spheres_at(volume, CENTER + ASIDE_MM[np.newaxis], np.array([thought_mm]), SOLID)
    assert centers[0] == pytest.approx(CENTER, abs=0.25)
    assert diameters[0] == pytest.approx(9.0, abs=0.3)
    assert shares[0] > 0.9


def test_a_shell_is_seen_from_outside_where_it_is_asked_for() -> None:
    cavity = Scene((Part(sphere(CENTER, 9.5), "air"),))
    volume = scan(balls([CENTER], 11.5) + cavity, small_stack(spacing_mm=0.6))
    place, size = np.array([CENTER]), np.array([11.0])
    _, diameters, shares = spheres_at(volume, place, size, Build.parse("shell:1"))
    assert diameters[0] == pytest.approx(11.5, abs=0.4)
    assert shares[0] > 0.9
    assert spheres_at(volume, place, size, SOLID)[2][0] == 0.0


def test_where_nothing_is_or_another_size_there_is_no_sphere() -> None:
    volume = scan(balls([CENTER], 9.0), small_stack())
    places = np.array([(-15.0, 10.0, -5.0), CENTER, (0.0, 0.0, 500.0)])
    assert spheres_at(volume, places, np.array([9.0, 20.0, 9.0]), SOLID)[2].tolist() == [0.0, 0.0, 0.0]
