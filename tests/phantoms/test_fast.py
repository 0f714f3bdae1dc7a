from __future__ import annotations

import numpy as np
import pytest

from benchmarks.phantom_measures import moments
from phantoms.averages import average_hu
from phantoms.fast import render
from phantoms.materials import MATERIALS
from phantoms.scene import Part, Scene
from phantoms.solids import FloatArray, cylinder, sphere
from phantoms.stack import axial_stack

TURN = np.linalg.qr(np.array([[0.3, -0.5, 0.8], [0.9, 0.2, -0.4], [0.1, 0.7, 0.6]]))[0]
TURN *= np.sign(np.linalg.det(TURN))


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0])
@pytest.mark.parametrize("orientation", [np.eye(3), TURN], ids=["axial", "oblique"])
def test_a_ball_keeps_place_and_mass(tilt_deg: float, orientation: FloatArray) -> None:
    center = orientation @ [3.3, -2.1, 1.234]
    scene = Scene((Part(sphere(center, 11.5), "acrylic"),))
    stack = axial_stack(
        start_mm=-14,
        stop_mm=15,
        spacing_mm=1.0,
        matrix=48,
        field_of_view_mm=40,
        tilt_deg=tilt_deg,
        orientation=orientation,
    )
    centroid, mass = moments(average_hu(scene, stack) + 1000, stack, center, np.inf)
    assert centroid == pytest.approx(center, abs=0.002)
    assert mass == pytest.approx((1000 + MATERIALS["acrylic"].nominal_hu) * np.pi / 6 * 11.5**3, rel=2e-3)


def test_inner_parts_replace_outer_ones() -> None:
    scene = Scene(
        (
            Part(sphere((0, 0, 0), 30), "water"),
            Part(cylinder((0, 0, -5), (0, 0, 1), 10, 12), "titanium"),
            Part(sphere((0, 0, 0), 6), "air"),
        )
    )
    stack = axial_stack(start_mm=0, stop_mm=0, spacing_mm=1.0, matrix=41, field_of_view_mm=41)
    row = average_hu(scene, stack)[0, 20]
    assert row[[0, 10, 16, 20]] == pytest.approx([-1000, 0, MATERIALS["titanium"].nominal_hu, -1000], abs=0.5)


def test_noise_has_the_asked_level_and_the_seed_repeats_it() -> None:
    scene = Scene((Part(cylinder((0, 0, -50), (0, 0, 1), 100, 400), "water"),))
    stack = axial_stack(start_mm=0, stop_mm=4, matrix=128, field_of_view_mm=100)
    images = render(scene, stack, noise_hu=12.0, seed=5)
    assert images.std() == pytest.approx(12.0, rel=0.03)
    assert (images == render(scene, stack, noise_hu=12.0, seed=5)).all()
    assert (images != render(scene, stack, noise_hu=12.0, seed=6)).any()
