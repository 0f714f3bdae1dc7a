import struct
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ronnaplan.ct import Limits, VolumeFlag, read_ct
from ronnaplan.errors import InputError
from tests.ct.makers import pattern

SUFFIXES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")
VOXELS = np.stack([pattern(k) - 500 for k in range(4)])


def write(path: Path, voxels: object = VOXELS, direction: object = None) -> Path:
    image = SimpleITK.GetImageFromArray(voxels)
    image.SetSpacing((0.75, 0.5, 2.0))
    image.SetOrigin((-10.0, -20.0, 30.0))
    turn = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix() if direction is None else direction
    image.SetDirection(np.asarray(turn).ravel().tolist())
    SimpleITK.WriteImage(image, str(path))
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


@settings(max_examples=20, deadline=None)
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


def patched(path: Path, offset: int, form: str, *values: float) -> Path:
    content = bytearray(path.read_bytes())
    struct.pack_into(form, content, offset, *values)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("offset", "form", "values", "reason"),
    [
        (252, "<hh", (0, 0), "gives no orientation"),
        (288, "<f", (0.7,), "places its voxels in two ways"),
        (292, "<f", (77.0,), "in two ways, 67 mm apart"),
        (123, "<B", (1,), "is not in millimetres"),
    ],
)
def test_a_nifti_that_does_not_place_its_voxels_unmistakably_is_refused(
    tmp_path: Path, offset: int, form: str, values: tuple[float, ...], reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        read_ct(patched(write(tmp_path / "head.nii"), offset, form, *values))


@pytest.mark.parametrize(
    ("suffix", "old", "new", "reason"),
    [
        (".nrrd", b"space: left-posterior-superior\n", b"space dimension: 3\n", "gives the space 'none'"),
        (".nrrd", b"space: left-posterior-superior\n", b"space: scanner-xyz\n", "gives the space 'scanner-xyz'"),
        (".mha", b"TransformMatrix", b"SomethingOrOther", "no readable TransformMatrix"),
        (".mha", b"Offset = -10", b"Offset = x10", "no readable TransformMatrix"),
    ],
)
def test_a_missing_or_unknown_orientation_is_refused(
    tmp_path: Path, suffix: str, old: bytes, new: bytes, reason: str
) -> None:
    path = write(tmp_path / f"head{suffix}")
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new))
    with pytest.raises(InputError, match=reason):
        read_ct(path)


def test_the_tilt_of_a_sheared_nrrd_is_kept(tmp_path: Path) -> None:
    path = write(tmp_path / "head.nrrd", direction=np.eye(3))
    path.write_bytes(path.read_bytes().replace(b"(0,0,2)", b"(0,0.5,2)"))
    grid = read_ct(path).grid
    assert np.allclose(grid.positions_mm(np.array([3.0, 0, 0])), [-10, -18.5, 36])
    assert grid.tilt_deg == pytest.approx(np.degrees(np.arctan2(0.5, 2)))


def test_right_anterior_superior_nrrd_is_turned_to_lps(tmp_path: Path) -> None:
    path = write(tmp_path / "head.nrrd", direction=np.eye(3))
    path.write_bytes(path.read_bytes().replace(b"left-posterior-superior", b"right-anterior-superior"))
    assert np.allclose(read_ct(path).grid.positions_mm(np.array([0, 2, 1.0])), [10 - 0.75, 20 - 1.0, 30])


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
def test_a_file_cut_short_is_refused(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"head{suffix}")
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(InputError, match=r"cannot be read to its end|not a readable image"):
        read_ct(path)


def test_four_dimensions_and_colours_are_refused(tmp_path: Path) -> None:
    colours = SimpleITK.GetImageFromArray(np.zeros((3, 4, 5, 3), np.uint8), isVector=True)
    SimpleITK.WriteImage(colours, str(tmp_path / "colours.nrrd"))
    with pytest.raises(InputError, match="3 values a voxel"):
        read_ct(tmp_path / "colours.nrrd")
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


def test_values_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not finite numbers"):
        read_ct(write(tmp_path / "nan.nrrd", np.full((3, 4, 5), np.nan, np.float32)))


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_a_left_handed_nifti_keeps_every_voxel_at_its_place(tmp_path: Path, suffix: str) -> None:
    values = np.random.default_rng(3).integers(-1000, 1000, (5, 6, 7)).astype(np.int16)
    image = SimpleITK.GetImageFromArray(values)
    image.SetSpacing((0.5, 0.75, 2.0))
    image.SetDirection((-1, 0, 0, 0, 1, 0, 0, 0, 1))
    image.SetOrigin((5.0, 6.0, 7.0))
    path = tmp_path / f"left{suffix}"
    SimpleITK.WriteImage(image, str(path))
    volume = read_ct(path)
    assert (np.diff(volume.grid.slice_positions_mm) > 0).all()
    places = volume.grid.positions_mm(np.moveaxis(np.indices(volume.voxels_hu.shape), 0, -1).astype(float))
    for k, j, i in ((0, 0, 0), (4, 5, 6), (2, 1, 3)):
        place = np.array(image.TransformIndexToPhysicalPoint((i, j, k)))
        nearest = np.unravel_index(np.linalg.norm(places - place, axis=-1).argmin(), values.shape)
        assert places[nearest] == pytest.approx(place, abs=1e-5)
        assert volume.voxels_hu[nearest] == values[k, j, i]
