"""Slices whose positions a program wrote with a decimal or two lie evenly, where the scanner put them."""

from pathlib import Path

import numpy as np
import pytest

from ronnaplan.ct import VolumeFlag, read_ct
from ronnaplan.geometry import FloatArray
from tests.ct.makers import write_series
from tests.ct.test_stack import placed

SLICES = 48


def heights(gap_mm: float = 0.625) -> FloatArray:
    """Return heights (48,) of slices every ``gap_mm``, from one on that is no round number."""
    return np.linspace(-11.37, -11.37 + gap_mm * (SLICES - 1), SLICES)


def written(folder: Path, heights_mm: FloatArray, sideways: float = 0.0) -> Path:
    """Write slices whose positions are rounded to 0.1 mm but across the tilt of ``sideways`` mm for each mm."""
    rounded = np.round([[-119.7558594, sideways * height, height] for height in heights_mm], 1)
    rounded[:, 0] = -119.7558594
    return write_series(folder, len(rounded), placed(rounded.tolist(), SliceThickness=0.5))


@pytest.mark.parametrize("gap_mm", [0.625, 1.25, 0.45, 0.9375])
def test_slices_of_rounded_positions_lie_where_the_scanner_put_them(tmp_path: Path, gap_mm: float) -> None:
    volume = read_ct(written(tmp_path, heights(gap_mm)))
    assert VolumeFlag.ROUNDED in volume.flags
    assert VolumeFlag.UNEVEN_SPACING not in volume.flags
    off = volume.grid.slice_positions_mm - heights(gap_mm)
    assert np.ptp(off) < 0.012  # that all are shifted alike displaces no marker against another
    assert abs(float(off.mean())) < 0.05


def test_a_tilted_gantry_s_rounded_positions_are_mended_sideways_too(tmp_path: Path) -> None:
    volume = read_ct(written(tmp_path, heights(), sideways=0.31))
    assert VolumeFlag.ROUNDED in volume.flags
    off = volume.grid.origins_mm - np.stack([0 * heights(), 0.31 * heights(), heights()], axis=1)
    assert np.ptp(off[:, 1:], axis=0).max() < 0.02


@pytest.mark.parametrize("lost", [3, 20, 45])
def test_a_missing_slice_is_never_hidden_by_rounding(tmp_path: Path, lost: int) -> None:
    """Every 0.3 mm the gap that it leaves is six tenths: rounded, but no other slice's."""
    kept = np.delete(heights(0.3), lost)
    volume = read_ct(written(tmp_path, kept))
    assert VolumeFlag.ROUNDED not in volume.flags
    assert {VolumeFlag.UNEVEN_SPACING, VolumeFlag.MISSING_SLICE} & set(volume.flags)
    assert volume.grid.slice_positions_mm.tolist() == np.round(kept, 1).tolist()


def test_two_spacings_in_one_scan_stay_as_they_are_written(tmp_path: Path) -> None:
    steps = np.cumsum([0.0, *[1.0] * 24, *[1.1] * 23])
    volume = read_ct(written(tmp_path, steps))
    assert VolumeFlag.UNEVEN_SPACING in volume.flags
    assert volume.grid.slice_positions_mm.tolist() == np.round(steps, 1).tolist()


def test_few_slices_stay_as_they_are_written(tmp_path: Path) -> None:
    volume = read_ct(written(tmp_path, heights()[:12]))
    assert VolumeFlag.UNEVEN_SPACING in volume.flags
    assert volume.grid.slice_positions_mm.tolist() == np.round(heights()[:12], 1).tolist()


def test_positions_that_are_not_rounded_stay_to_the_last_digit(tmp_path: Path) -> None:
    """Even ones have no doubt, and uneven ones with all their digits tell where the slices are."""
    uneven = heights() + 0.03 * np.sin(np.arange(SLICES))
    folder = write_series(tmp_path, SLICES, placed([[0.0, 0.0, float(height)] for height in uneven]))
    volume = read_ct(folder)
    assert VolumeFlag.UNEVEN_SPACING in volume.flags
    assert volume.grid.slice_positions_mm == pytest.approx(uneven, abs=1e-9)
