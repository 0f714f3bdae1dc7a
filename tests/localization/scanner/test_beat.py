"""Slices that were computed at nearly the distance of the measured ones are known by their noise, and doubted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri

from phantoms.scene import Part, Scene
from phantoms.solids import half_space
from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.localization import localize
from ronnaplan.localization.scanner.beat import DISPLACED_SHARE, noise_beats
from ronnaplan.localization.scanner.scan import Scan
from tests.localization.scanner.test_measured import resampled
from tests.long import few_and_others, few_or_all
from tests.scans import balls, scan, small_stack

GAP_MM = 0.8


def soft_tissue(seed: int, count: int = 90, noise_hu: float = 10.0) -> CTVolume:
    """Slices of 40 HU, in which the noise changes slowly, as a tube's current makes it over a head."""
    generator = np.random.default_rng(seed)
    scale = noise_hu * (1.0 + 0.4 * np.sin(np.arange(count) / 6.0))[:, np.newaxis, np.newaxis]
    voxels_hu = np.round(40.0 + scale * generator.normal(size=(count, 96, 96))).astype(np.int16)
    origins_mm = np.arange(count)[:, np.newaxis] * np.array([0.0, 0.0, GAP_MM])
    return CTVolume(voxels_hu, SliceGrid(origins_mm, np.array([0.0, 0.5, 0.0]), np.array([0.5, 0.0, 0.0]), GAP_MM))


@pytest.mark.parametrize("seed", range(4))
def test_the_noise_of_measured_slices_does_not_beat(seed: int) -> None:
    assert not noise_beats(soft_tissue(seed))
    assert not noise_beats(soft_tissue(seed, count=28))
    assert not noise_beats(soft_tissue(seed, noise_hu=0.0))


@few_or_all("cases", 2, 6)
@pytest.mark.parametrize("shown", range(13, 29))
def test_few_slices_of_soft_tissue_tell_nothing(shown: int, cases: int) -> None:
    """As a scan of the crown has them: one told slice ended in a division by zero, and a wave fits any three."""
    beats = []
    for seed in range(cases):
        volume = soft_tissue(seed)
        noise = np.random.default_rng(seed).normal(size=len(volume.voxels_hu)) * 0.3
        voxels_hu = np.round(40.0 + (volume.voxels_hu - 40.0) * np.exp(noise)[:, np.newaxis, np.newaxis])
        voxels_hu[shown:] = -1000.0
        beats.append(noise_beats(replace(volume, voxels_hu=voxels_hu.astype(np.int16))))
    assert beats == cases * [False]


@pytest.mark.parametrize(("step_mm", "start_mm"), [(0.9, 0.0), (1.0, 0.3), (1.2, 0.1), (0.64, 0.5)])
def test_the_noise_of_computed_slices_beats(step_mm: float, start_mm: float) -> None:
    assert noise_beats(resampled(soft_tissue(1), step_mm, start_mm))


def test_streaks_of_fillings_that_come_and_go_are_no_beat() -> None:
    """A short scan of the jaw, of which three rows of fillings streak in four slices each."""
    volume = soft_tissue(3, count=40)
    streaks_hu = 60.0 * np.random.default_rng(3).normal(size=volume.voxels_hu.shape)
    streaks_hu[(np.arange(40) < 11) | (np.arange(40) > 28) | ((np.arange(40) - 11) % 7 > 3)] = 0.0
    assert not noise_beats(replace(volume, voxels_hu=np.round(volume.voxels_hu + streaks_hu).astype(np.int16)))


@few_and_others("seed", range(1), range(1, 4))
def test_screws_that_stand_in_every_seventh_slice_are_no_beat(seed: int) -> None:
    """Their streaks are alike in neighbouring slices, and add to noise that is not."""
    volume = soft_tissue(seed, count=38)
    streaks_hu = 7.0 * np.random.default_rng(seed).normal(size=volume.voxels_hu.shape[1:])
    strength = (0.5 + 0.5 * np.cos(2.0 * np.pi * np.arange(38) / 7.0))[:, np.newaxis, np.newaxis]
    assert not noise_beats(replace(volume, voxels_hu=np.round(volume.voxels_hu + strength * streaks_hu)))


def test_what_all_slices_share_is_no_beat() -> None:
    """In the middle between two measured slices each is blurred alike, which one profile describes."""
    assert not noise_beats(resampled(soft_tissue(2), GAP_MM, GAP_MM / 2.0))


def test_balls_in_computed_slices_are_displaced_by_no_more_than_is_stated() -> None:
    places = [(-18.0, -8.3, -6.2), (17.4, -9.0, 4.1), (1.2, 11.5, 1.3), (-14.0, 12.0, 8.0)]
    skin = Scene((Part(half_space((0.0, 0.0, -16.0), (0.0, 0.0, 1.0)), "skin"),))
    measured = scan(skin + balls(places), small_stack(start_mm=-40, spacing_mm=GAP_MM), noise_hu=10.0)
    found = localize(measured, diameter_mm=11.5, expected=4)
    assert VolumeFlag.REFORMATTED not in found.volume_flags
    normalized = []
    for start_mm in (0.0, 0.2, 0.5):
        computed = resampled(measured, 0.9, start_mm)
        found = localize(computed, diameter_mm=11.5, expected=4)
        assert VolumeFlag.REFORMATTED in found.volume_flags
        least_mm2 = (DISPLACED_SHARE * 0.9) ** 2
        assert all(one.covariance_mm2[2, 2] > least_mm2 for one in found)
        for one in found:
            true_mm = min(places, key=lambda place: float(np.linalg.norm(one.center_mm - place)))
            error_mm = one.center_mm - true_mm
            normalized.append(float(error_mm @ np.linalg.solve(one.covariance_mm2, error_mm)))
    assert max(normalized) < chdtri(3, 0.001)
    assert np.mean(normalized) / 3.0 > 0.1  # they are displaced indeed


def test_what_is_made_of_a_scan_is_computed_as_that_is() -> None:
    whole = Scan(resampled(soft_tissue(3), 0.9, 0.0))
    part = Scan(replace(whole.volume, voxels_hu=whole.volume.voxels_hu[:20]), whole=whole)
    assert part.is_computed
