"""A second image is placed by its frame of reference or by registration, and is shown where it belongs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.errors import InputError, UsageError
from ronnaplan.planner.aligning import align
from ronnaplan.planner.second import Blend, Second
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import PlacedImage
from ronnaplan.planner.worker import Job
from ronnaplan.scene.cut import Cut
from ronnaplan.scene.field import Field
from tests import cases
from tests.planner.conftest import reopened

TURN, SHIFT_MM = Rotation.from_rotvec([0.06, -0.08, 0.1]).as_matrix(), np.array([7.0, -5.0, 4.0])
SPACING_MM = 3.0

CELL_MM = 5.0
"""So wide cells tell as much here; of those that the planner takes a registration takes twenty times as long."""


@cache
def other_image(uid: str | None) -> CTVolume:
    """The head as another machine would show it: turned, moved, coarser, and with other brightness.

    A place ``p`` of the scan lies at ``TURN @ p + SHIFT_MM`` in it.
    """
    scan = cases.volume()
    k, j, i = np.indices((70, 90, 80)).reshape(3, -1).astype(float)
    origin = np.array([-120.0, -135.0, -70.0])
    places = origin + SPACING_MM * np.stack([i, j, k], axis=1)
    in_scan = (places - SHIFT_MM) @ TURN
    indices = scan.grid.indices(in_scan).T
    blurred = gaussian_filter(scan.voxels_hu.astype(np.float32), (0.5, 1.0, 1.0))
    hu = map_coordinates(blurred, indices, order=1, cval=-1000.0).reshape(70, 90, 80)
    soft = np.exp(-(((hu - 40.0) / 120.0) ** 2))
    values = (900.0 * soft + 60.0 * (hu > 300)).astype(np.float32)
    origins = origin + SPACING_MM * np.arange(70)[:, np.newaxis] * np.array([0.0, 0.0, 1.0])
    grid = SliceGrid(origins, SPACING_MM * np.array([0.0, 1.0, 0.0]), SPACING_MM * np.array([1.0, 0.0, 0.0]))
    return CTVolume(values, grid, replace(scan.source, frame_of_reference_uid=uid))


def test_registration_finds_where_the_head_lies_and_says_how_sure(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ronnaplan.planner.second.CELL_MM", CELL_MM)
    state.take_second(other_image(None), "mr.nii")
    second = state.other
    assert not second.placed
    second.register()
    assert second._pose is not None
    corners = 60.0 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 1)])
    found = corners @ second._pose[:3, :3].T + second._pose[:3, 3]
    assert np.linalg.norm(found - (corners @ TURN.T + SHIFT_MM), axis=1).max() < 1.5  # half a voxel of it
    assert "registered by SimpleITK" in second.quality
    assert "DOUBTFUL" not in second.quality
    again = reopened(state)
    again.take_second(other_image(None), "mr.nii")
    assert (again.other.quality, again.other.placed) == (second.quality, True)
    assert again.other._pose is not None
    assert again.other._pose == pytest.approx(second._pose)
    grid = other_image(None).grid
    moved = SliceGrid(grid.origins_mm + 30.0, grid.row_step_mm, grid.column_step_mm)
    again.take_second(replace(other_image(None), grid=moved), "mr.nii")
    assert not again.other.placed  # of the same voxels under another header it says nothing
    (key,) = state.look.images
    skewed = np.array(state.look.images[key].image_from_scan) * 1.01
    state.look.images[key] = PlacedImage.model_validate(
        {"image_from_scan": tuple(map(tuple, skewed.tolist())), "apart_mm": 0.0}
    )
    state.look.save()
    again = reopened(state)
    again.take_second(other_image(None), "mr.nii")
    assert not again.other.placed  # what is no rigid motion is not believed


def test_an_image_whose_header_exchanges_left_and_right_is_told(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A head fits its mirror image as well as two starts can tell."""
    monkeypatch.setattr("ronnaplan.planner.second.CELL_MM", CELL_MM)
    mirrored = replace(other_image(None), voxels_hu=other_image(None).voxels_hu[:, :, ::-1])
    state.take_second(mirrored, "mr.nii")
    state.other.register()
    told = "DOUBTFUL, look closely: with left and right exchanged it fits better, as if its header were wrong"
    assert state.other.quality.startswith(told)
    again = reopened(state)
    again.take_second(mirrored, "mr.nii")
    assert again.other.quality == state.other.quality


def test_a_head_that_is_its_own_mirror_image_tells_nothing_of_exchanged_sides() -> None:
    """As one that has hardly any left and right: what blurs it by another way of cells made it seem to fit better."""
    scan, rng = cases.volume(), np.random.default_rng(1)
    hu = scan.voxels_hu.astype(np.float32)
    even = ((hu + hu[:, :, ::-1]) / 2).astype(np.float32)
    noisy = (even + rng.normal(0.0, 20.0, even.shape)).astype(np.float32)
    here = scan.grid
    there = SliceGrid(here.origins_mm @ TURN.T + SHIFT_MM, here.row_step_mm @ TURN.T, here.column_step_mm @ TURN.T)
    found = align(
        Field.of(replace(scan, voxels_hu=even), CELL_MM),
        Field.of(replace(scan, voxels_hu=noisy, grid=there), CELL_MM),
    )
    assert found.apart_mm < 1.0
    assert found.exchanged == ()


@pytest.mark.parametrize("shape", [(20, 20, 20), (2, 2, 2)])
def test_an_image_that_shows_nothing_is_refused_in_a_sentence(shape: tuple[int, int, int]) -> None:
    """SimpleITK's error ended the process, and the page was told to see what the planner had printed."""
    cells = np.moveaxis(np.indices((20, 20, 20)), 0, -1).sum(axis=-1).astype(np.float32)
    there = Field(cells, np.zeros(3), CELL_MM)
    with pytest.raises(
        InputError, match=r"cannot register the second image .*\); give one that shows the same head"
    ):
        align(there, replace(there, values=np.zeros(shape, np.float32)))


def test_an_image_of_the_same_frame_is_placed_at_once_and_blended_or_checkered() -> None:
    scan = cases.volume()
    second = Second(scan, replace(scan, voxels_hu=-scan.voxels_hu), "inverted", Job.do, lambda _: None)
    assert second.placed
    assert "own frame of reference" in second.quality
    cut = Cut(np.array([1.0, 0, 0]), np.array([0.0, 1, 0]), np.array([0.0, 0, 30.0]), 200.0)
    plain = np.full((160, 160), 100, dtype=np.uint8)
    assert second.over(plain, cut, Blend(0.0)) is plain
    whole = second.over(plain, cut, Blend(1.0))
    assert whole[80, 80] < whole[2, 2]  # air is bright in the second
    assert second.over(plain, cut, Blend(0.5)) == pytest.approx((whole.astype(float) + 100) / 2, abs=1.0)
    squares = second.over(plain, cut, Blend(1.0, "checkerboard"))
    assert (squares[:20, 20:40] == 100).all()
    assert (squares[:20, :20] == whole[:20, :20]).all()
    with pytest.raises(UsageError, match="blend, checkerboard"):
        Blend(0.5, "dance")
