"""A chessboard in an image: where its corners are, and which of them is which."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phantoms import cameras as rendering
from phantoms.robot_session import DISTORTIONS, MATRICES, SIZE
from ronnaplan.robot.stereo.board import _fitted, find_corners, grid_mm, quarters_apart, recounted, shapes
from tests.long import few_and_others
from tests.robot.stereo.stereo_views import RIGHT

CORNERS = (9, 7)


def small_board(rng: np.random.Generator, turn: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the image of a board whose squares are 24 pixels wide, and where its corners are."""
    grid = np.zeros((63, 3))
    grid[:, :2] = np.mgrid[: CORNERS[0], : CORNERS[1]].T.reshape(-1, 2) * 3.5
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
    pose[:3, 3] = np.array([5.0, 3, 300]) - pose[:3, :3] @ grid.mean(axis=0)
    image = rendering.board_image(pose, CORNERS, 3.5, MATRICES[0], DISTORTIONS[0], rng, SIZE)
    return image, rendering.project(grid @ pose[:3, :3].T + pose[:3, 3], MATRICES[0], DISTORTIONS[0])


def off_px(found: np.ndarray | None, true: np.ndarray) -> np.ndarray:
    """Return how far off the corners are, from whichever end they are counted."""
    assert found is not None
    flat = found.reshape(-1, 2)
    return min((np.linalg.norm(one - true, axis=1) for one in (flat, flat[::-1])), key=np.sum)


@few_and_others("bend", [0.45], [1.0])
def test_corners_of_small_squares_are_found_to_a_fiftieth_of_a_pixel(bend: float) -> None:
    """OpenCV's own are up to 0.8 pixels off at the board's edge. Linear in the light, or bent to be shown."""
    image, true = small_board(np.random.default_rng(2), (20.0, -15, 12))
    off = off_px(find_corners(255 * (image / 255) ** bend, CORNERS), true)
    assert np.sqrt((off**2).mean()) < 0.02
    assert off.max() < 0.06


def test_a_board_of_which_a_corner_is_none_is_not_seen_whole() -> None:
    """Something lies across it, or the place is not a corner's."""
    image, true = small_board(np.random.default_rng(2), (20.0, -15, 12))
    grey = image.astype(float)
    assert _fitted(grey, true, CORNERS) is not None
    x, y = np.round(true[31]).astype(int)
    grey[y - 15 : y + 16, x - 15 : x + 16] = 120 + np.random.default_rng(0).normal(size=(31, 31))
    assert _fitted(grey, true, CORNERS) is None


def test_a_board_is_found_beside_what_is_far_brighter() -> None:
    """A retro-reflective marker that lies beside it, or a lamp."""
    bright, true = small_board(np.random.default_rng(6), (12.0, 8, -9))
    dark = (0.12 * bright).astype(np.uint8)
    dark[20:60, 20:60] = 255
    off = off_px(find_corners(dark, CORNERS), true)
    assert np.sqrt((off**2).mean()) < 0.05


@pytest.mark.parametrize(("corners", "least"), [((9, 7), 2), ((4, 4), 1)])
def test_a_board_that_looks_the_same_turned_is_counted_alike_by_both_cameras(
    corners: tuple[int, int], least: int
) -> None:
    """Upside down, and on its side where it is square: each camera takes any of its corners for the first one."""
    rng = np.random.default_rng(0)
    left = Rotation.from_rotvec(rng.normal(size=(8, 3)) * 0.3)
    quarters = least * rng.integers(0, 4 // least, 8)
    turned = Rotation.from_euler("z", -90.0 * quarters[:, None], degrees=True)
    right = RIGHT[:3, :3].T @ (left * turned).as_matrix()
    assert quarters_apart(left.as_matrix(), right, square=corners[0] == corners[1]) == quarters.tolist()
    grid = np.append(
        np.mgrid[: corners[0], : corners[1]].T.reshape(-1, 2), np.zeros((np.prod(corners), 1)), axis=1
    )
    grid -= grid.mean(axis=0)
    for place, one, count in zip(left, turned, quarters.tolist(), strict=True):
        seen = (place * one).apply(grid)[:, :2]
        np.testing.assert_allclose(recounted(seen, corners, count), place.apply(grid)[:, :2], atol=1e-12)


@pytest.mark.parametrize(("corners", "count"), [((9, 7), 14), ((7, 9), 14), ((3, 3), 8)])
def test_numbers_of_a_boards_shape_neither_move_nor_scale_it_nor_repeat_each_other(
    corners: tuple[int, int], count: int
) -> None:
    moves, places = shapes(corners), grid_mm(corners, 1.0)
    aside = places - places.mean(axis=0)
    turned = [np.cross(axis, aside).ravel() for axis in np.eye(3)]
    shifted = [np.broadcast_to(axis, aside.shape).ravel() for axis in np.eye(3)]
    others = np.column_stack([*turned, *shifted, aside.ravel()])
    each = moves.reshape(-1, count)
    assert np.linalg.matrix_rank(np.column_stack([each, others])) == count + 7
    assert np.abs(moves[:, 2].T @ np.column_stack([np.ones(len(aside)), aside[:, :2]])).max() < 1e-9
