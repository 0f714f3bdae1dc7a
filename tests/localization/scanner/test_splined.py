"""Slices that cubic splines computed show their balls as the thick ones did; others are left as they are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from ronnaplan.ct import CTVolume
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.localization import localize
from ronnaplan.localization.scanner.splined import before_splines
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack, with_slices

PLACES = [(-18.0, -8.3, -16.2), (17.4, -9.0, 9.1), (1.2, 11.5, 1.3)]


@pytest.fixture(scope="module")
def thick() -> CTVolume:
    stack = small_stack(spacing_mm=5.0, thickness_mm=5.0, start_mm=-45, stop_mm=45)
    return scan(balls(PLACES), stack, noise_hu=8.0)


def splined(volume: CTVolume, step_mm: float, start_mm: float = 0.0, order: int = 3) -> CTVolume:
    """Slices every ``step_mm`` from ``start_mm`` on, by splines of an ``order``."""
    gap_mm = volume.grid.typical_gap_mm
    places = np.arange(start_mm, gap_mm * (len(volume.voxels_hu) - 1) + 1e-6, step_mm) / gap_mm
    at = np.meshgrid(places, *(np.arange(size) for size in volume.voxels_hu.shape[1:]), indexing="ij")
    interpolated: Any = ndimage.map_coordinates
    voxels_hu = interpolated(volume.voxels_hu.astype(np.float64), at, order=order, mode="mirror")
    return with_slices(volume, places, np.round(voxels_hu).astype(np.int16), step_mm)


@few_and_others(("step_mm", "start_mm"), [(2.5, 1.25), (0.7, 0.3)], [(1.0, 0.0), (1.25, 0.625)])
def test_slices_that_splines_computed_tell_the_thick_ones(
    thick: CTVolume, step_mm: float, start_mm: float
) -> None:
    made = before_splines(splined(thick, step_mm, start_mm))
    heights_mm = made.grid.slice_positions_mm
    nearest = np.round((heights_mm - thick.grid.slice_positions_mm[0]) / 5.0).astype(int)
    np.testing.assert_allclose(heights_mm, thick.grid.slice_positions_mm[nearest], atol=0.02)
    assert np.abs(made.voxels_hu.astype(float) - thick.voxels_hu[nearest]).max() < 5.0
    assert len(made.voxels_hu) >= len(thick.voxels_hu) - 2  # both ends lie beyond
    assert VolumeFlag.REFORMATTED in made.flags


def test_balls_in_slices_that_splines_computed_are_found(thick: CTVolume) -> None:
    found = localize(splined(thick, 1.0), diameter_mm=11.5, expected=3)
    assert max(np.linalg.norm(found.centers - place, axis=1).min() for place in PLACES) < 0.05


def test_what_no_cubic_splines_computed_is_left_as_it_is(thick: CTVolume) -> None:
    assert before_splines(thick) is thick
    lines = splined(thick, 1.0, order=1)
    assert before_splines(lines) is lines or len(before_splines(lines).voxels_hu) == len(thick.voxels_hu)
    smooth = replace(
        thick, voxels_hu=np.asarray(ndimage.gaussian_filter1d(thick.voxels_hu, 2.0, axis=0), np.int16)
    )
    assert before_splines(smooth) is smooth


def test_a_few_voxels_that_are_otherwise_leave_the_scan_as_it_is(thick: CTVolume) -> None:
    """As where it was edited since: a mixture of both would show markers through different profiles."""
    made = splined(thick, 1.0)
    voxels_hu = made.voxels_hu.copy()
    voxels_hu[40:43, 60:63, 60:63] += 40
    edited = replace(made, voxels_hu=voxels_hu)
    assert before_splines(edited) is edited
