"""Slices that were computed between others are left out; those that were measured never are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.errors import InputError
from ronnaplan.localization import localize
from ronnaplan.localization.scanner.measured import measured
from tests.scans import balls, scan, small_stack, with_slices

PLACES = [(-18.0, -8.3, -6.2), (17.4, -9.0, 4.1), (1.2, 11.5, 1.3)]


@pytest.fixture(scope="module")
def thick() -> CTVolume:
    stack = small_stack(spacing_mm=5.0, thickness_mm=5.0, start_mm=-25, stop_mm=25)
    return scan(balls(PLACES), stack, noise_hu=8.0)


def resampled(volume: CTVolume, step_mm: float, start_mm: float, kind: type[np.generic] = np.int16) -> CTVolume:
    """Slices every ``step_mm`` from ``start_mm`` on, by straight lines; the header has their thickness."""
    gap_mm = volume.grid.typical_gap_mm
    places = np.arange(start_mm, gap_mm * (len(volume.voxels_hu) - 1), step_mm) / gap_mm
    below = np.minimum(places.astype(int), len(volume.voxels_hu) - 2)
    share = (places - below)[:, np.newaxis, np.newaxis]
    voxels_hu = volume.voxels_hu[below] * (1.0 - share) + volume.voxels_hu[below + 1] * share
    stored = voxels_hu if kind is np.float32 else np.round(voxels_hu)
    return with_slices(volume, places, np.asarray(stored, dtype=kind), step_mm)


@pytest.mark.parametrize(("step_mm", "start_mm"), [(1.0, 0.0), (2.5, 0.0), (2.0, 0.0), (1.0, 0.3), (2.5, 0.8)])
def test_balls_in_slices_computed_from_thick_ones_are_found_as_in_these(
    thick: CTVolume, step_mm: float, start_mm: float
) -> None:
    thin = resampled(thick, step_mm, start_mm)
    kept = measured(thin)
    beyond_mm = kept.grid.slice_positions_mm[:, np.newaxis] - thick.grid.slice_positions_mm
    assert np.abs(beyond_mm).min(axis=1).max() < 0.03  # what lies there was measured, or is told by what does
    np.testing.assert_allclose(np.diff(kept.grid.slice_positions_mm), 5.0, atol=0.05)
    found = localize(thin, diameter_mm=11.5, expected=3)
    errors_mm = [np.linalg.norm(found.centers - place, axis=1).min() for place in PLACES]
    assert max(errors_mm) < 0.05
    assert VolumeFlag.REFORMATTED in found.volume_flags


@pytest.mark.parametrize("step_mm", [1.0, 1.6])
def test_slices_whose_fractions_were_cut_off_toward_zero_are_recognized_too(
    thick: CTVolume, step_mm: float
) -> None:
    """As ITK does, whose whole numbers may lie just below themselves."""
    noise_hu = np.random.default_rng(1).normal(0.0, 40.0, thick.voxels_hu.shape)  # about 0 HU
    soft = replace(thick, voxels_hu=np.asarray(np.round(noise_hu), dtype=np.int16))
    exact = resampled(replace(soft, voxels_hu=soft.voxels_hu.astype(np.float32)), step_mm, 0.0, np.float32)
    kept = measured(replace(exact, voxels_hu=np.trunc(exact.voxels_hu * (1.0 - 1e-6)).astype(np.int16)))
    np.testing.assert_allclose(np.diff(kept.grid.slice_positions_mm), 5.0, atol=0.05)
    assert len(kept.voxels_hu) >= len(thick.voxels_hu) - 1


def test_slices_that_were_measured_are_all_kept(thick: CTVolume) -> None:
    assert measured(thick) is thick
    alike = np.repeat(thick.voxels_hu[4:5], len(thick.voxels_hu), axis=0)
    still = replace(thick, voxels_hu=np.asarray(alike, dtype=np.int16))
    assert measured(still) is still  # what does not change tells nothing


def test_where_not_all_computed_slices_are_recognized_the_scan_is_left_as_it_is(thick: CTVolume) -> None:
    thin = resampled(thick, 1.0, 0.0)
    voxels_hu = thin.voxels_hu.copy()
    voxels_hu[22:29, 5, 5] += np.array([0, 40, 0, 0, 40, 0, 0], dtype=np.int16)  # as a scale's end changes some
    spoiled = replace(thin, voxels_hu=voxels_hu)
    assert measured(spoiled) is spoiled


def test_a_single_slice_is_refused(thick: CTVolume) -> None:
    grid = replace(thick.grid, origins_mm=thick.grid.origins_mm[:1])
    with pytest.raises(InputError, match="single slice"):
        localize(replace(thick, voxels_hu=thick.voxels_hu[:1], grid=grid), diameter_mm=11.5)
