"""Values that are no HU look like a scan in a window of their own: what they are doubted for, and what they are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pydicom.dataset import Dataset

from ronnaplan.ct import VolumeFlag, read_ct
from ronnaplan.ct.scale import doubts_of_scale
from tests.ct.makers import write_series

SIZE = 32
PADDING = -2000


def head_hu(rim: int = PADDING) -> NDArray[np.int16]:
    """Return a ball of water with a core of bone in noisy air, and a ``rim`` of what the scanner did not measure."""
    k, j, i = np.mgrid[:SIZE, :SIZE, :SIZE] - SIZE / 2
    radius = np.sqrt(k**2 + j**2 + i**2)
    hu = np.select([radius < 4, radius < 11, np.hypot(j, i) < 16], [900, 30, -1000], rim)
    noise = np.random.default_rng(1).normal(0.0, 15.0, hu.shape)
    return np.where(hu == rim, rim, np.maximum(hu + noise.round(), -1024)).astype(np.int16)


def flags_of(
    folder: Path, stored: NDArray[np.int16], slope: float, intercept: float, padding: int | None = None
) -> tuple[VolumeFlag, ...]:
    """Write ``stored`` (K, J, I) with a rescale, read it, and return the flags."""

    def change(made: Dataset, k: int) -> None:
        made.Rows = made.Columns = SIZE
        made.PixelData = stored[k].tobytes()
        made.RescaleSlope, made.RescaleIntercept = slope, intercept
        if padding is not None:
            made.add_new(0x00280120, "SS", padding)

    return read_ct(write_series(folder, SIZE, change)).flags


@pytest.mark.parametrize("rim", [PADDING, -1024, -1000])
def test_a_head_in_air_is_not_doubted(tmp_path: Path, rim: int) -> None:
    assert flags_of(tmp_path, head_hu(rim) + np.int16(1024), 1, -1024) == ()


@pytest.mark.parametrize(("offset", "doubts"), [(0, ()), (-1024, (VolumeFlag.LOW_AIR,))])
def test_two_paddings_that_no_tag_tells_are_no_air(offset: int, doubts: tuple[VolumeFlag, ...]) -> None:
    """They are most of what is darker than tissue: outside of what the scanner sees, and of what was reconstructed."""
    hu = head_hu(-2000) + np.int16(offset)
    hu[: SIZE // 4], hu[-SIZE // 4 :] = -3024 + offset, -2000 + offset
    assert doubts_of_scale(hu, None) == doubts


def of_12_bits(folder: Path, stored: NDArray[np.int16], intercept: float, padding: int | None = None) -> Path:
    """Write values of 12 bits that the header calls signed, as they lie in 16."""

    def change(made: Dataset, k: int) -> None:
        made.Rows = made.Columns = SIZE
        made.PixelData = stored[k].tobytes()
        made.BitsStored, made.HighBit, made.RescaleIntercept = 12, 11, intercept
        if padding is not None:
            made.add_new(0x00280120, "SS", padding)

    return write_series(folder, SIZE, change)


def test_bright_values_that_a_wrong_sign_makes_dark_are_doubted(tmp_path: Path) -> None:
    hu = head_hu(-1024)
    hu[12:20, 14:18, 14:18] = 2000  # a plate; unsigned, 3024 of 4095
    assert read_ct(of_12_bits(tmp_path / "wrong", hu + np.int16(1024), -1024)).flags == (VolumeFlag.SIGN,)


@pytest.mark.parametrize("are_bits_set", [True, False])
@pytest.mark.parametrize("rim", [PADDING, -1024])
def test_a_sign_that_is_meant_is_not_doubted(tmp_path: Path, are_bits_set: bool, rim: int) -> None:
    """Whether or not the bits above those stored tell the sign, too; -2000 is what a scanner has for unmeasured."""
    stored = head_hu(rim) if are_bits_set else head_hu(rim) & np.int16(0xFFF)
    volume = read_ct(of_12_bits(tmp_path, stored, 0))
    assert volume.flags == ()
    assert np.array_equal(volume.voxels_hu, head_hu(rim))


def test_a_negative_slope_that_is_meant_gives_the_same_values(tmp_path: Path) -> None:
    hu = head_hu()
    assert flags_of(tmp_path, np.int16(1024) - hu, -1, 1024, padding=1024 - PADDING) == ()
    assert np.array_equal(read_ct(tmp_path).voxels_hu, hu)


@pytest.mark.parametrize(
    ("slope", "intercept", "flag"),
    [
        (1, 0, VolumeFlag.NO_AIR),  # the offset was lost
        (1, -2048, VolumeFlag.LOW_AIR),  # or added twice
        (-1, -1024, VolumeFlag.NO_TISSUE),
        (0.1, -1024, VolumeFlag.NO_TISSUE),
        (-1, 1024, VolumeFlag.INVERTED),
    ],
)
def test_a_wrong_rescale_is_flagged(tmp_path: Path, slope: float, intercept: float, flag: VolumeFlag) -> None:
    stored = head_hu() + np.int16(1024)
    assert flags_of(tmp_path, stored, slope, intercept, padding=PADDING + 1024) == (flag,)


def test_a_few_large_slices_are_asked_as_many_are() -> None:
    """Of each of four slices of 512 x 512 no more is looked at than of each of many."""
    hu = head_hu()[SIZE // 2 - 2 : SIZE // 2 + 2].repeat(16, axis=1).repeat(16, axis=2)
    assert doubts_of_scale(hu, PADDING) == ()
    assert doubts_of_scale(hu + np.int16(1024), PADDING + 1024) == (VolumeFlag.NO_AIR,)


def test_the_lowest_value_is_not_taken_for_air() -> None:
    """It fills what was not measured, by no tag: of a scan whose air is right it is far below, and most of all."""
    filled = head_hu(-3000).repeat(2, axis=2)
    filled[:, :, SIZE:] = -3000
    assert doubts_of_scale(filled, None) == ()
    filled[filled != -3000] -= 1024
    assert doubts_of_scale(filled, None) == (VolumeFlag.LOW_AIR,)


def test_what_lies_between_the_voxels_that_are_looked_at_is_found_slice_by_slice() -> None:
    """A few voxels of air above a head that fills the field of view, and of tissue below a foam that does."""
    for fill_hu, else_hu, flag in ((30, -1000, VolumeFlag.NO_AIR), (-1000, 30, VolumeFlag.NO_TISSUE)):
        hu = np.full((2 * SIZE,) * 3, fill_hu, dtype=np.int16)
        assert flag in doubts_of_scale(hu, None)
        hu[1, 1, 1] = else_hu  # every second slice, row and column is looked at
        assert flag not in doubts_of_scale(hu, None)


def test_values_that_lost_their_sign_are_flagged(tmp_path: Path) -> None:
    """HU stored as they are, and said to be unsigned: air comes out at 64,536."""
    hu = head_hu(-1024)

    def change(made: Dataset, k: int) -> None:
        made.Rows = made.Columns = SIZE
        made.PixelData, made.PixelRepresentation, made.RescaleIntercept = hu[k].tobytes(), 0, 0

    assert VolumeFlag.INVERTED in read_ct(write_series(tmp_path, SIZE, change)).flags


def test_a_range_of_padding_that_takes_air_and_tissue_is_flagged(tmp_path: Path) -> None:
    hu = head_hu(-1024)

    def change(made: Dataset, k: int) -> None:
        made.Rows = made.Columns = SIZE
        made.PixelData, made.RescaleIntercept = hu[k].tobytes(), 0
        made.add_new(0x00280120, "SS", PADDING)
        made.add_new(0x00280121, "SS", 0)

    assert VolumeFlag.NO_AIR in read_ct(write_series(tmp_path, SIZE, change)).flags
