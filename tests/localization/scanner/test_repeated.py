"""Scans enlarged by their nearest voxels show their markers as before; those that were not are left as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.localization import localize
from ronnaplan.localization.scanner.repeated import without_copies
from tests.scans import balls, scan, small_stack, with_slices

PLACES = [(-18.0, -8.3, -6.2), (17.4, -9.0, 4.1), (1.2, 11.5, 1.3)]


@pytest.fixture(scope="module")
def scanned() -> CTVolume:
    stack = small_stack(spacing_mm=2.5, thickness_mm=2.5, start_mm=-25, stop_mm=25)
    return scan(balls(PLACES), stack, noise_hu=8.0)


def nearest(volume: CTVolume, axis: int, by: float, start: float = 0.0) -> CTVolume:
    """Return ``by`` times as many slices, rows or columns, the first at ``start`` of the old ones, each the nearest."""
    at = np.arange(start, volume.voxels_hu.shape[axis] - 0.5, 1.0 / by)
    taken = np.asarray(np.take(volume.voxels_hu, np.floor(at + 0.5).astype(int), axis=axis), dtype=np.int16)
    grid = volume.grid
    if axis == 0:
        return with_slices(volume, at, taken, 1.0)
    name = ("row_step_mm", "column_step_mm")[axis - 1]
    step_mm = getattr(grid, name)
    moved = replace(grid, origins_mm=grid.origins_mm + start * step_mm)
    return replace(volume, voxels_hu=taken, grid=replace(moved, **{name: step_mm / by}))


@pytest.mark.parametrize(
    ("axis", "by", "start"),
    [
        (0, 2.5, 0.0),
        (0, 5.0, -0.4),
        (0, 3.7, 0.2),
        (0, 1.3, 0.0),
        (1, 2.0, -0.25),
        (1, 1.3, 0.0),
        (2, 3.0, -1.0 / 3.0),
    ],
)
def test_a_scan_enlarged_by_its_nearest_voxels_is_again_the_one_that_was_made(
    scanned: CTVolume, axis: int, by: float, start: float
) -> None:
    once, _ = without_copies(nearest(scanned, axis, by, start))
    np.testing.assert_array_equal(once.voxels_hu, scanned.voxels_hu)
    np.testing.assert_allclose(
        once.grid.positions_mm(np.full(3, 9.0)), scanned.grid.positions_mm(np.full(3, 9.0)), atol=0.12
    )
    np.testing.assert_allclose(once.grid.affine[:3, :3], scanned.grid.affine[:3, :3], atol=0.03)
    assert VolumeFlag.REPEATED in once.flags


def test_balls_in_slices_rows_and_columns_that_repeat_the_nearest_are_found_and_the_user_is_told(
    scanned: CTVolume,
) -> None:
    copied = nearest(nearest(nearest(scanned, 0, 2.5), 1, 2.0, -0.25), 2, 2.0, -0.25)
    found = localize(copied, diameter_mm=11.5, expected=3)
    assert max(np.linalg.norm(found.centers - place, axis=1).min() for place in PLACES) < 0.02
    assert VolumeFlag.REPEATED in found.volume_flags


@pytest.mark.parametrize(("by", "start"), [(4.0, 0.0), (4.0, -0.375), (4.0, -0.499), (2.0, 0.0)])
def test_where_copies_do_not_tell_where_slices_were_the_error_that_is_left_is_stated(
    scanned: CTVolume, by: float, start: float
) -> None:
    found = localize(nearest(scanned, 0, by, start), diameter_mm=11.5, expected=3)
    across_mm = np.array([np.sqrt(one.covariance_mm2[2, 2]) for one in found])
    nearest_one = [int(np.argmin(np.linalg.norm(np.array(PLACES) - one.center_mm, axis=1))) for one in found]
    off_mm = found.centers[:, 2] - np.array(PLACES)[nearest_one, 2]
    assert (np.abs(off_mm) < 1.1 * across_mm).all()
    assert across_mm == pytest.approx(2.5 / by / 2.0, rel=0.15)


def test_a_scan_that_repeats_nothing_is_left_as_it_is(scanned: CTVolume) -> None:
    once, unplaced_mm2 = without_copies(scanned)
    assert once is scanned
    assert not unplaced_mm2.any()


def test_slices_that_are_alike_for_another_reason_are_kept(scanned: CTVolume) -> None:
    """As those of a phantom without noise beside its balls, and as air that the scale cuts off."""
    still = scanned.voxels_hu.copy()
    still[:7] = still[0]
    assert without_copies(replace(scanned, voxels_hu=still))[0].voxels_hu is still
    cut = np.asarray(np.where(scanned.voxels_hu < -500, -1000, scanned.voxels_hu), dtype=np.int16)
    assert without_copies(replace(scanned, voxels_hu=cut))[0].voxels_hu is cut
