from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydicom import dcmwrite
from pydicom.dataset import Dataset
from pydicom.tag import Tag
from pydicom.uid import ExplicitVRBigEndian

from ronnaplan.ct import CTVolume, read_ct
from ronnaplan.errors import InputError
from tests.ct.makers import Change, dataset, save


def volume_of(folder: Path, stored: Any, change: Change | None = None, **also: object) -> CTVolume:
    """Read a volume whose slices all hold ``stored``, after ``change`` and with the elements ``also``."""
    for k in range(3):
        made = dataset(k, stored=np.asarray(stored))
        for keyword, value in also.items():
            setattr(made, keyword, value)
        if change is not None:
            change(made, k)
        save(made, folder / str(k))
    return read_ct(folder)


@pytest.mark.parametrize(
    ("slope", "intercept"), [(1, -1024), (10, -10240), (1, 0), (-1, 5), (2, -8192), (1, -40000), (3, 40000)]
)
@pytest.mark.parametrize("kind", ["i2", "u2", "u1"])
def test_whole_rescales_give_exact_int16(tmp_path: Path, slope: int, intercept: int, kind: str) -> None:
    start = -intercept // slope if kind != "u1" else 0
    stored = np.clip(start + np.arange(20).reshape(4, 5), np.iinfo(kind).min, np.iinfo(kind).max).astype(kind)
    expected = stored.astype(np.int64) * slope + intercept
    volume = volume_of(tmp_path, stored, RescaleSlope=slope, RescaleIntercept=intercept)
    fits = np.abs(expected).max() < 32768
    assert volume.voxels_hu.dtype == (np.int16 if fits else np.float32)
    assert np.array_equal(volume.voxels_hu[0], expected)


def test_fractional_rescales_give_float32(tmp_path: Path) -> None:
    volume = volume_of(tmp_path, np.array([[0, 1], [2, 3]], np.int16), RescaleSlope=0.5, RescaleIntercept=-1000.25)
    assert volume.voxels_hu.dtype == np.float32
    assert volume.voxels_hu[1].tolist() == [[-1000.25, -999.75], [-999.25, -998.75]]


def test_each_slice_has_its_own_rescale(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        made.RescaleSlope, made.RescaleIntercept = 1 + k, -100 * k

    volume = volume_of(tmp_path, np.full((2, 2), 7, np.int16), change)
    assert volume.voxels_hu[:, 0, 0].tolist() == [7, -86, -179]


@pytest.mark.parametrize("bits", [12, 13, 14, 15, 16])
@pytest.mark.parametrize("signed", [False, True])
def test_12_to_16_bits_stored_signed_or_not_even_with_rubbish_in_the_bits_above(
    tmp_path: Path, bits: int, signed: bool
) -> None:
    low = -(1 << bits - 1) if signed else 0
    true = np.linspace(low, low + (1 << bits) - 1, 30).astype(np.int64).reshape(5, 6)
    rubbish = (true & ((1 << bits) - 1)) | (0x5 << bits)
    stored = rubbish.astype(np.uint16).view(np.int16 if signed else np.uint16)
    volume = volume_of(tmp_path, stored, BitsStored=bits, HighBit=bits - 1, RescaleIntercept=0)
    assert np.array_equal(volume.voxels_hu[0], true)


def test_an_extended_scale_beyond_int16_is_kept_in_float32(tmp_path: Path) -> None:
    volume = volume_of(tmp_path, np.array([[0, 65535], [1024, 40000]], np.uint16))
    assert volume.voxels_hu.dtype == np.float32
    assert volume.voxels_hu[0].tolist() == [[-1024, 64511], [0, 38976]]


def set_padding(made: Dataset, value: int, form: str, limit: int | None = None) -> None:
    made.add_new(Tag(0x0028, 0x0120), form, value)
    if limit is not None:
        made.add_new(Tag(0x0028, 0x0121), form, limit)


@pytest.mark.parametrize(("form", "value"), [("SS", -2000), ("US", 63536)])
def test_padding_is_found_though_its_tag_says_unsigned(tmp_path: Path, form: str, value: int) -> None:
    stored = np.array([[-2000, 5], [0, -2000]], np.int16)
    volume = volume_of(tmp_path, stored, lambda made, k: set_padding(made, value, form))
    assert volume.padding_hu == -3024
    assert volume.voxels_hu[0].tolist() == [[-3024, -1019], [-1024, -3024]]


def test_padding_that_int16_cannot_hold_does_not_cost_the_others_their_type(tmp_path: Path) -> None:
    stored = np.array([[63536, 5], [0, 63536]], np.uint16)
    volume = volume_of(tmp_path, stored, lambda made, k: set_padding(made, 63536, "US"))
    assert volume.voxels_hu.dtype == np.int16
    assert volume.voxels_hu[0].tolist() == [[volume.padding_hu, -1019], [-1024, volume.padding_hu]]


def test_a_range_of_padding_values_becomes_one(tmp_path: Path) -> None:
    stored = np.array([[-2000, -1990], [0, -1980]], np.int16)
    volume = volume_of(tmp_path, stored, lambda made, k: set_padding(made, -2000, "SS", -1990))
    assert volume.voxels_hu[0].tolist() == [[-3024, -3024], [-1024, -3004]]


def test_padding_is_one_value_though_the_rescale_changes_by_slice(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        set_padding(made, -2000, "SS")
        made.RescaleIntercept = -1024 - k

    volume = volume_of(tmp_path, np.array([[-2000, 5], [0, 1]], np.int16), change)
    assert volume.voxels_hu[:, 0, 0].tolist() == [-3024, -3024, -3024]


def circle(outside: int) -> Any:
    stored = np.full((9, 9), outside, np.int16)
    stored[2:7, 2:7] = 1024
    return stored


def test_what_lies_outside_the_circle_is_padding_even_without_a_tag(tmp_path: Path) -> None:
    volume = volume_of(tmp_path, circle(-2000))
    assert volume.padding_hu == -3024
    assert np.count_nonzero(volume.voxels_hu == volume.padding_hu) == 3 * (81 - 25)


def test_outside_the_circle_and_padding_become_one_value(tmp_path: Path) -> None:
    stored = circle(-2000)
    stored[4, 4] = -1500
    volume = volume_of(tmp_path, stored, lambda made, k: set_padding(made, -1500, "SS"))
    assert volume.padding_hu == -2524
    assert set(np.unique(volume.voxels_hu)) == {-2524, 0}


def test_air_in_the_corners_is_not_padding(tmp_path: Path) -> None:
    assert volume_of(tmp_path, circle(0)).padding_hu is None


@pytest.mark.parametrize(("keyword", "kind"), [("FloatPixelData", "<f4"), ("DoubleFloatPixelData", "<f8")])
def test_float_pixels_are_read(tmp_path: Path, keyword: str, kind: str) -> None:
    values = np.array([[0.5, -3.25], [1000.0, 7.0]])

    def change(made: Dataset, k: int) -> None:
        del made.PixelData, made.BitsStored, made.HighBit, made.PixelRepresentation
        made.BitsAllocated, made.RescaleIntercept = 8 * np.dtype(kind).itemsize, 0
        setattr(made, keyword, values.astype(kind).tobytes())

    volume = volume_of(tmp_path, np.zeros((2, 2), np.int16), change)
    assert volume.voxels_hu.dtype == np.float32
    assert np.array_equal(volume.voxels_hu[1], values)


def test_values_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        del made.PixelData
        made.BitsAllocated, made.FloatPixelData = 32, np.full((2, 2), np.nan, "<f4").tobytes()

    with pytest.raises(InputError, match="not finite numbers"):
        volume_of(tmp_path, np.zeros((2, 2), np.int16), change)


def test_32_bit_integers_are_read(tmp_path: Path) -> None:
    volume = volume_of(tmp_path, np.array([[70000, -5], [0, 1]], np.int32), RescaleIntercept=0)
    assert volume.voxels_hu.dtype == np.float32
    assert volume.voxels_hu[0].tolist() == [[70000, -5], [0, 1]]


@pytest.mark.parametrize(("kind", "form"), [("u1", "OB"), ("u1", "OW"), ("u4", "OW")])
def test_pixels_that_readers_put_together_from_big_endian_words_in_two_ways_are_refused(
    kind: str, form: str, tmp_path: Path
) -> None:
    """Bytes were read in each other's place, halves of what dcmtk writes too."""
    stored = np.arange(20, dtype=kind).reshape(4, 5)
    for k in range(3):
        made = dataset(k, stored=stored)
        made.file_meta.TransferSyntaxUID = ExplicitVRBigEndian
        made["PixelData"].VR = form
        if form == "OW":
            made.PixelData = np.frombuffer(stored.tobytes(), "<u2").byteswap().tobytes()
        dcmwrite(tmp_path / str(k), made, implicit_vr=False, little_endian=False)
    if form == "OB":
        assert np.array_equal(read_ct(tmp_path).voxels_hu[0], stored.astype(int) - 1024)
        return
    with pytest.raises(InputError, match=rf"pixels of {8 * stored.itemsize} bits lie in big endian words"):
        read_ct(tmp_path)
