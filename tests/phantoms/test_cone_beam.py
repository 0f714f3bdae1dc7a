from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks import phantom_measures
from phantoms.beam import tube_beam
from phantoms.cone_beam import ConeBeam
from phantoms.cone_rays import Panel, Views, cone_transmission
from phantoms.errors import PhantomError
from phantoms.examination import Examination
from phantoms.fdk import parker_weights
from phantoms.patients import random_patient
from phantoms.rays import pack
from phantoms.scanner import matter
from phantoms.scene import Part, Scene
from phantoms.solids import FloatArray, box, cylinder, sphere
from phantoms.stack import SliceStack, axial_stack

SMALL = ConeBeam(dose=0.0, views=120, bin_mm=0.5, width_mm=110.0)
CENTER = np.array([24.3, -11.7, 20.2])
BALL = Scene((Part(sphere(CENTER, 11.5), "acrylic"),))
ROD = Scene((Part(cylinder((*CENTER[:2], -80), (0, 0, 1), 200, 11.5), "acrylic"),))


def voxels(start_mm: float, stop_mm: float, **options: Any) -> SliceStack:
    return axial_stack(
        start_mm=start_mm, stop_mm=stop_mm, spacing_mm=0.5, matrix=200, field_of_view_mm=100, **options
    )


NEAR = voxels(10, 30.5).around(CENTER, 9.5, crop=True)
SLICE = voxels(0, 0).around((*CENTER[:2], 0), 9.5, crop=True)


def centroid(scene: Scene, stack: SliceStack, scanner: ConeBeam) -> FloatArray:
    """Return the centroid (mm) of what rises above air near `CENTER`."""
    (images,) = scanner.reconstruct(scene, [stack])
    middle = CENTER if len(stack) > 1 else np.array([*CENTER[:2], 0])
    return phantom_measures.centroid(images + 1000.0, stack, middle, 8.5)


def test_a_ball_far_off_the_axis_and_off_the_middle_plane_is_where_it_should_be() -> None:
    assert centroid(BALL, NEAR, SMALL) == pytest.approx(CENTER, abs=0.004)


def test_half_a_turn_and_the_fan_show_a_rod_in_its_place() -> None:
    found = centroid(ROD, SLICE, replace(SMALL, turn="short", views=90))
    assert found[:2] == pytest.approx(CENTER[:2], abs=0.004)


def test_a_ray_and_its_opposite_count_once() -> None:
    widest = np.radians(12)
    for angle, fan in np.random.default_rng(2).uniform((0, -1), (1, 1), (200, 2)) * (np.pi + 2 * widest, widest):
        opposite = angle + np.array([-np.pi, np.pi]) - 2 * fan
        seen = np.array([angle, *opposite[(opposite >= 0) & (opposite <= np.pi + 2 * widest)]])
        fans = np.where(seen == angle, fan, -fan)
        weights = [parker_weights(seen[n : n + 1], fans[n : n + 1], widest)[0, 0] for n in range(len(seen))]
        assert sum(weights) == pytest.approx(1.0, abs=1e-9)


def test_a_ray_is_attenuated_by_what_it_crosses() -> None:
    scene = Scene(
        (
            Part(box((0, 0, 0), (60, 60, 60)), "water"),
            Part(sphere((0, 0, 0), 40), "acrylic"),
            Part(cylinder((0, 0, -5), (0, 0, 1), 10, 12), "titanium"),
        )
    )
    views = Views(*(np.array([row], dtype=float) for row in ((600, 0, 0), (0, 0, 0), (0, 1, 0), (0, 0, 1))))
    signal = np.empty((1, 1, 2), np.float32)
    beam = tube_beam(120.0)
    cone_transmission(
        pack([p.solid for p in scene.parts]),
        matter(scene, beam),
        Panel(10.0, 10.0, 0.0, 0.0, 1, 300.0),
        views,
        signal,
    )
    water, acrylic, titanium = beam.attenuation_per_mm(("water", "acrylic", "titanium"))
    straight = np.exp(-(20 * water + 28 * acrylic + 12 * titanium)) @ beam.weights
    assert signal[0, 0, 0] == pytest.approx(straight, rel=1e-5)
    slope = np.hypot(1, 10 / 600)
    distance = 10 / slope
    chord = 2 * np.sqrt(20**2 - distance**2)
    beside = np.exp(-((60 * slope - chord) * water + chord * acrylic)) @ beam.weights
    assert signal[0, 0, 1] == pytest.approx(beside, rel=1e-5)


def test_water_has_the_value_that_the_scanner_gives_it() -> None:
    disc = Scene((Part(cylinder((0, 0, -60), (0, 0, 1), 120, 80), "water"),))
    middle = voxels(0, 0).around((0, 0, 0), 30, crop=True)
    (plain,) = SMALL.reconstruct(disc, [middle])
    assert np.abs(plain[0, 20:-20, 20:-20]).max() < 4.0
    (shown,) = replace(SMALL, hu_scale=0.8, hu_offset=40.0).reconstruct(disc, [middle])
    assert shown == pytest.approx(0.8 * (plain + 1000) - 960, abs=0.01)


def test_noise_follows_dose_and_the_seed_repeats_it() -> None:
    disc = Scene((Part(cylinder((0, 0, -60), (0, 0, 1), 120, 80), "water"),))
    middle = voxels(0, 1).around((0, 0, 0), 20, crop=True)
    noisy = replace(SMALL, electronic_noise=0.0)
    quiet = SMALL.reconstruct(disc, [middle])[0]
    levels = [
        (replace(noisy, dose=dose).reconstruct(disc, [middle], seed=1)[0] - quiet).std() for dose in (1, 0.25)
    ]
    assert levels[1] / levels[0] == pytest.approx(2.0, rel=0.05)
    once, again, other = (replace(noisy, dose=1.0).reconstruct(disc, [middle], seed=s)[0] for s in (3, 3, 4))
    assert (once == again).all()
    assert (once != other).any()


def test_a_panel_that_lags_drags_the_image_along_its_turn() -> None:
    still, lagging = centroid(BALL, NEAR, SMALL), centroid(BALL, NEAR, replace(SMALL, lag=1.0))
    radial = np.array([*CENTER[:2], 0]) / np.hypot(*CENTER[:2])
    tangent = np.array([-radial[1], radial[0], 0])
    shift = (lagging - still) * 1000
    assert 5 < shift @ tangent < 100
    assert abs(shift @ radial) < 0.2 * shift @ tangent


def test_scatter_darkens_the_middle_and_truncation_ends_the_image() -> None:
    disc = Scene((Part(cylinder((0, 0, -60), (0, 0, 1), 120, 150), "water"),))
    middle = voxels(0, 0)
    (cut,) = replace(SMALL, width_mm=90.0).reconstruct(disc, [middle])
    assert (cut[0, 100, :8] == -1000).all()
    assert abs(cut[0, 100, 100]) < 150
    (scattered,) = replace(SMALL, width_mm=90.0, scatter=0.1).reconstruct(disc, [middle])
    assert scattered[0, 100, 100] < cut[0, 100, 100] - 10


def test_crops_show_what_the_whole_scan_shows() -> None:
    whole = Examination(BALL, voxels(10, 30.5), replace(SMALL, views=40))
    (crop,) = whole.crops([CENTER], 7.0)
    images = whole.images()
    k, v, u = (
        round(float(x))
        for x in ((crop.examination.stack.origins_mm[0] - whole.stack.origins_mm[0]) / 0.5)[[2, 1, 0]]
    )
    count, rows, columns = crop.images.shape
    assert np.abs(crop.images - images[k : k + count, v : v + rows, u : u + columns].astype(int)).max() <= 1


def test_a_marker_outside_the_panels_field_is_not_whole() -> None:
    patient = random_patient(1, protocol="cone beam truncated")
    narrow = replace(patient.stack, field_radius_mm=60.0)
    assert not any(narrow.holds_whole(one.center_mm, one.diameter_mm) for one in patient.scene.markers)
    assert patient.stack.field_radius_mm == patient.scanner.field_radius_mm < 130


def test_what_a_cone_beam_scanner_cannot_do_is_refused() -> None:
    with pytest.raises(PhantomError, match="turns about one axis"):
        SMALL.reconstruct(BALL, [voxels(0, 5, tilt_deg=10.0)])
    with pytest.raises(PhantomError, match="distance from source to axis in mm is 100"):
        ConeBeam(source_mm=100.0)
