"""Slices whose positions a program wrote with a decimal or two lie evenly, where the scanner put them."""

from pathlib import Path

import numpy as np
import pytest
from pydicom.dataset import Dataset

from ronnaplan.ct import VolumeFlag, read_ct
from ronnaplan.geometry import FloatArray
from tests.ct.makers import Change, write_series
from tests.ct.test_stack import placed
from tests.long import few_and_others

SLICES = 48


def heights(gap_mm: float = 0.625) -> FloatArray:
    """Return heights (48,) of slices every ``gap_mm``, from one on that is no round number."""
    return np.linspace(-11.37, -11.37 + gap_mm * (SLICES - 1), SLICES)


def written(folder: Path, heights_mm: FloatArray, sideways: float = 0.0) -> Path:
    """Write slices whose positions are rounded to 0.1 mm but across the tilt of ``sideways`` mm for each mm."""
    rounded = np.round([[-119.7558594, sideways * height, height] for height in heights_mm], 1)
    rounded[:, 0] = -119.7558594
    return write_series(folder, len(rounded), placed(rounded.tolist(), SliceThickness=0.5))


@few_and_others("gap_mm", [0.625, 0.45], [1.25, 0.9375])
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


def test_a_missing_slice_is_not_hidden_where_slices_are_as_fine_as_the_rounding(tmp_path: Path) -> None:
    """Cone beams have slices every 0.1 mm: all of them lay within the rounding of an even line."""
    kept = np.delete(0.1 * np.arange(SLICES), 20)
    volume = read_ct(written(tmp_path, kept))
    assert {VolumeFlag.UNEVEN_SPACING, VolumeFlag.MISSING_SLICE} <= set(volume.flags)
    assert volume.grid.slice_positions_mm == pytest.approx(kept, abs=1e-9)


@few_and_others("behind", [12], [24, 36])
def test_a_table_that_jumped_by_less_than_the_rounding_is_not_evened(tmp_path: Path, behind: int) -> None:
    """All slices were within 0.075 mm of an even line, but are not the rounding of one."""
    jumped = np.where(np.arange(SLICES) >= behind, heights() + 0.07, heights())
    volume = read_ct(written(tmp_path, jumped))
    assert VolumeFlag.ROUNDED not in volume.flags
    assert VolumeFlag.UNEVEN_SPACING in volume.flags
    assert volume.grid.slice_positions_mm.tolist() == np.round(jumped, 1).tolist()


def test_positions_that_were_rounded_twice_are_evened_too(tmp_path: Path) -> None:
    """First to 0.01 mm by the scanner, say, then to 0.1 by an archive."""
    volume = read_ct(written(tmp_path, np.round(heights(0.6449), 2)))
    assert VolumeFlag.ROUNDED in volume.flags
    assert np.ptp(volume.grid.slice_positions_mm - heights(0.6449)) < 0.02


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


def square(spacing: str, diameter: str | None, columns: int = 512) -> Change:
    """Return slices of ``columns`` each way."""

    def change(made: Dataset, k: int) -> None:
        made.Rows = made.Columns = columns
        made.PixelData = np.resize(np.array([24, 1024 + k], np.uint16), (columns, columns)).tobytes()
        made.PixelSpacing = [spacing] * 2
        if diameter is not None:
            made.ReconstructionDiameter = diameter

    return change


@pytest.mark.parametrize(
    ("spacing", "diameter"), [("0.468", "240"), ("0.469", "240.0"), ("0.4690", "240"), ("0.391", "200")]
)
def test_a_pixel_spacing_without_its_last_digits_is_told_by_the_diameter(
    tmp_path: Path, spacing: str, diameter: str
) -> None:
    """240 mm in 512 columns are 0.46875 mm each; it is told only, as nobody knows which number is right."""
    volume = read_ct(write_series(tmp_path, 4, square(spacing, diameter)))
    assert volume.flags == (VolumeFlag.CUT_SPACING,)
    assert volume.grid.column_spacing_mm == pytest.approx(float(spacing), abs=1e-12)


@few_and_others(
    ("spacing", "diameter", "columns"),
    [
        ("0.46875", "240", 512),
        ("0.468", None, 512),
        ("0.938", "240", 512),  # a larger picture than was reconstructed
    ],
    [
        ("0.4882812", "250.0000000", 512),
        ("0.625", "320", 512),
        ("0.977", "500", 512),  # 0.04 %
        ("0.468", "240", 400),  # cropped
        ("0.25", "160", 641),  # a cone beam's voxels, one more than fill it
    ],
)
def test_a_pixel_spacing_with_all_its_digits_or_another_width_is_not_doubted(
    tmp_path: Path, spacing: str, diameter: str | None, columns: int
) -> None:
    assert read_ct(write_series(tmp_path, 4, square(spacing, diameter, columns))).flags == ()
