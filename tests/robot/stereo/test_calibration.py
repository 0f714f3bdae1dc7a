"""Calibration of the cameras on a board, and of their place on the robot from one resting sphere."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phantoms import cameras as rendering
from phantoms.robot_session import CAMERAS, DISTORTIONS, MATRICES, SIZE
from ronnaplan.errors import InputError, RefusedError
from ronnaplan.robot.stereo import board, calibration
from ronnaplan.robot.stereo.board import FEWEST_BOARDS
from ronnaplan.robot.stereo.calibration import calibrate_on_board, calibrate_tcp
from ronnaplan.robot.stereo.sphere import locate_sphere
from ronnaplan.transforms import invert
from tests.long import few_or_all
from tests.robot.misreadings import MISREAD, misread
from tests.robot.stereo.boards import find_once
from tests.robot.stereo.stereo_views import DIAMETER, RIG_EXACT, moved, placed

CORNERS, SQUARE = (9, 7), 6.0


def board_place(rng: np.random.Generator, largest_tilt_deg: float) -> np.ndarray:
    """The pose of a board at some tilt about the working place."""
    middle = np.array([(CORNERS[0] - 1) / 2, (CORNERS[1] - 1) / 2, 0]) * SQUARE
    tilt = Rotation.from_euler("xyz", rng.uniform(-1, 1, 3) * largest_tilt_deg, degrees=True).as_matrix()
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0, np.radians(-14.5), 0]).as_matrix() @ tilt
    pose[:3, 3] = np.array([*rng.uniform(-6, 6, 2), 300 + rng.uniform(-15, 15)]) - pose[:3, :3] @ middle
    return pose


@cache
def boards() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The cameras' views of a board at so many tilts about the working place."""
    rng = np.random.default_rng(6)
    left: list[np.ndarray] = []
    right: list[np.ndarray] = []
    for _ in range(6):
        pose = board_place(rng, 28.0)
        for images, place, k, d in zip((left, right), CAMERAS, MATRICES, DISTORTIONS, strict=True):
            images.append(rendering.board_image(invert(place) @ pose, CORNERS, SQUARE, k, d, rng, SIZE))
    return left, right


def seen(center_mm: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The same cameras' views of a sphere."""
    left, right = (
        rendering.sphere_image([moved(invert(place), center_mm)], DIAMETER, k, d, rng, size=SIZE)
        for place, k, d in zip(CAMERAS, MATRICES, DISTORTIONS, strict=True)
    )
    return left, right


@pytest.fixture
def found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    find_once(monkeypatch)


@pytest.mark.usefixtures("found_once")
def test_cameras_calibrated_on_a_board_measure_the_sphere_to_a_fiftieth_of_a_millimetre() -> None:
    """Positions against each other: a board calibration has no other origin than the camera it finds."""
    calibration = calibrate_on_board(*boards(), corners=CORNERS, square_mm=SQUARE)
    rig = calibration.rig(RIG_EXACT.tcp_from_rig)
    assert calibration.rms_px < 0.03
    assert calibration.doubts() == ()
    rng = np.random.default_rng(7)
    truth = [
        np.array([x, y, z]) for x, y, z in ((-8.0, -6, 296), (9, -5, 300), (-7, 8, 304), (8, 7, 298), (0, 0, 301))
    ]
    found = [locate_sphere(*seen(c, rng), rig, diameter_mm=DIAMETER).position_mm for c in truth]
    a, b = np.array(truth) - np.mean(truth, axis=0), np.array(found) - np.mean(found, axis=0)
    turn = Rotation.align_vectors(a, b)[0].as_matrix()
    assert np.linalg.norm(b @ turn.T - a, axis=1).max() < 0.02


@pytest.mark.usefixtures("found_once")
def test_board_images_that_do_not_show_the_board_are_refused() -> None:
    left, right = boards()
    blank = [np.full_like(left[0], 100)] * FEWEST_BOARDS
    with pytest.raises(
        InputError, match=r"in 1 image pairs; expected 6 or more of a plain chessboard .* 9 x 7 inner"
    ):
        calibrate_on_board(left[:1] + blank[1:], right[:1] + blank[1:], corners=CORNERS, square_mm=SQUARE)
    with pytest.raises(InputError, match="pairs of one size"):
        calibrate_on_board(left, right[:5], corners=CORNERS, square_mm=SQUARE)
    for wrong in ((2, 7), (9, 7, 5), (9.5, 7), ("9", "7")):  # which ended in tracebacks of OpenCV
        with pytest.raises(
            InputError, match="inner corners was given; expected columns and rows, 3 to 100 of either"
        ):
            calibrate_on_board(left, right, corners=wrong, square_mm=SQUARE)  # type: ignore[arg-type]
    for side_mm, error in ((0.0, 1e-4), (np.nan, 1e-4), (SQUARE, -0.1), (SQUARE, 1.0)):
        with pytest.raises(InputError, match="expected a length above zero, and its standard error as a part"):
            calibrate_on_board(left, right, corners=CORNERS, square_mm=side_mm, sigma_square=error)
    colored = [np.dstack([image] * 3) for image in left]
    with pytest.raises(InputError, match="grey values"):
        calibrate_on_board(colored, colored, corners=CORNERS, square_mm=SQUARE)


@pytest.mark.usefixtures("found_once")
def test_board_images_that_contradict_each_other_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boards that do are slow to fit, so the limit is lowered instead."""
    monkeypatch.setattr(calibration, "LARGEST_RMS_PX", 0.001)
    left, right = boards()
    with pytest.raises(InputError, match="contradict each other by"):
        calibrate_on_board(left[:FEWEST_BOARDS], right[:FEWEST_BOARDS], corners=CORNERS, square_mm=SQUARE)


def test_boards_that_hardly_tilt_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """One camera's pictures tell; where their corners are needs no picture."""
    rng, seen_at = np.random.default_rng(6), {}
    for number in range(FEWEST_BOARDS):
        grid = np.append(np.mgrid[: CORNERS[0], : CORNERS[1]].T.reshape(-1, 2) * SQUARE, np.zeros((63, 1)), axis=1)
        pose = board_place(rng, 4.0)
        at = (
            rendering.project(grid @ pose[:3, :3].T + pose[:3, 3], MATRICES[0], DISTORTIONS[0])
            + rng.normal(size=(63, 2)) * 0.03
        )
        seen_at[number] = at[:, None].astype(np.float32)
    monkeypatch.setattr(board, "find_corners", lambda image, corners: seen_at[image[0, 0]])
    left = [np.full(SIZE, number, dtype=np.uint8) for number in range(FEWEST_BOARDS)]
    with pytest.raises(InputError, match="do not determine the cameras: the boards tilt by"):
        calibrate_on_board(left, left, corners=CORNERS, square_mm=SQUARE)


def looks(seed: int, count: int, noise_mm: float, turn: float = 0.5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Robot poses about a resting sphere, what the rig measures at each, and the true TCP from rig."""
    rng, world = np.random.default_rng(seed), np.random.default_rng(77)
    tcp_from_rig = placed(30.0, 12.0)
    tcp_from_rig[:3, 3] += (0, -20, -280)
    sphere = np.array([700.0, 200, 300])
    poses, spheres = [], []
    for _ in range(count):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec(world.normal(size=3) * turn).as_matrix()
        pose[:3, 3] = sphere - pose[:3, :3] @ world.uniform(-8, 8, 3)
        poses.append(pose)
        spheres.append(moved(invert(pose @ tcp_from_rig), sphere) + rng.normal(size=3) * noise_mm)
    return np.array(poses), np.array(spheres), tcp_from_rig


def test_one_resting_sphere_seen_from_many_poses_places_the_rig_on_the_robot() -> None:
    poses, spheres, truth = looks(0, 12, 0.0)
    found = calibrate_tcp(poses, spheres)
    np.testing.assert_allclose(found.tcp_from_rig.matrix, truth, atol=1e-6)
    np.testing.assert_allclose(found.sphere_robot_mm, [700, 200, 300], atol=1e-6)


def test_cameras_that_mirror_their_images_place_no_rig() -> None:
    """A board looks alike in a mirror, so that it calibrates them; the robot's motion tells."""
    poses, spheres, _ = looks(0, 12, 0.01)
    with pytest.raises(RefusedError, match="no camera mirrors its images"):
        calibrate_tcp(poses, spheres * [-1, 1, 1])


@few_or_all("cases", 40, 150)
def test_the_rigs_place_has_the_stated_error(cases: int) -> None:
    at = np.array([[0.0, 0, 300]])
    images, stated = [], []
    for seed in range(cases):
        poses, spheres, truth = looks(seed, 15, 0.05)
        found = calibrate_tcp(poses, spheres).tcp_from_rig
        images.append(found.apply(at)[0])
        stated.append(np.trace(found.point_covariances(at)[0]))
    error = np.array(images) - moved(truth, at[0])
    assert np.sqrt(np.mean(stated)) == pytest.approx(np.sqrt((error**2).sum(1).mean()), rel=0.15)


def test_poses_that_cannot_place_the_rig_are_refused() -> None:
    poses, spheres, _ = looks(0, 12, 0.05, turn=0.0)
    with pytest.raises(InputError, match="do not determine"):
        calibrate_tcp(poses, spheres)
    poses, spheres, _ = looks(0, 12, 0.01, turn=np.radians(1.0))
    with pytest.raises(InputError, match="do not determine where the rig is: they turn by"):
        calibrate_tcp(poses, spheres)
    with pytest.raises(InputError, match="5 robot poses came with 12 spheres"):
        calibrate_tcp(poses[:5], spheres)
    for wrong, told in (("none", "are not numbers"), (7.0, r"have shape \(\)")):
        with pytest.raises(InputError, match=told):
            calibrate_tcp(wrong, spheres)


@pytest.mark.parametrize("axes", [[], [0, 1]])
def test_spheres_in_one_place_or_plane_of_the_rig_do_not_place_it(axes: list[int]) -> None:
    poses, spheres, _ = looks(0, 12, 0.05)
    flat = np.zeros_like(spheres)
    flat[:, axes] = spheres[:, axes]
    with pytest.raises(InputError, match="do not determine"):
        calibrate_tcp(poses, flat)


def test_looks_and_poses_that_do_not_belong_together_do_not_place_the_rig() -> None:
    poses, spheres, _ = looks(0, 12, 0.05)
    in_cm = poses.copy()
    in_cm[:, :3, 3] /= 10
    for wrong in (np.roll(poses, 1, axis=0), in_cm):
        with pytest.raises(RefusedError, match="its places in R scatter by"):
            calibrate_tcp(wrong, spheres)


@pytest.mark.parametrize("read", MISREAD)
def test_rotations_of_the_robot_that_were_misread_are_told(read: str) -> None:
    poses, spheres, _ = looks(0, 12, 0.01)
    with pytest.raises(RefusedError, match=f"it rested if in the robot's poses .*{MISREAD[read]}"):
        calibrate_tcp(misread(poses, read), spheres)
