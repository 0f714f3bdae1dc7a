"""Voxels are gathered at their true places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.localization.fit.neighbourhood import gather
from tests.scans import balls, scan, small_stack


def test_offsets_lead_from_the_center_to_the_voxels() -> None:
    volume = scan(balls([(0, 0, 0)]), small_stack(tilt_deg=18.0))
    center = np.array([2.0, -3.0, 4.0])
    around = gather(volume, center, 8.0, volume.grid.axes)
    indices = volume.grid.indices(around.offsets_mm @ around.axes + center)
    assert indices == pytest.approx(np.round(indices), abs=1e-6)
    numbers = np.round(indices).astype(int)
    assert np.array_equal(numbers[:, 0], around.slices)
    assert np.array_equal(volume.voxels_hu[tuple(numbers.T)], around.values_hu)
    assert np.linalg.norm(around.offsets_mm, axis=1).max() <= 8.0
    ball_volume, voxel_volume = 4 / 3 * np.pi * 8**3, 0.25 * np.median(volume.grid.spacings_mm)
    assert len(around.values_hu) == pytest.approx(ball_volume / voxel_volume, rel=0.02)


def test_a_place_outside_the_scan_has_no_voxels() -> None:
    volume = scan(balls([(0, 0, 0)]), small_stack())
    assert len(gather(volume, np.array([0.0, 0.0, 500.0]), 8.0, volume.grid.axes).values_hu) == 0


def test_of_the_voxels_that_are_kept_all_is_told_as_before() -> None:
    volume = scan(balls([(0, 0, 0)]), small_stack())
    around = gather(volume, np.array([2.0, -3.0, 4.0]), 8.0, volume.grid.axes)
    around = replace(around, floors_hu=np.random.default_rng(1).normal(-1000.0, 10.0, len(around.values_hu)))
    chosen = around.values_hu > -500.0
    some = around.select(chosen)
    for name in ("slices", "offsets_mm", "values_hu", "floors_hu"):
        np.testing.assert_array_equal(getattr(some, name), getattr(around, name)[chosen])
    assert len(around.select(np.zeros_like(chosen)).offsets_mm) == 0
