"""NIfTI headers, patched byte by byte; SimpleITK's own reading is the independent check of what is sound."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
from scipy.spatial.transform import Rotation

from ronnaplan.ct import read_ct
from ronnaplan.errors import InputError
from tests.ct.test_images import VOXELS, places, write
from tests.long import few_and_others

NAN, INF = float("nan"), float("inf")
PIXDIM, VOX_OFFSET, SLOPE, UNITS, QFORM, SFORM = 76, 108, 112, 123, 252, 254
QUATERN, QOFFSET, SROW = 256, 268, 280


def patched(path: Path, *changes: tuple[int, str, Any]) -> Path:
    content = bytearray(path.read_bytes())
    for offset, form, value in changes:
        struct.pack_into("<" + form, content, offset, *np.atleast_1d(value))
    path.write_bytes(content)
    return path


def qform_only(path: Path, *changes: tuple[int, str, Any]) -> Path:
    return patched(write(path), (QFORM, "h", 1), (SFORM, "h", 0), *changes)


def sform_only(path: Path, *changes: tuple[int, str, Any]) -> Path:
    return patched(write(path), (QFORM, "h", 0), (SFORM, "h", 1), *changes)


CORNERS = np.array([[0, 0, 0], [3, 0, 0], [0, 7, 0], [0, 0, 9], [3, 7, 9]], dtype=float)


@pytest.mark.parametrize("made", [write, qform_only, sform_only])
def test_a_file_with_one_orientation_or_two_is_read_as_simpleitk_reads_it(tmp_path: Path, made: Any) -> None:
    path = made(tmp_path / "head.nii")
    assert np.allclose(read_ct(path).grid.positions_mm(CORNERS), places(path, CORNERS), atol=1e-4)


@pytest.mark.parametrize("bad", [NAN, INF, -INF])
@pytest.mark.parametrize(
    ("made", "offset", "named"),
    [
        (qform_only, QOFFSET, "qform offset"),
        (qform_only, QOFFSET + 8, "qform offset"),
        (qform_only, QUATERN, "quaternion"),
        (qform_only, PIXDIM + 4, r"voxel sizes \(pixdim\)"),
        (sform_only, SROW + 12, "sform"),
        (sform_only, SROW, "sform"),
        (sform_only, PIXDIM + 12, r"voxel sizes \(pixdim\)"),
        (write, SLOPE, "scale of the values"),
        (write, SLOPE + 4, "scale of the values"),
    ],
)
def test_numbers_that_are_none_are_refused_by_name(
    tmp_path: Path, made: Any, offset: int, named: str, bad: float
) -> None:
    path = made(tmp_path / "head.nii", *(() if made is write else ((offset, "f", bad),)))
    with pytest.raises(InputError, match=rf"{named}, expected finite numbers"):
        read_ct(patched(path, (offset, "f", bad)))


@pytest.mark.parametrize(
    ("made", "change", "reason"),
    [
        (qform_only, (PIXDIM + 4, "f", 0.0), "voxel sizes .*expected numbers above 0"),
        (qform_only, (PIXDIM + 12, "f", -2.0), "voxel sizes .*expected numbers above 0"),
        (qform_only, (QUATERN, "3f", (0.8, 0.8, 0.0)), r"quaternion is longer than 1 \(1.13\)"),
        (qform_only, (QUATERN, "f", 3.0), "quaternion is longer than 1"),
        (qform_only, (PIXDIM, "f", NAN), "handedness"),
        (qform_only, (PIXDIM, "f", -7.0), "handedness"),
        (write, (QFORM, "hh", (0, 0)), "gives no orientation"),
        (write, (QFORM, "hh", (-1, 1)), r"in the space -1 \(an atlas"),
        (write, (SFORM, "h", 4), r"in the space 4 \(an atlas"),
        (qform_only, (QFORM, "h", 3), r"in the space 3 \(an atlas"),
        (write, (SROW + 12, "f", 77.0), "places its voxels in two ways, 67 mm apart"),
        (write, (SROW, "f", 0.7), "by pixdim and .* by its sform"),
        (sform_only, (PIXDIM + 4, "f", 0.7), "by pixdim and .* by its sform"),
        (write, (UNITS, "B", 1), "is not in millimetres"),
        (write, (UNITS, "B", 3), "is not in millimetres"),
        (write, (UNITS, "B", 7), "is not in millimetres"),
        (write, (VOX_OFFSET, "f", 0.0), "voxels start at byte 0, expected 352 or more"),
        (write, (VOX_OFFSET, "f", 352.5), "voxels start at byte 352.5"),
        (write, (VOX_OFFSET, "f", NAN), "voxels start at byte nan"),
        (write, (VOX_OFFSET, "f", 1e30), "voxels start at byte 1e"),
        (write, (VOX_OFFSET, "f", 368.0), "cannot be read to its end"),
        (write, (344, "4s", b"ni1\0"), "in another file"),
        (write, (344, "4s", b"\0\0\0\0"), "magic number"),
        (write, (0, "i", 300), "not of 348 or 540 bytes"),
        (write, (68, "h", 3), r"the intent 3 \(a statistic"),
        (write, (SLOPE, "ff", (0.0, NAN)), "'0 nan' as its scale of the values"),
        (write, (SLOPE, "ff", (0.0, -INF)), "'0 -inf' as its scale of the values"),
        (write, (SLOPE, "f", 1e8), r"scales its values by 1e\+08"),
        (write, (72, "h", 32), "take 32 bits, but 16 by their type"),
        (write, (70, "h", 128), r"of the type 128 \(colours"),
        (write, (40, "h", 0), "it has 0 dimensions"),
        (write, (40, "h", 5000), "it has 5000 dimensions"),
        (write, (40, "hhhhh", (4, 10, 8, 2, 2)), "it has 4 dimensions"),
        (write, (42, "h", -10), "-10 x 8 x 4 voxels"),
    ],
)
def test_a_header_that_contradicts_itself_or_the_standard_is_refused(
    tmp_path: Path, made: Any, change: tuple[int, str, Any], reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        read_ct(patched(made(tmp_path / "head.nii"), change))


def test_a_scale_is_applied_and_a_slope_of_zero_means_none_whatever_the_intercept(tmp_path: Path) -> None:
    path = write(tmp_path / "head.nii")
    scaled = read_ct(patched(path, (SLOPE, "ff", (2.0, -1000.0)))).voxels_hu
    assert np.array_equal(scaled, VOXELS * 2 - 1000)
    assert scaled.dtype == np.int16
    half = read_ct(patched(path, (SLOPE, "ff", (0.5, 0.25)))).voxels_hu
    assert np.array_equal(half, VOXELS * np.float32(0.5) + np.float32(0.25))
    assert np.array_equal(read_ct(patched(path, (SLOPE, "ff", (0.0, -1024.0)))).voxels_hu, VOXELS)


def test_values_that_a_scale_makes_infinite_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not finite numbers"):
        read_ct(patched(write(tmp_path / "head.nii", VOXELS.astype(np.float32) * 1e33), (SLOPE, "f", 1e6)))


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_a_left_handed_file_keeps_every_voxel_at_its_place(tmp_path: Path, suffix: str) -> None:
    values = np.random.default_rng(3).integers(-1000, 1000, (5, 6, 7)).astype(np.int16)
    image = SimpleITK.GetImageFromArray(values)
    image.SetSpacing((0.5, 0.75, 2.0))
    image.SetDirection((-1, 0, 0, 0, 1, 0, 0, 0, 1))
    image.SetOrigin((5.0, 6.0, 7.0))
    path = tmp_path / f"left{suffix}"
    SimpleITK.WriteImage(image, str(path))
    volume = read_ct(path)
    assert volume.voxels_hu.flags.c_contiguous
    assert (np.diff(volume.grid.slice_positions_mm) > 0).all()
    places = volume.grid.positions_mm(np.moveaxis(np.indices(volume.voxels_hu.shape), 0, -1).astype(float))
    for k, j, i in ((0, 0, 0), (4, 5, 6), (2, 1, 3)):
        place = np.array(image.TransformIndexToPhysicalPoint((i, j, k)))
        nearest = np.unravel_index(np.linalg.norm(places - place, axis=-1).argmin(), values.shape)
        assert places[nearest] == pytest.approx(place, abs=1e-5)
        assert volume.voxels_hu[nearest] == values[k, j, i]


@pytest.mark.parametrize("degrees", [179.0, 179.7, 179.95, 179.99, 180.0])
@few_and_others("seed", range(1), range(1, 4))
def test_near_a_half_turn_the_quaternions_rounding_is_no_contradiction(
    tmp_path: Path, degrees: float, seed: int
) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    turn = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()
    flip = np.diag([-1.0, -1.0, 1.0])
    path = write(tmp_path / "head.nii", np.zeros((100, 512, 512), np.int16), direction=flip @ turn)
    grid = read_ct(path).grid
    corners = np.array([[0, 0, 0], [99, 511, 511], [0, 511, 0.0]])
    assert np.allclose(grid.positions_mm(corners), positions(path, corners, grid.normal), atol=0.01)


def positions(path: Path, kji: Any, normal: Any) -> Any:
    """Return the places of voxels by the sform, with the slices in the order of ``normal``."""
    rows = np.array(struct.unpack_from("<12f", path.read_bytes(), SROW), dtype=float).reshape(3, 4)
    lps = np.diag([-1.0, -1.0, 1.0]) @ rows
    if lps[:, 2] @ normal < 0:
        lps[:, 3] += 99 * lps[:, 2]
        lps[:, 2] *= -1
    return kji[:, ::-1] @ lps[:, :3].T + lps[:, 3]


def as_nifti2(content: bytes, order: str) -> bytes:
    """Return a NIfTI-1 file as NIfTI-2 in ``order``, by the table of nifti2.h."""
    header = bytearray(540)

    def put(form: str, offset: int, old_form: str, old: int) -> None:
        struct.pack_into(order + form, header, offset, *struct.unpack_from("<" + old_form, content, old))

    struct.pack_into(order + "i8s", header, 0, 540, b"n+2\0\r\n\x1a\n")
    for form, offset, old_form, old in [
        *(("hh", 12, "hh", 70), ("8q", 16, "8h", 40), ("8d", 104, "8f", 76), ("2d", 176, "2f", 112)),
        *(("ii", 344, "hh", 252), ("6d", 352, "6f", 256), ("12d", 400, "12f", 280), ("i", 500, "B", 123)),
    ]:
        put(form, offset, old_form, old)
    struct.pack_into(order + "q", header, 168, 544)
    voxels = np.frombuffer(content, "<i2", offset=352).astype(order + "i2").tobytes()
    return bytes(header) + b"\0\0\0\0" + voxels


@pytest.mark.parametrize("order", ["<", ">"])
def test_nifti_2_in_either_byte_order_is_the_same_scan(tmp_path: Path, order: str) -> None:
    first, second = write(tmp_path / "first.nii"), tmp_path / "second.nii"
    second.write_bytes(as_nifti2(first.read_bytes(), order))
    volume = read_ct(second)
    assert np.array_equal(volume.voxels_hu, VOXELS)
    assert np.allclose(volume.grid.positions_mm(CORNERS), places(first, CORNERS), atol=1e-4)


def test_a_sheared_sform_alone_keeps_its_tilt(tmp_path: Path) -> None:
    """A gantry tilt, as a converter without qform writes it; SimpleITK would drop it."""
    path = patched(write(tmp_path / "head.nii", direction=np.eye(3)), (QFORM, "h", 0), (SROW + 24, "f", -0.5))
    path = patched(path, (PIXDIM + 12, "f", np.hypot(0.5, 2)))
    grid = read_ct(path).grid
    assert grid.tilt_deg == pytest.approx(np.degrees(np.arctan2(0.5, 2)), abs=1e-5)
    assert np.allclose(grid.positions_mm(np.array([3.0, 0, 0])), [-10, -18.5, 36])
