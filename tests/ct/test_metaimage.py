"""MetaImage headers, changed field by field; SimpleITK's own reading is the independent check of what is sound."""

import zlib
from pathlib import Path

import numpy as np
import pytest
import SimpleITK

from ronnaplan.ct import read_ct
from ronnaplan.errors import InputError
from tests.ct.test_images import VOXELS, changed, places, write

LAST = b"ElementDataFile"


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (LAST, b"DistanceUnits = cm\n" + LAST, "its DistanceUnits is 'cm', expected mm"),
        (LAST, b"DistanceUnits = um\n" + LAST, "its DistanceUnits is 'um'"),
        (LAST, b"Modality = MET_MOD_MR\n" + LAST, "its modality is MR, not CT"),
        (LAST, b"Modality = MET_MOD_NM\n" + LAST, "its Modality is 'MET_MOD_NM'"),
        (LAST, b"ITK_non_uniform_sampling_deviation = 1.35714\n" + LAST, "off by up to 1.36 mm; use the series"),
        (LAST, b"Orientation = 0 1 0 1 0 0 0 0 1\n" + LAST, "two values for Orientation"),
        (LAST, b"Rotation = 0 1 0 1 0 0 0 0 1\n" + LAST, "two values for Rotation"),
        (LAST, b"Position = 0 0 0\n" + LAST, "two values for Position"),
        (LAST, b"Origin = 0 0 0\n" + LAST, "two values for Origin"),
        (LAST, b"ElementSpacing = 1 1 1\n" + LAST, "two values for ElementSpacing"),
        (LAST, b"HeaderSize = 4\n" + LAST, "cannot be read to its end"),
        (LAST, b"HeaderSize = -2\n" + LAST, "skips -2 bytes"),
        (LAST, b"HeaderSizePerSlice = 4\n" + LAST, "its HeaderSizePerSlice is '4'"),
        (LAST, b"ElementToIntensityFunctionSlope = 0\n" + LAST, "scales its values by 0"),
        (LAST, b"ElementToIntensityFunctionSlope = nan\n" + LAST, "expected 1 number"),
        (LAST, b"ElementToIntensityFunctionOffset = inf\n" + LAST, "expected 1 number"),
        (LAST, b"ElementToIntensityFunctionslope = 2\n" + LAST, "expected ElementToIntensityFunctionSlope"),
        (LAST, b"ElementToIntensityFunctionSlope\xa0= 2\n" + LAST, "expected a name in printable ASCII"),
        (LAST, "DistanceUnits\u2003= cm\n".encode() + LAST, "expected a name in printable ASCII"),
        (LAST, b"distanceunits = mm\n" + LAST, "has the field distanceunits, expected DistanceUnits"),
        (b"Offset = -10", b"OFFSET = -10", "has the field OFFSET, expected Offset"),
        (LAST, b"nonsense\n" + LAST, "has the line 'nonsense'"),
        (b"CenterOfRotation = 0 0 0", b"CenterOfRotation = 5 0 0", "its CenterOfRotation is not 0"),
        (b"TransformMatrix = 1 0 0", b"TransformMatrix = 2 0 0", "not of length 1"),
        (b"TransformMatrix", b"SomethingOrOther", "no readable TransformMatrix"),
        (b"Offset = -10", b"Offset = x10", "'x10 -20 30' as its Offset, expected 3 numbers"),
        (b"Offset = -10 ", "Offset = -10\u2003".encode(), "as its Offset, expected 3 numbers"),
        (b"Offset = -10 ", b"Offset = -10\x1f", "as its Offset, expected 3 numbers"),
        (b"Offset = -10", b"Offset = 1_0", "as its Offset, expected 3 numbers"),
        (b"ElementSpacing = 0.75", b"ElementSpacing = 0", "as its ElementSpacing, expected numbers above 0"),
        (b"ElementSpacing = 0.75", b"ElementSpacing = -0.75", "as its ElementSpacing, expected numbers above 0"),
        (b"BinaryData = True", b"BinaryData = False", "its BinaryData is 'False'"),
        (b"BinaryDataByteOrderMSB = False\n", b"", "'None' as its BinaryDataByteOrderMSB"),
        (b"CompressedData = False", b"CompressedData = Perhaps", "as its CompressedData, expected True or False"),
        (b"CompressedData = False", b"CompressedData = True", "cannot be read to its end"),
        (b"MET_SHORT", b"MET_LONG", "its ElementType is 'MET_LONG'"),
        (b"MET_SHORT", b"MET_USHORT_ARRAY", "its ElementType is 'MET_USHORT_ARRAY'"),
        (b"ObjectType = Image", b"ObjectType = Tube", "its ObjectType is 'Tube'"),
        (b"NDims = 3", b"NDims = 4", "it has 4 dimensions"),
        (b"DimSize = 10 8 4", b"DimSize = 10 8 3", "its header declares 480"),
        (b"DimSize = 10 8 4", b"DimSize = 10 8 5", "cannot be read to its end"),
        (LAST + b" = LOCAL", LAST + b" = LIST", "in several files"),
        (LAST + b" = LOCAL", LAST + b" = head%03d.raw 1 4 1", "in several files"),
        (LAST + b" = LOCAL", b"", "expected 'Key = Value'|no readable ElementDataFile|too long"),
    ],
)
def test_a_header_that_leaves_a_voxel_or_a_value_open_is_refused(
    tmp_path: Path, old: bytes, new: bytes, reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        read_ct(changed(tmp_path / "head.mha", old, new))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (LAST, b"DistanceUnits = mm\n" + LAST),
        (LAST, b"Modality = MET_MOD_CT\n" + LAST),
        (LAST, b"ITK_non_uniform_sampling_deviation = 6.52174e-05\n" + LAST),
        (LAST, b"Position = -10  -20 30\n" + LAST),
        (LAST, b"Orientation = 1 0 0 0 1 0 0 0 1\n" + LAST),
        (LAST, b"HeaderSize = -1\n" + LAST),
        (LAST, b"Anything = of one's own\n" + LAST),
        (b"Offset", b"Position"),
        (b"BinaryData = True\n", b""),
    ],
)
def test_what_the_format_allows_is_read(tmp_path: Path, old: bytes, new: bytes) -> None:
    volume = read_ct(changed(tmp_path / "head.mha", old, new))
    assert np.array_equal(volume.voxels_hu, VOXELS)
    assert np.allclose(volume.grid.positions_mm(np.array([3.0, 2, 1])), [-10 + 0.75, -20 + 1, 36])


def test_the_scale_from_element_to_intensity_is_applied(tmp_path: Path) -> None:
    fields = b"ElementToIntensityFunctionSlope = 2\nElementToIntensityFunctionOffset = -1000\n"
    volume = read_ct(changed(tmp_path / "head.mha", LAST, fields + LAST))
    assert np.array_equal(volume.voxels_hu, VOXELS * 2 - 1000)
    assert volume.voxels_hu.dtype == np.int16


@pytest.mark.parametrize(("skip", "size"), [(b"6", 6), (b"-1", 6), (b"-1", 0)])
def test_voxels_behind_a_foreign_header_are_found_by_its_size(tmp_path: Path, skip: bytes, size: int) -> None:
    path = write(tmp_path / "head.mhd")
    data = tmp_path / "head.raw"
    data.write_bytes(b"header"[:size] + data.read_bytes())
    path.write_bytes(path.read_bytes().replace(LAST, b"HeaderSize = " + skip + b"\n" + LAST))
    volume = read_ct(path)
    assert np.array_equal(volume.voxels_hu, VOXELS)
    kji = np.array([[3.0, 7, 9], [0, 2, 1]])
    assert np.allclose(volume.grid.positions_mm(kji), places(path, kji), atol=1e-4)


def test_packed_voxels_are_read_to_their_checksum(tmp_path: Path) -> None:
    image = SimpleITK.ReadImage(str(write(tmp_path / "head.mha")))
    SimpleITK.WriteImage(image, str(tmp_path / "packed.mha"), useCompression=True)
    content = (tmp_path / "packed.mha").read_bytes()
    assert b"CompressedData = True" in content
    assert np.array_equal(read_ct(tmp_path / "packed.mha").voxels_hu, VOXELS)
    start = content.index(b"LOCAL\n") + 6
    voxels = VOXELS.astype("<i2").tobytes()
    for broken, reason in (
        (content[start:-3], "cannot be read to its end"),
        (content[start : start + 40] + b"\xff\xff" + content[start + 42 :], "cannot be read to its end"),
        (zlib.compress(voxels[:-2]), "cannot be read to its end"),
        (zlib.compress(voxels + b"ab"), "more voxels than its header declares"),
    ):
        (tmp_path / "packed.mha").write_bytes(content[:start] + broken)
        with pytest.raises(InputError, match=reason):
            read_ct(tmp_path / "packed.mha")


def test_big_endian_voxels_are_read(tmp_path: Path) -> None:
    path = changed(tmp_path / "head.mha", b"OrderMSB = False", b"OrderMSB = True")
    content = path.read_bytes()
    start = content.index(b"LOCAL\n") + 6
    path.write_bytes(content[:start] + np.frombuffer(content[start:], "<i2").byteswap().tobytes())
    assert np.array_equal(read_ct(path).voxels_hu, VOXELS)
