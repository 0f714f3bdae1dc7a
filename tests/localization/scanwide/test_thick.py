"""Slices far thicker than their header says are known by small balls and noise together; eggs alone are no balls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from phantoms.fast import render_hu
from phantoms.scene import Part, Scene
from phantoms.solids import ellipsoid
from ronnaplan.ct import CTVolume
from ronnaplan.localization import localize
from ronnaplan.localization.scanwide.thick import noise_alike
from ronnaplan.localization.size import common_diameter, sizes_seen
from tests.long import few_and_others
from tests.scans import balls, on_grid, scan, small_stack

PLACES = [(-14.0, -13.6, 1.1), (13.7, -14.2, -0.8), (-13.9, 14.1, 0.3), (14.3, 13.8, 2.2)]
THIN = small_stack(start_mm=-15.0, stop_mm=15.0, spacing_mm=0.6, thickness_mm=0.6)


def smoothed(scene: Scene, sigma_mm: float) -> CTVolume:
    """Scan thin slices and blur along their normal, as filters do; the header stays as it is."""
    images = render_hu(scene, THIN, blur_mm=0.5, noise_hu=10.0, seed=1)
    thick = ndimage.gaussian_filter1d(images, sigma_mm / THIN.thickness_mm, axis=0)
    return on_grid(np.round(np.clip(thick, -1024.0, 3071.0)).astype(np.int16), THIN)


@few_and_others(("material", "diameter_mm"), [("titanium", 4.0)], [("acrylic", 6.0)])
def test_small_balls_are_found_in_slices_blurred_far_beyond_their_header(
    material: str, diameter_mm: float
) -> None:
    found = localize(
        smoothed(balls(PLACES, diameter_mm, material), 1.3), diameter_mm=diameter_mm, expected=len(PLACES)
    )
    off_mm = np.linalg.norm(found.centers[:, np.newaxis] - np.array(PLACES), axis=-1).min(axis=0)
    assert off_mm.max() < 0.02
    assert found.resolution is not None
    assert found.resolution.stated_mm == 0.6
    assert found.resolution.profile_mm == pytest.approx(2.355 * 1.3, rel=0.15)


@few_and_others("sigma_mm", [0.9], [1.3])
def test_nor_need_their_size_be_told(sigma_mm: float) -> None:
    volume = smoothed(balls(PLACES, 6.0), sigma_mm)
    assert common_diameter(volume, expected=len(PLACES)) == pytest.approx(6.0, abs=0.05)


def test_eggs_of_one_size_along_the_normal_are_no_balls_in_thick_slices() -> None:
    half_mm = (2.5, 2.5, 1.42 * 2.5)
    eggs = Scene(tuple(Part(ellipsoid(place, half_mm), "ceramic") for place in PLACES))
    volume = scan(eggs, THIN)
    assert len(localize(volume, diameter_mm=5.0)) == 0
    assert sizes_seen(volume) == ()


def test_noise_is_alike_as_far_as_it_is_blurred() -> None:
    sharp, blurred = scan(balls(PLACES, 6.0), THIN), smoothed(balls(PLACES, 6.0), 1.3)
    half_a_profile_mm = 0.5 * np.sqrt(12.0) * 1.3
    assert noise_alike(blurred, half_a_profile_mm) == pytest.approx(np.exp(-0.75), abs=0.08)
    assert noise_alike(blurred, 2.0 * half_a_profile_mm) < 0.15
    assert abs(noise_alike(sharp, half_a_profile_mm)) < 0.1
    noiseless = replace(sharp, voxels_hu=np.zeros_like(sharp.voxels_hu))
    assert np.isnan(noise_alike(noiseless, half_a_profile_mm))
    assert np.isnan(noise_alike(sharp, 100.0))  # no two slices lie so far apart


def test_noise_is_alike_beside_padding_that_is_not_the_darkest_of_the_scan() -> None:
    blurred = smoothed(balls(PLACES, 6.0), 1.3)
    padded_hu = blurred.voxels_hu.copy()
    padded_hu[:, :, 50:] = -500
    half_a_profile_mm = 0.5 * np.sqrt(12.0) * 1.3
    padded = replace(blurred, voxels_hu=padded_hu)
    assert noise_alike(padded, half_a_profile_mm) == pytest.approx(np.exp(-0.75), abs=0.1)
