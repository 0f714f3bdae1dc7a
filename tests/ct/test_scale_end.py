"""A scale's end is found where it is sharp and where something after it made it ragged, and nowhere else."""

from __future__ import annotations

import math

import numpy as np
import pytest

from phantoms.fast import render_hu
from ronnaplan.ct.scale_end import RAGGED_HU, scale_end_hu
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import FiducialFlag, localize
from tests.scans import balls, on_grid, small_stack

STACK = small_stack(spacing_mm=0.6, thickness_mm=0.6)


@pytest.fixture(scope="module")
def metal() -> FloatArray:
    """Images of a ball of titanium, neither clipped nor with noise."""
    return render_hu(balls([(3.0, -4.0, 1.0)], 4.0, "titanium"), STACK, blur_mm=0.4, noise_hu=0.0)


def after_the_end(images: FloatArray, spread_hu: float, *, cut_again: bool) -> FloatArray:
    """Clip the images with a noise of 12 HU, and disturb them afterwards."""
    draws = np.random.default_rng(5)
    clipped = np.clip(images + draws.normal(0.0, 12.0, images.shape), -1024.0, 3071.0)
    disturbed = clipped + spread_hu * draws.standard_normal(images.shape)
    return np.round(np.clip(disturbed, -1024.0, 3071.0) if cut_again else disturbed)


def test_a_sharp_end_is_told_to_the_last_digit(metal: FloatArray) -> None:
    assert scale_end_hu(after_the_end(metal, 0.0, cut_again=False).astype(np.int16)) == 3071.0


@pytest.mark.parametrize("cut_again", [False, True])
@pytest.mark.parametrize("spread_hu", [2.0, 6.0])
def test_metal_is_found_in_scans_that_were_changed_after_their_scale_had_ended(
    metal: FloatArray, spread_hu: float, cut_again: bool
) -> None:
    images = after_the_end(metal, spread_hu, cut_again=cut_again).astype(np.int16)
    assert 3071.0 - 1.5 * RAGGED_HU < scale_end_hu(images) < 3071.0
    (found,) = localize(on_grid(images, STACK), diameter_mm=4.0)
    assert np.linalg.norm(found.center_mm - [3.0, -4.0, 1.0]) < 0.02
    assert FiducialFlag.CLIPPED in found.flags


@pytest.mark.parametrize("noise_hu", [10.0, 25.0])
def test_what_is_bright_and_not_cut_off_is_no_end(noise_hu: float) -> None:
    ball = render_hu(balls([(0.0, 0.0, 0.0)], 11.5, "ceramic"), STACK, blur_mm=0.5, noise_hu=noise_hu)
    assert float(np.percentile(ball, 99.9)) > 2000.0
    assert scale_end_hu(ball.astype(np.float32)) == math.inf


@pytest.mark.parametrize("top_hu", [400.0, 1000.0, 1900.0])
def test_metal_is_found_in_exports_whose_scale_was_cut_off(metal: FloatArray, top_hu: float) -> None:
    images = np.minimum(after_the_end(metal, 0.0, cut_again=False), top_hu).astype(np.int16)
    assert scale_end_hu(images) == top_hu
    (found,) = localize(on_grid(images, STACK), diameter_mm=4.0)
    assert np.linalg.norm(found.center_mm - [3.0, -4.0, 1.0]) < 0.02
    assert FiducialFlag.CLIPPED in found.flags


def test_metal_is_refused_where_air_was_cut_off_too(metal: FloatArray) -> None:
    images = np.clip(after_the_end(metal, 0.0, cut_again=False), -200.0, 1000.0).astype(np.int16)
    found = localize(on_grid(images, STACK), diameter_mm=4.0)
    assert not len(found)
    assert "begins at -200 HU" in found.rejected[0].reason


def test_an_extended_scale_whose_metal_thins_out_has_no_end() -> None:
    draws = np.random.default_rng(3)
    images = np.full((4, 64, 64), -1000.0)
    images[1, :, :32] = 1500.0 + draws.exponential(1500.0, (64, 32))
    assert scale_end_hu(images.astype(np.float32)) == math.inf


def test_a_few_voxels_of_enamel_are_no_end() -> None:
    images = np.full((4, 64, 64), -1000, dtype=np.int16)
    images[2, 10, 10:15] = (1850, 1930, 2005, 2020, 2030)
    assert scale_end_hu(images) == math.inf


def test_voxels_that_are_no_numbers_are_refused(metal: FloatArray) -> None:
    images = metal.copy()
    images[0, 0, 0] = np.nan
    with pytest.raises(InputError, match="no numbers"):
        scale_end_hu(images.astype(np.float32))
