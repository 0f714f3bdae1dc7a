"""Metal that was cut off before its scan was resampled is found; what is too large or not cut off stays refused."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from phantoms.fast import render_hu
from phantoms.stack import SliceStack
from ronnaplan.ct import CTVolume
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import FiducialFlag, localize
from ronnaplan.localization.examine import Examined, examine
from ronnaplan.localization.fiducials import Fiducials
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.cut_before import as_cut_before
from tests.scans import balls, on_grid, small_stack

PLACES = [(-14.0, -13.6, 1.1), (13.7, -14.2, -0.8), (-13.9, 14.1, 0.3), (14.3, 13.8, 2.2)]
DIAMETER_MM = 6.0
STACK = small_stack(start_mm=-15.0, stop_mm=15.0, spacing_mm=0.8, thickness_mm=0.8, matrix=104)
END_HU = 3071.0
CHI2_95 = 7.815
"""Squared normalized errors of three axes exceed this in 5 %."""


@cache
def unclipped_hu(diameter_mm: float, material: str) -> FloatArray:
    """Voxels (K, J, I) as the scanner had them, brighter than any scale."""
    return render_hu(balls(PLACES, diameter_mm, material), STACK, blur_mm=0.5, noise_hu=10.0, seed=1)


def turned(images_hu: FloatArray, order: Literal[1, 3]) -> tuple[CTVolume, FloatArray]:
    """Cut off and turn a scan about its middle by splines; return it, and where its balls (N, 3) are then."""
    cut_hu = np.rint(np.clip(images_hu, -1024.0, END_HU))
    stack, (across, within) = STACK, np.radians([7.0, 11.0])
    steps_mm = np.array([stack_gap_mm(stack), stack.pixel_mm, stack.pixel_mm])
    tilt = np.array([[np.cos(across), -np.sin(across), 0], [np.sin(across), np.cos(across), 0], [0, 0, 1]])
    spin = np.array([[1, 0, 0], [0, np.cos(within), -np.sin(within)], [0, np.sin(within), np.cos(within)]])
    turn = tilt @ spin  # of (z, y, x)
    by_index = np.diag(1.0 / steps_mm) @ turn.T @ np.diag(steps_mm)
    middle = (np.array(images_hu.shape) - 1) / 2
    new_hu = ndimage.affine_transform(
        cut_hu, by_index, middle - by_index @ middle, order=order, mode="constant", cval=-1024.0
    )
    volume = on_grid(as_stored(new_hu), stack)
    middle_mm = volume.grid.positions_mm(middle[np.newaxis])[0]
    places_mm = (np.array(PLACES) - middle_mm)[:, ::-1] @ turn.T
    return volume, places_mm[:, ::-1] + middle_mm


def stack_gap_mm(stack: SliceStack) -> float:
    """Distance between neighbouring slices."""
    return float(np.diff(stack.positions_mm)[0])


def as_stored(images_hu: FloatArray) -> NDArray[np.int16]:
    return np.rint(np.clip(images_hu, -32768.0, 32767.0)).astype(np.int16)


def off_by(found: Fiducials, places_mm: FloatArray) -> FloatArray:
    """By what each marker is off the place that is nearest, (M, 3)."""
    apart_mm = found.centers[:, np.newaxis] - places_mm
    nearest = np.linalg.norm(apart_mm, axis=-1).argmin(axis=1)
    off_mm: FloatArray = apart_mm[np.arange(len(found)), nearest]
    return off_mm


@pytest.mark.parametrize("order", [1, 3], ids=["straight lines", "splines"])
def test_metal_that_was_cut_off_and_then_turned_is_found_and_its_error_stated(order: Literal[1, 3]) -> None:
    volume, places_mm = turned(unclipped_hu(DIAMETER_MM, "steel"), order)
    found = localize(volume, diameter_mm=DIAMETER_MM, expected=len(PLACES))
    off_mm = off_by(found, places_mm)
    assert np.linalg.norm(off_mm, axis=1).max() < 0.12
    stated = np.array([one.covariance_mm2 for one in found])
    assert np.einsum("ni,nij,nj->n", off_mm, np.linalg.inv(stated), off_mm).max() < CHI2_95
    assert all(FiducialFlag.CLIPPED in one.flags for one in found)
    assert VolumeFlag.REFORMATTED in found.volume_flags


@pytest.mark.parametrize("order", [1, 3], ids=["straight lines", "splines"])
def test_metal_that_is_too_large_is_refused_there(order: Literal[1, 3]) -> None:
    volume, _ = turned(unclipped_hu(1.25 * DIAMETER_MM, "steel"), order)
    assert len(localize(volume, diameter_mm=DIAMETER_MM)) == 0


def test_nothing_changes_where_the_scale_cut_off_what_was_measured() -> None:
    cut_hu = np.clip(unclipped_hu(DIAMETER_MM, "steel"), -1024.0, END_HU)
    scan = Scan.of(on_grid(as_stored(cut_hu), STACK))
    seen = examine(scan, [DIAMETER_MM])
    same, kept = as_cut_before(scan, seen, no_fit)
    assert same is scan
    assert kept == seen


def no_fit(_scan: Scan, _wanted: Sequence[tuple[FloatArray, float]]) -> list[Examined]:
    raise AssertionError("nothing tells that the scan was resampled")
