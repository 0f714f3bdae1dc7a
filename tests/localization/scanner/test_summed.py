"""What slices do to a ball whose rays are summed before the logarithm, against rays summed one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skimage.transform import iradon

from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.scanner.summed import UNTOLD, WATER_PER_MM, Summed, lost_hu, slope_beside_per_mm

PIXEL_MM, PIXELS = 0.25, 97
RADIUS_MM, BLUR_MM, WIDTH_MM, CONTRAST_HU = 6.0, 0.6, 3.0, 1300.0
THETA = np.array([0.0, 0.0, 0.0, RADIUS_MM, BLUR_MM, 0.0, WIDTH_MM, 0.0, CONTRAST_HU, -1000.0, 0.0, 0.0, 0.0])
"""A ball in box-like slices of 3 mm."""


def summed_picture_hu(place_mm: float, slope: float) -> FloatArray:
    """How much darker a slice at ``place_mm`` is: rays added up before the logarithm, by filtered back-projection."""
    beside_mm = (np.arange(PIXELS) - PIXELS // 2) * PIXEL_MM
    heights_mm = (np.arange(400) + 0.5) / 400 * WIDTH_MM - WIDTH_MM / 2
    squares_mm2 = RADIUS_MM**2 - beside_mm[:, np.newaxis] ** 2 - (place_mm + heights_mm) ** 2
    losses = CONTRAST_HU / 1000 * WATER_PER_MM * 2 * np.sqrt(np.maximum(squares_mm2, 0))
    first = -np.log(np.exp(-losses - slope * heights_mm).mean(axis=1) / np.exp(-slope * heights_mm).mean())
    frequencies = np.fft.fftfreq(PIXELS, PIXEL_MM)
    blurred = np.fft.ifft(
        np.fft.fft(losses.mean(axis=1) - first) * np.exp(-2 * (np.pi * BLUR_MM * frequencies) ** 2)
    )
    sinogram = np.repeat(blurred.real[:, np.newaxis], 180, axis=1) / PIXEL_MM
    picture: FloatArray = iradon(sinogram, np.arange(180.0), circle=False, output_size=PIXELS)
    return picture / WATER_PER_MM * 1000


@pytest.mark.parametrize("place_mm", [0.0, 2.2, 5.0, 6.7])
@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_what_summing_takes_is_what_back_projection_makes_of_it(place_mm: float, slope: float) -> None:
    picture_hu = summed_picture_hu(place_mm, slope)
    v, u = (np.indices(picture_hu.shape) - PIXELS // 2) * PIXEL_MM
    near = np.hypot(u, v) < 10.0
    offsets_mm = np.stack([u[near], v[near], np.full(near.sum(), place_mm)], axis=-1)
    around = Neighbourhood(
        np.zeros(3),
        np.eye(3),
        np.zeros(near.sum(), np.intp),
        offsets_mm,
        picture_hu[near],
        np.full(near.sum(), -1000.0),
        PIXEL_MM,
    )
    told_hu = lost_hu(around, THETA, slope)
    assert np.abs(told_hu - picture_hu[near]).max() < 0.05 * np.abs(picture_hu).max() + 0.3


def test_what_lies_beside_a_ball_is_told_by_its_mean_over_all_rays() -> None:
    """Lines through the middle of a disc of water are as long as it is wide; this one widens by 1 mm for each mm."""
    heights_mm = np.arange(-10.0, 11.0, 2.0)
    across_mm = (np.arange(401) - 200) * 0.5
    from_axis_mm = np.hypot(across_mm, across_mm[:, np.newaxis])
    inside = from_axis_mm < (60.0 + heights_mm / 2)[:, np.newaxis, np.newaxis]
    origins = np.array([[-100.0, -100.0, height] for height in heights_mm])
    grid = SliceGrid(origins, np.array([0.0, 0.5, 0.0]), np.array([0.5, 0.0, 0.0]), 2.0)
    volume = CTVolume(np.where(inside, 0, -1000).astype(np.int16), grid)
    place_mm = np.array([0.0, 0.0, 0.7])
    assert slope_beside_per_mm(volume, place_mm, 6.0) == pytest.approx(WATER_PER_MM, rel=0.05)
    unmeasured = volume.voxels_hu.copy()
    unmeasured[6:, :40] = 3000
    cut = replace(volume, voxels_hu=unmeasured, padding_hu=3000.0)
    assert slope_beside_per_mm(cut, place_mm, 6.0) == slope_beside_per_mm(volume, place_mm, 6.0)


def test_slices_of_which_nothing_is_told_leave_an_error_and_those_known_to_be_summed_after_do_not() -> None:
    assert UNTOLD.error_mm(5.0, -0.05) == pytest.approx(0.05 * 0.7 * 25 / 12, rel=0.05)
    assert UNTOLD.error_mm(0.6, 0.01) < 0.0005
    assert Summed(first=False, error=0.05).error_mm(5.0, 0.01) < 0.002
