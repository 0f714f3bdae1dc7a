"""A scan goes to other libraries' images and back without a voxel leaving its place."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from ronnaplan import CTVolume
from ronnaplan.ct import SliceGrid
from ronnaplan.errors import InputError, UsageError

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
"""A right-handed turn; its columns are the directions of i, j and k."""


def volume() -> CTVolume:
    affine = np.eye(4)
    affine[:3, :3] = TURN[:, ::-1] * [1.5, 0.7, 0.5]
    affine[:3, 3] = [10.0, -20.0, 30.0]
    voxels = np.arange(4 * 5 * 6).reshape(4, 5, 6)
    return CTVolume.from_array(voxels, affine, "1.2.3")


def test_an_array_and_its_affine_place_each_voxel() -> None:
    ct = volume()
    kji = np.array([[3.0, 2.0, 1.0]])
    expected = [10.0, -20.0, 30.0] + 3 * 1.5 * TURN[:, 2] + 2 * 0.7 * TURN[:, 1] + 1 * 0.5 * TURN[:, 0]
    np.testing.assert_allclose(ct.grid.positions_mm(kji)[0], expected, atol=1e-12)
    np.testing.assert_allclose(ct.affine @ [3, 2, 1, 1], [*expected, 1], atol=1e-12)
    assert ct.voxels_hu.dtype == np.dtype(np.int16)
    assert ct.frame.uid == "1.2.3"
    assert repr(ct) == "CTVolume(4 slices of 5 x 6, 1.5 x 0.7 x 0.5 mm)"


def test_an_affine_that_was_fitted_ends_in_rounded_numbers() -> None:
    ct = volume()
    fitted = ct.affine
    fitted[3] += 1e-12
    np.testing.assert_array_equal(CTVolume.from_array(ct.voxels_hu, fitted).affine, ct.affine)


@pytest.mark.parametrize("package", ["nibabel", "xarray", "pyvista"])
def test_a_package_that_is_missing_is_told_with_the_extra_that_brings_it(
    package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(UsageError, match=rf"{package} is not installed; .* or install ronnaplan\[arrays\]"):
        getattr(volume(), f"to_{package}")()


def test_descending_slices_are_put_in_order() -> None:
    ct = volume()
    down = ct.affine.copy()
    down[:3, 3] += 3 * down[:3, 0]
    down[:3, 0] *= -1
    again = CTVolume.from_array(ct.voxels_hu[::-1], down)
    np.testing.assert_allclose(again.affine, ct.affine, atol=1e-12)
    np.testing.assert_array_equal(again.voxels_hu, ct.voxels_hu)


@pytest.mark.parametrize("step", [1, -1])
def test_voxels_stand_row_by_row_however_they_came(step: int) -> None:
    """Those of MATLAB and of descending slices did not, and all that looks for markers was compiled anew for them."""
    ct = volume()
    affine = ct.affine @ np.diag([step, 1.0, 1.0, 1.0])
    again = CTVolume.from_array(np.asfortranarray(ct.voxels_hu)[::step], affine)
    assert again.voxels_hu.flags.c_contiguous


def test_simpleitk_has_each_value_at_the_same_place_and_gives_it_back() -> None:
    ct = volume()
    image = ct.to_sitk()
    place = image.TransformIndexToPhysicalPoint((1, 2, 3))
    np.testing.assert_allclose(place, ct.grid.positions_mm(np.array([3.0, 2.0, 1.0])), atol=1e-9)
    assert image[1, 2, 3] == ct.voxels_hu[3, 2, 1]
    back = CTVolume.from_sitk(image)
    np.testing.assert_allclose(back.affine, ct.affine, atol=1e-9)
    np.testing.assert_array_equal(back.voxels_hu, ct.voxels_hu)


def test_pyvista_has_each_value_at_the_same_place() -> None:
    pytest.importorskip("pyvista")
    ct = volume()
    image = ct.to_pyvista()
    number = int(np.flatnonzero(image["CT"] == ct.voxels_hu[3, 2, 1])[0])
    np.testing.assert_allclose(image.points[number], ct.affine[:3] @ [3, 2, 1, 1], atol=1e-5)


def test_nibabel_has_each_value_at_the_same_place_in_ras() -> None:
    pytest.importorskip("nibabel")
    ct = volume()
    image = ct.to_nibabel()
    np.testing.assert_allclose(image.affine @ [1, 2, 3, 1] * [-1, -1, 1, 1], ct.affine @ [3, 2, 1, 1], atol=1e-9)
    assert image.dataobj[1, 2, 3] == ct.voxels_hu[3, 2, 1]


def test_what_from_array_says_of_nibabel_and_xarray_gives_the_scan_again() -> None:
    """Their axes and directions are others, and a head mirrored or lying on its side passes for one."""
    pytest.importorskip("nibabel")
    pytest.importorskip("xarray")
    ct = volume()
    told = re.findall(r"``(.+?)``", (CTVolume.from_array.__doc__ or "").replace("\n", " "))
    voxels, affine = (one for one in told if "image." in one)
    array, names = ct.to_xarray(), {"numpy": np, "image": ct.to_nibabel()}
    for back in (
        CTVolume.from_array(eval(voxels, names), eval(affine, names)),
        CTVolume.from_array(array, array.attrs["lps_from_kji"]),
    ):
        np.testing.assert_allclose(back.affine, ct.affine, atol=1e-9)
        np.testing.assert_array_equal(back.voxels_hu, ct.voxels_hu)


def test_what_no_regular_grid_holds_is_refused() -> None:
    uneven = SliceGrid(
        np.array([[0, 0, 0], [0, 0, 1.0], [0, 0, 2.5]]), np.array([0, 1.0, 0]), np.array([1.0, 0, 0])
    )
    with pytest.raises(InputError, match="not evenly spaced"):
        CTVolume(np.zeros((3, 4, 4), np.int16), uneven).to_sitk()
    tilted = np.eye(4)
    tilted[:3, :3] = np.array([[0, 0, 1.0], [0.3, 1.0, 0], [1.0, 0, 0]])
    with pytest.raises(InputError, match="tilted gantry"):
        CTVolume.from_array(np.zeros((3, 4, 4)), tilted).to_sitk()


@pytest.mark.parametrize(
    ("voxels", "affine", "says"),
    [
        (np.zeros((3, 4)), np.eye(4), r"shape \(3, 4\)"),
        (np.zeros((3, 4, 4), complex), np.eye(4), "complex128"),
        (
            np.zeros((3, 4, 4)),
            np.diag([5e-3, 1e-3, 2e-3, 1.0])[[2, 1, 0, 3]],
            r"expected 0\.01 to 100 mm each way; state lengths in millimetres",
        ),
        (np.full((3, 4, 4), np.nan), np.eye(4), "not finite"),
        (np.full((3, 4, 4), np.inf, np.float16), np.eye(4), "not finite"),
        (np.full((3, 4, 4), 1e30), np.eye(4), r"finite numbers up to 1e\+06"),
        (np.ma.masked_equal(np.eye(4)[np.newaxis], 1.0), np.eye(4), "are masked"),
        (np.zeros((3, 4, 4)), np.zeros((4, 4)), "ends in 0 0 0 1"),
        (np.zeros((3, 4, 4)), np.eye(3), "ends in 0 0 0 1"),
        (np.zeros((3, 4, 4)), np.eye(4) + np.eye(4, k=-3), "ends in 0 0 0 1"),
        (np.zeros((3, 4, 4)), np.eye(4) + 1j, "affine's entries are complex"),
        (np.zeros((3, 4, 4)), np.ma.masked_equal(np.eye(4), 1.0), "affine's entries are masked"),
        (np.zeros((3, 4, 4)), np.eye(4).astype(str), "affine's entries are not numbers"),
        (np.zeros((3, 4, 4)), np.diag([1.5e-3, 1e-4, 1e-4, 1.0]), r"measure 0.0001 x 0.0001 x 0.0015 mm"),
        (np.zeros((3, 4, 4)), np.eye(4) + 2e5 * np.eye(4, k=3), "100 m from the origin"),
        (np.zeros((3, 4, 4)), np.eye(4) + 0.01 * np.eye(4, k=-1) * [0, 1, 0, 0], "not perpendicular"),
        (np.zeros((3, 4, 4)), np.diag([0, 1.0, 1.0, 1.0]) + np.eye(4, k=-1) * [1, 0, 0, 0], "do not stack"),
    ],
)
def test_what_is_no_scan_ends_in_one_sentence(voxels: object, affine: object, says: str) -> None:
    with pytest.raises((InputError, UsageError), match=says):
        CTVolume.from_array(voxels, affine)  # type: ignore[arg-type]


def test_a_path_is_no_image() -> None:
    with pytest.raises(UsageError, match="str is no SimpleITK"):
        CTVolume.from_sitk("scan.nii")


def test_xarray_carries_the_affine() -> None:
    pytest.importorskip("xarray")
    ct = volume()
    array = ct.to_xarray()
    assert (array.dims, array.name, array.attrs["units"]) == (("k", "j", "i"), "CT", "HU")
    np.testing.assert_allclose(array.attrs["lps_from_kji"], ct.affine)
