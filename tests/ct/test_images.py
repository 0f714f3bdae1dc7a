import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ronnaplan.ct import CTVolume, Limits, VolumeFlag, read_ct
from ronnaplan.ct.summary import summarize
from ronnaplan.errors import InputError
from tests.ct.makers import pattern

SUFFIXES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")
VOXELS = np.stack([pattern(k) - 500 for k in range(4)])


def write(path: Path, voxels: NDArray[Any] = VOXELS, direction: Any = None) -> Path:
    image = SimpleITK.GetImageFromArray(voxels)
    image.SetSpacing((0.75, 0.5, 2.0))
    image.SetOrigin((-10.0, -20.0, 30.0))
    turn = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix() if direction is None else direction
    image.SetDirection(np.asarray(turn).ravel().tolist())
    SimpleITK.WriteImage(image, str(path))
    return path


def changed(path: Path, old: bytes, new: bytes) -> Path:
    """Write an image along the axes, with a part of its header replaced."""
    content = write(path, direction=np.eye(3)).read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))
    return path


def places(path: Path, kji: "np.typing.NDArray[np.float64]") -> "np.typing.NDArray[np.float64]":
    image = SimpleITK.ReadImage(str(path))
    return np.array([image.TransformContinuousIndexToPhysicalPoint(index[::-1].tolist()) for index in kji])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_each_format_is_read_in_lps_and_flagged_as_without_frame_of_reference(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"head{suffix}")
    volume = read_ct(path)
    assert np.array_equal(volume.voxels_hu, VOXELS)
    assert volume.voxels_hu.dtype == np.int16
    kji = np.array([[0, 0, 0], [3, 7, 9], [1, 2, 3.0]])
    assert np.allclose(volume.grid.positions_mm(kji), places(path, kji), atol=1e-4)
    assert volume.flags == (VolumeFlag.NO_FRAME_OF_REFERENCE,)
    assert volume.frame.uid is None


def test_slices_that_shift_sideways_as_by_no_gantry_are_flagged(tmp_path: Path) -> None:
    fields = "type: int16\ndimension: 3\nsizes: 10 8 4\nendian: little\nencoding: raw\nspace origin: (0,0,0)\n"
    for third, flags in (("(0,0.5,2)", (VolumeFlag.SHEARED,)), ("(0,0,2)", ())):
        path = tmp_path / "head.nrrd"
        steps = f"space: left-posterior-superior\nspace directions: (0.75,0,0) (0,0.5,0) {third}\n\n"
        path.write_bytes(f"NRRD0004\n{fields}{steps}".encode() + VOXELS.tobytes())
        assert read_ct(path).flags == (VolumeFlag.NO_FRAME_OF_REFERENCE, *flags)
        (listed,), _ = summarize(path)
        assert listed.notes == tuple(str(flag) for flag in (VolumeFlag.NO_FRAME_OF_REFERENCE, *flags))


def test_a_scan_from_an_array_or_an_image_is_doubted_as_from_a_file(tmp_path: Path) -> None:
    """A shear, values without air and corners that were not measured were told of files only."""
    whole = np.tile(VOXELS, (6, 4, 4)).astype(np.int16)
    without_air, unmeasured = whole + np.int16(600), whole.copy()
    unmeasured[:, :: whole.shape[1] - 1, :: whole.shape[2] - 1] = -3024
    for voxels in (whole, without_air, unmeasured):
        path = write(tmp_path / "head.mha", voxels)
        read = read_ct(path)
        image = SimpleITK.ReadImage(str(path))
        for made in (CTVolume.from_sitk(image), CTVolume.from_array(read.voxels_hu, read.affine)):
            assert (VolumeFlag.NO_FRAME_OF_REFERENCE, *made.flags) == read.flags
            assert made.padding_hu == read.padding_hu
            assert made.voxel_sha256 == read.voxel_sha256
    assert CTVolume.from_array(without_air, read.affine).flags == (VolumeFlag.NO_AIR,)
    assert CTVolume.from_array(unmeasured, read.affine).padding_hu == -3024
    sheared = read.affine.copy()
    sheared[:3, 0] += sheared[:3, 1]
    assert CTVolume.from_array(VOXELS, sheared).flags == (VolumeFlag.SHEARED,)


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
def test_values_without_air_are_flagged_as_if_they_were_offset(tmp_path: Path, suffix: str) -> None:
    """As programs store them that know no sign: read all the same, for a crop may hold no air."""
    stored = np.tile(VOXELS + 600, (6, 4, 4)).astype(np.uint16)
    volume = read_ct(write(tmp_path / f"head{suffix}", stored))
    assert np.array_equal(volume.voxels_hu, stored)
    assert volume.flags == (VolumeFlag.NO_FRAME_OF_REFERENCE, VolumeFlag.NO_AIR)
    assert "expected air at -1000 HU" in VolumeFlag.NO_AIR


@settings(max_examples=20)
@given(angles=st.tuples(*[st.floats(-180, 180)] * 3), mirrored=st.booleans())
def test_turned_and_mirrored_images_keep_every_voxel_where_it_was(
    tmp_path_factory: pytest.TempPathFactory, angles: tuple[float, float, float], mirrored: bool
) -> None:
    turn = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    path = write(tmp_path_factory.mktemp("turned") / "head.nrrd", direction=turn * [1, 1, -1 if mirrored else 1])
    volume = read_ct(path)
    assert (np.diff(volume.grid.slice_positions_mm) > 0).all()
    kji = np.argwhere(volume.voxels_hu == VOXELS[2, 3, 4]).astype(float)
    assert np.allclose(volume.grid.positions_mm(kji), places(path, np.array([[2, 3, 4.0]])), atol=1e-4)


def test_whole_numbers_kept_as_float_become_int16_and_fractions_stay(tmp_path: Path) -> None:
    assert read_ct(write(tmp_path / "a.nii", VOXELS.astype(np.float64))).voxels_hu.dtype == np.int16
    fractions = read_ct(write(tmp_path / "b.nii", VOXELS.astype(np.float32) + 0.5))
    assert fractions.voxels_hu.dtype == np.float32
    assert np.array_equal(fractions.voxels_hu, VOXELS + np.float32(0.5))


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
def test_a_file_cut_short_is_refused(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"head{suffix}")
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(InputError, match=r"cannot be read to its end|not a readable image"):
        read_ct(path)


def test_four_dimensions_and_colours_are_refused(tmp_path: Path) -> None:
    colours = SimpleITK.GetImageFromArray(np.zeros((3, 4, 5, 3), np.uint8), isVector=True)
    SimpleITK.WriteImage(colours, str(tmp_path / "colours.nrrd"))
    with pytest.raises(InputError, match=r"4 dimensions \(vector domain domain domain\)"):
        read_ct(tmp_path / "colours.nrrd")
    SimpleITK.WriteImage(colours, str(tmp_path / "colours.mha"))
    with pytest.raises(InputError, match="its ElementNumberOfChannels is '3', expected 1"):
        read_ct(tmp_path / "colours.mha")
    SimpleITK.WriteImage(SimpleITK.Image([4, 4, 4, 2], SimpleITK.sitkInt16), str(tmp_path / "time.nii"))
    with pytest.raises(InputError, match="has 4 dimensions"):
        read_ct(tmp_path / "time.nii")


def test_a_declared_size_beyond_the_limit_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = write(tmp_path / "head.mha")
    path.write_bytes(path.read_bytes().replace(b"DimSize = 10 8 4", b"DimSize = 9999 9999 9999"))
    with pytest.raises(InputError, match=r"declares 3724\.\d GiB of voxels but the limit is 4\.0 GiB"):
        read_ct(path)
    with pytest.raises(InputError, match="the limit is 0"):
        read_ct(write(tmp_path / "small.mha"), limits=Limits(volume_bytes=100))


def test_an_image_that_memory_cannot_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none_left(*_: object) -> None:
        raise MemoryError

    path = write(tmp_path / "head.mha")
    monkeypatch.setattr("ronnaplan.ct.image_voxels.np.empty", none_left)
    with pytest.raises(InputError, match="need more memory than there is"):
        read_ct(path)


def test_values_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not finite numbers"):
        read_ct(write(tmp_path / "nan.nrrd", np.full((3, 4, 5), np.nan, np.float32)))
    with pytest.raises(InputError, match=r"numbers up to 1e\+06 HU"):
        read_ct(write(tmp_path / "far.nrrd", np.full((3, 4, 5), 1e30, np.float32)))


@pytest.mark.parametrize("suffix", [".nii", ".nrrd", ".mha"])
def test_voxels_that_do_not_fill_the_file_exactly_are_refused_as_they_may_be_shifted(
    tmp_path: Path, suffix: str
) -> None:
    path = write(tmp_path / f"head{suffix}")
    path.write_bytes(path.read_bytes() + b"1234")
    with pytest.raises(InputError, match=r"holds 644 bytes of voxels, its header declares 640"):
        read_ct(path)


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
@pytest.mark.parametrize("suffix", [".nii", ".nrrd", ".mha"])
def test_every_number_type_gives_its_values(tmp_path: Path, suffix: str, kind: str) -> None:
    low = 0 if kind[0] == "u" else -100
    values = np.random.default_rng(1).integers(low, 100, (3, 4, 5)).astype(kind)
    volume = read_ct(write(tmp_path / f"head{suffix}", values))
    assert np.array_equal(volume.voxels_hu, values)
    assert volume.voxels_hu.dtype == np.int16


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
def test_a_folder_or_a_pipe_in_the_place_of_an_image_is_refused(tmp_path: Path, suffix: str) -> None:
    os.mkfifo(tmp_path / f"pipe{suffix}")
    with pytest.raises(InputError, match="neither a file nor a folder"):
        read_ct(tmp_path / f"pipe{suffix}")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
@pytest.mark.parametrize("suffix", [".nhdr", ".mhd"])
def test_a_pipe_named_by_a_header_is_refused_without_waiting_for_it(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"head{suffix}")
    (data,) = [each for each in tmp_path.iterdir() if each != path]
    data.unlink()
    os.mkfifo(data)
    with pytest.raises(InputError, match="is not a regular file"):
        read_ct(path)


@pytest.mark.parametrize("suffix", [".nhdr", ".mhd"])
@pytest.mark.parametrize("name", [b"/dev/zero", b".", b"missing.raw", b"bad\0name", b"x" * 5000, b"\xff\xfe"])
def test_a_device_a_folder_or_nothing_named_by_a_header_is_refused(
    tmp_path: Path, suffix: str, name: bytes
) -> None:
    path = write(tmp_path / f"head{suffix}")
    (data,) = [each for each in tmp_path.iterdir() if each != path]
    content = path.read_bytes()
    assert data.name.encode() in content
    path.write_bytes(content.replace(data.name.encode(), name))
    with pytest.raises(InputError, match=r"regular file|cannot be opened|does not name the file"):
        read_ct(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("digits", [400, 5000, 1 << 17])
def test_a_number_of_thousands_of_digits_is_refused(tmp_path: Path, suffix: str, digits: int) -> None:
    path = write(tmp_path / f"head{suffix}")
    content = path.read_bytes()
    for old in (b"dimension: 3", b"sizes: 10 8 4", b"NDims = 3", b"DimSize = 10 8 4", b"ElementSpacing = 0.75"):
        if old in content:
            path.write_bytes(content.replace(old, old[:-1] + b"9" * digits))
            with pytest.raises(InputError, match=r"expected \d (whole )?number|line of more than|too long"):
                read_ct(path)


def test_a_header_without_end_is_refused_in_bounded_memory(tmp_path: Path) -> None:
    for name, line in (("head.nrrd", b"# nothing\n"), ("head.mha", b"Comment = nothing\n")):
        (tmp_path / name).write_bytes(b"NRRD0004\n" * name.endswith("nrrd") + line * 200_000)
        with pytest.raises(InputError, match="its header is too long"):
            read_ct(tmp_path / name, limits=Limits(header_bytes=1 << 20))


def test_positions_and_sizes_that_no_patient_has_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "head.mha")
    content = path.read_bytes()
    for old, new, reason in (
        (b"Offset = -10", b"Offset = -1e308", r"expected finite numbers up to 1e\+09"),
        (b"Offset = -10", b"Offset = -100001", "more than 100 m from the origin"),
        (b"Spacing = 0.75", b"Spacing = 1e-300", "expected 0.01 to 100"),
        (b"Spacing = 0.75", b"Spacing = 101", "expected 0.01 to 100"),
    ):
        assert old in content
        path.write_bytes(content.replace(old, new))
        with pytest.raises(InputError, match=reason):
            read_ct(path)
