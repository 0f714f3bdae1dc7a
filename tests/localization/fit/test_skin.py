"""Skin that a ball lies on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import box, sphere
from ronnaplan.localization import FiducialFlag, localize
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.cells import cell_directions
from ronnaplan.localization.fit.parameters import BLUR, CONTRAST, PARAMETERS, RADIUS, WIDTH
from ronnaplan.localization.fit.skin import face_hu, is_skin, lies_on_something, share_on_skin
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, scan, small_stack


@pytest.mark.parametrize(
    ("level_hu", "depth_mm", "expected"),
    [(900.0, 5.75, True), (290.0, 5.75, True), (190.0, 5.75, False), (-130.0, 5.75, False), (900.0, 3.5, False)],
)
def test_skin_is_no_haze_and_lies_beneath_the_ball(level_hu: float, depth_mm: float, expected: bool) -> None:
    theta = np.concatenate([np.zeros(len(PARAMETERS)), [level_hu, 0.0, -1.0 / depth_mm, 0.0]])
    theta[RADIUS] = 5.75
    assert is_skin(theta) is expected


@pytest.mark.parametrize(("radius_mm", "blur_mm"), [(2.0, 0.6), (2.0, 0.3), (5.75, 0.5), (12.5, 0.8)])
def test_a_plane_that_the_ball_touches_is_met_in_this_share_of_the_directions(
    radius_mm: float, blur_mm: float
) -> None:
    theta = np.zeros(len(PARAMETERS))
    theta[[RADIUS, BLUR, WIDTH, CONTRAST]] = radius_mm, blur_mm, np.sqrt(12.0) * blur_mm, 1000.0
    directions = np.random.default_rng(3).normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, np.newaxis]
    places = (
        radius_mm + 2.5 * np.hypot(blur_mm, 0.1) + 0.25
    ) * directions  # where `judge` looks, two to three blurs out
    assert share_on_skin(theta, 1000.0) == pytest.approx(np.mean(places[:, 2] < -radius_mm), abs=0.004)


def test_a_screws_end_in_the_face_that_a_ball_touches_does_not_make_the_face_brighter() -> None:
    excess_hu = np.r_[np.zeros(160), np.full(36, 1000.0), np.full(4, 20_000.0)]
    assert face_hu(excess_hu, 1000.0) == 1000.0
    assert face_hu(np.zeros(200), 1000.0) == 0.0


@pytest.mark.parametrize("material", ["aluminium", "ceramic"])
def test_a_ball_of_plastic_is_found_flush_on_the_face_of_what_is_brighter(material: str) -> None:
    face = Part(box((1.0, -6.0, 3.0), (30.0, 8.0, 12.0)), material)
    ball = Part(sphere((1.0, 2.0, 3.0), 8.0), "acrylic")
    found = localize(scan(Scene((face, ball)), small_stack(), blur_mm=0.35), diameter_mm=8.0)
    assert len(found) == 1
    assert np.linalg.norm(found[0].center_mm - [1.0, 2.0, 3.0]) < 0.02
    assert FiducialFlag.NEIGHBOUR in found[0].flags


def test_a_ball_of_plastic_is_found_flush_on_steel_of_which_the_scale_shows_the_fifth_part() -> None:
    face = Part(box((1.0, -6.0, 3.0), (30.0, 8.0, 12.0)), "steel")
    ball = Part(sphere((1.0, 2.0, 3.0), 8.0), "acrylic")
    whole = scan(Scene((face, ball)), small_stack(), blur_mm=0.35)
    found = localize(replace(whole, voxels_hu=np.minimum(whole.voxels_hu, np.int16(3071))), diameter_mm=8.0)
    assert len(found) == 1
    assert np.linalg.norm(found[0].center_mm - [1.0, 2.0, 3.0]) < 0.02
    assert FiducialFlag.NEIGHBOUR in found[0].flags


def test_a_face_at_the_end_of_the_scale_may_be_brighter_than_it_reads() -> None:
    excess_hu = np.r_[np.zeros(160), np.full(40, 4000.0)]
    assert face_hu(excess_hu, 1000.0, 4071.0) > 12_000.0
    assert face_hu(excess_hu, 1000.0, 5000.0) == 4000.0


def test_what_stands_on_two_sides_alike_is_no_skin() -> None:
    fit = fit_place(Scan(scan(balls([(1.0, 2.0, 3.0)]), small_stack())), np.array([1.0, 2.0, 3.0]), 11.5)
    heights = cell_directions()[:, 2]
    above, below = heights > np.sort(heights)[-13], heights < np.sort(heights)[12]
    faint_hu = np.full(len(heights), 300.0)
    beneath = replace(fit.verdict, beside=below, excess_hu=faint_hu)
    assert lies_on_something(fit.theta, beneath)
    assert not lies_on_something(fit.theta, replace(beneath, beside=above | below))
