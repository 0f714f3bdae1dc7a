"""A ball in a plate or a block is found where it is, and its faces count as what could not be used."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtri

from phantoms.scene import Part, Scene
from phantoms.solids import box, cylinder, half_space, sphere
from ronnaplan.ct import CTVolume
from ronnaplan.localization import localize
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.embedded import MOST_ENDING, within_its_holder
from ronnaplan.localization.fit.neighbourhood import Neighbourhood, gather
from ronnaplan.localization.judge.uncertainty import FACE_PULL_MM
from ronnaplan.localization.scanner.scan import Scan
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack

CENTER = np.array([0.4, -0.3, 0.2])
CLOSE = {"start_mm": -13, "stop_mm": 13, "matrix": 64, "field_of_view_mm": 32, "spacing_mm": 0.8}
"""A slab that holds one ball of 5 mm and what it is embedded in."""


def plate(material: str, below_mm: float, above_mm: float, *, thing: str = "ball") -> CTVolume:
    """Scan a ball of 5 mm, or a rod as long and wide, in an upright plate whose faces are so far from it."""
    thickness_mm = below_mm + 5.0 + above_mm
    at_mm = (CENTER[0], CENTER[1] + (above_mm - below_mm) / 2.0, CENTER[2])
    holder = Part(box(at_mm, (20.0, thickness_mm, 20.0)), "acrylic")
    solid = sphere(tuple(CENTER), 5.0)
    if thing == "rod":
        solid = cylinder(tuple(CENTER - [0.0, 2.5, 0.0]), (0.0, 1.0, 0.0), 5.0, 5.0)
    return scan(Scene((holder, Part(solid, material))), small_stack(**CLOSE))


def around(volume: CTVolume) -> Neighbourhood:
    return gather(volume, CENTER, 6.0, volume.grid.axes)


@few_and_others(("below_mm", "above_mm"), [(0.3, 0.7), (1.2, 1.2)], [(0.3, 2.5)])
@few_and_others("material", ["glass"], ["ceramic"])
def test_a_ball_is_found_near_the_faces_of_a_plate(material: str, below_mm: float, above_mm: float) -> None:
    (found,) = localize(plate(material, below_mm, above_mm), diameter_mm=5.0, expected=1)
    error_mm = found.center_mm - CENTER
    assert np.linalg.norm(error_mm) < 0.015
    assert error_mm @ np.linalg.solve(found.covariance_mm2, error_mm) < chdtri(3, 0.001)


def test_directions_in_which_a_face_is_near_are_none_that_inform() -> None:
    volume = plate("glass", 0.3, 0.7)
    fit = fit_place(Scan(volume), CENTER, 5.0)
    assert 0.0 < fit.neighbourhood.ending_share <= MOST_ENDING
    assert fit.coverage <= 1.0 - fit.neighbourhood.ending_share
    (found,) = localize(volume, diameter_mm=5.0)
    assert "NEIGHBOUR" in [flag.name for flag in found.flags]
    assert np.linalg.eigvalsh(found.covariance_mm2).min() > FACE_PULL_MM**2


def test_a_rod_in_a_plate_is_no_ball() -> None:
    assert len(localize(plate("glass", 1.2, 1.2, thing="rod"), diameter_mm=5.0)) == 0


def test_a_ball_in_air_keeps_all_that_is_around_it() -> None:
    seen = around(scan(balls([tuple(CENTER)], 5.0), small_stack(**CLOSE)))
    assert within_its_holder(seen, 5.0, 0.0) is seen


def test_a_ball_in_the_air_of_a_housing_keeps_all_that_is_around_it() -> None:
    hollow = Scene((Part(sphere(tuple(CENTER), 18.0), "acrylic"), Part(sphere(tuple(CENTER), 8.0), "air")))
    seen = around(scan(hollow + balls([tuple(CENTER)], 5.0), small_stack(**CLOSE)))
    assert within_its_holder(seen, 5.0, 0.0) is seen


GEL = (Part(half_space(tuple(CENTER), (0.0, 1.0, 0.0)), "water"),)
HOLLOW_IN_SKIN = (
    Part(half_space(tuple(CENTER + np.array([0.0, 1.0, 0.0])), (0.0, 1.0, 0.0)), "skin"),
    Part(sphere(tuple(CENTER + np.array([0.0, 1.5, 0.0])), 8.0), "air", embedded=True),
)


@pytest.mark.parametrize(
    ("under", "material"), [(GEL, "steel"), (HOLLOW_IN_SKIN, "steel"), (HOLLOW_IN_SKIN, "ceramic")]
)
def test_a_ball_whose_blur_hides_the_air_beside_it_is_not_embedded(under: tuple[Part, ...], material: str) -> None:
    """Half of it is in gel, or it lies in a hollow of the skin; taken for embedded it is 75 to 84 um off."""
    ball = Part(sphere(tuple(CENTER), 5.0), material, embedded=True)
    (found,) = localize(scan(Scene((*under, ball)), small_stack(**CLOSE)), diameter_mm=5.0, expected=1)
    error_mm = found.center_mm - CENTER
    assert np.linalg.norm(error_mm) < 0.03
    assert error_mm @ np.linalg.solve(found.covariance_mm2, error_mm) < chdtri(3, 0.001)
