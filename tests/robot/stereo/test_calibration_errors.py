"""What calibrated cameras do not know of themselves, held against calibrating them again, and against other lenses."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phantoms import cameras as rendering
from ronnaplan.errors import InputError
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import TCP
from ronnaplan.robot.stereo import calibration
from ronnaplan.robot.stereo.board import grid_mm
from ronnaplan.robot.stereo.calibration import StereoCalibration, calibrate_on_board
from ronnaplan.robot.stereo.calibration_errors import errors_of, known_share
from ronnaplan.robot.stereo.camera import RIG, StereoRig
from ronnaplan.sigmas import SIGMA_SQUARE
from ronnaplan.transforms import invert, transform_points
from tests.robot.stereo.stereo_views import RIGHT, D, K

CORNERS, SQUARE_MM, NOISE_PX = (9, 7), 5.5, 0.02
PLACES = np.array([[0.0, 0, 300], [12, -8, 305], [-20, 10, 296], [24, 16, 300], [-28, -20, 303]])
NO_TCP = Pose.exact(np.eye(4), TCP, RIG)


def shown(points_mm: np.ndarray, side: int, prism_px: float = 0.0) -> np.ndarray:
    """Pixels of places in the rig; by a prism the lens bends aside, which the cameras' model does not know."""
    seen = transform_points(invert((np.eye(4), RIGHT)[side]), points_mm)
    away = (seen[:, :2] / seen[:, 2:]) ** 2
    aside = prism_px * away.sum(axis=1, keepdims=True) / 0.02 * (1, -0.7)
    pixels: np.ndarray = rendering.project(seen, K[side], D[side]) + aside
    return pixels


@cache
def boards(wide: float = 1.0) -> tuple[np.ndarray, ...]:
    """The corners in the rig of eight tilted boards, as ``wide`` as others."""
    rng, grid = np.random.default_rng(3), grid_mm(CORNERS, SQUARE_MM * wide)
    found = []
    for _ in range(8):
        turn = Rotation.from_rotvec([0, np.radians(-14.5), 0]) * Rotation.from_euler(
            "xyz", rng.uniform(-28, 28, 3), degrees=True
        )
        at = np.array([*rng.uniform(-14, 14, 2) * wide, 300 + rng.uniform(-15, 15)])
        found.append(turn.apply(grid - grid.mean(axis=0)) + at)
    return tuple(found)


def calibrated(
    monkeypatch: pytest.MonkeyPatch,
    rng: np.random.Generator,
    prism_px: float = 0.0,
    wide: float = 1.0,
    told: float = 1.0,
    bowed_mm: float = 0.0,
    sigma_square: float = SIGMA_SQUARE,
) -> StereoCalibration:
    """Cameras that saw with noise the corners of boards whose side is ``told`` times as long as it is."""
    flat = grid_mm(CORNERS, SQUARE_MM * wide)
    away = ((flat - flat.mean(axis=0)) ** 2).sum(axis=1, keepdims=True)
    seen = []
    for board in boards(wide):
        across, down = board[1] - board[0], board[CORNERS[0]] - board[0]
        off = np.cross(across, down) / (SQUARE_MM * wide) ** 2
        bowed = board + bowed_mm * away / away.max() * off
        pair = [shown(bowed, side, prism_px) + rng.normal(size=(63, 2)) * NOISE_PX for side in range(2)]
        seen.append(tuple(one[:, None].astype(np.float32) for one in pair))
    monkeypatch.setattr(calibration, "seen_by_both", lambda left, right, corners: seen)
    image = np.zeros(rendering.SIZE)
    return calibrate_on_board(
        [image], [image], corners=CORNERS, square_mm=SQUARE_MM * wide * told, sigma_square=sigma_square
    )


def located(found: StereoCalibration, prism_px: float = 0.0) -> np.ndarray:
    """Where both cameras put the places, once what they see of the boards is brought to where it is."""
    cameras = found.left, found.right
    true = np.concatenate([PLACES, *boards()])
    rays = [
        one.rays(shown(true, side, prism_px)) @ one.rig_from_camera[:3, :3].T for side, one in enumerate(cameras)
    ]
    left, right = (np.eye(3) - ray[:, :, None] * ray[:, None, :] for ray in rays)
    meant = left @ found.left.center_mm + right @ found.right.center_mm
    places = np.linalg.solve(left + right, meant[:, :, None])[:, :, 0]
    seen, corners = places[len(PLACES) :], true[len(PLACES) :]
    turn = Rotation.align_vectors(corners - corners.mean(axis=0), seen - seen.mean(axis=0))[0]
    found_mm: np.ndarray = turn.apply(places[: len(PLACES)] - seen.mean(axis=0)) + corners.mean(axis=0)
    return found_mm


def stated(found: StereoCalibration) -> np.ndarray:
    """The covariances (N, 3, 3) of the places; the spheres are so small that they are points."""
    rig = found.rig(NO_TCP)
    errors = errors_of(rig)
    assert errors is not None
    return np.array([errors.of_center(rig, place, 0.5) for place in PLACES])


def test_cameras_calibrated_again_scatter_as_one_calibration_states(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(8)
    trials = [calibrated(monkeypatch, rng, told=1 + SIGMA_SQUARE * rng.normal()) for _ in range(24)]
    assert np.mean([one.boards.error_px for one in trials]) == pytest.approx(NOISE_PX, rel=0.03)
    assert np.median([one.boards.lens_px for one in trials]) < 0.4 * NOISE_PX
    errors = np.array([located(one) for one in trials]) - PLACES
    known = replace(trials[0], boards=replace(trials[0].boards, lens_px=0.0))
    each = np.linalg.solve(stated(known), errors[:, :, :, None])[:, :, :, 0]
    normalized = (each * errors).sum(axis=2) / 3
    assert 0.75 < normalized.mean() < 1.3  # 24 trials, five places that err alike: a standard error of 0.12
    seen, told = (errors**2).sum(axis=2).mean(axis=0), np.trace(stated(known), axis1=1, axis2=2)
    assert np.sqrt(seen / told) == pytest.approx(1.0, abs=0.35)


def test_lenses_that_bend_otherwise_are_told_by_the_boards_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The Jacobian alone does not see it, nor do residuals, of which a bent board takes a part, tell all of it."""
    found = calibrated(monkeypatch, np.random.default_rng(9), prism_px=0.8)
    assert found.boards.lens_px > NOISE_PX
    assert re.search(
        r"off by 0\.0\d\d pixels in smooth fields, .* noise of 0\.020: the board is wavy", found.doubts()[-1]
    )
    assert found.boards.error_px == pytest.approx(NOISE_PX, rel=0.1)
    errors = located(found, prism_px=0.8) - PLACES
    alone = replace(found, boards=replace(found.boards, lens_px=0.0))
    with_lens, without = (
        np.mean([error @ np.linalg.solve(one, error) / 3 for error, one in zip(errors, stated(each), strict=True)])
        for each in (found, alone)
    )
    assert without > 8
    assert with_lens < 2  # 2.6 where all that bends aside is held to be decentered


def test_a_board_of_another_size_than_told_is_counted_as_far_as_it_is_said_to_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A printed board, off by 0.1 %."""
    rng = np.random.default_rng(11)
    sure, printed = (calibrated(monkeypatch, rng, told=1.001, sigma_square=one) for one in (SIGMA_SQUARE, 1e-3))
    normalized = [
        np.mean(
            [
                error @ np.linalg.solve(one, error) / 3
                for error, one in zip(located(each) - PLACES, stated(each), strict=True)
            ]
        )
        for each in (sure, printed)
    ]
    assert normalized[0] > 8
    assert normalized[1] < 1.5


def test_the_shape_of_a_board_that_is_not_flat_is_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cameras and what is stated of them are those that flat boards give."""
    flat, bowed = (calibrated(monkeypatch, np.random.default_rng(11), bowed_mm=one) for one in (0.0, 0.2))
    assert bowed.boards.error_px == pytest.approx(flat.boards.error_px, rel=0.01)
    np.testing.assert_allclose(located(bowed), located(flat), atol=0.001)
    np.testing.assert_allclose(stated(bowed), stated(flat), rtol=0.1, atol=1e-7)
    assert bowed.doubts() == ()


def test_places_beyond_the_boards_are_known_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    wide, near = (calibrated(monkeypatch, np.random.default_rng(10), wide=one) for one in (1.0, 0.6))
    assert known_share(wide.rig(NO_TCP), 0.012) > 0.8 > 0.6 > known_share(near.rig(NO_TCP), 0.012) > 0.1
    assert wide.doubts() == ()
    (doubt,) = near.doubts()
    assert "the boards tell the cameras to 0.012 mm in " in doubt
    assert "take more boards" in doubt
    assert "the boards tell the cameras to 0.013 mm in " in near.doubts(0.013)[0]
    assert near.doubts(0.1) == ()


def test_more_boards_are_not_advised_where_their_squares_leave_places_open(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    printed = calibrated(monkeypatch, np.random.default_rng(10), sigma_square=1e-3)
    assert "measure the board over its whole length" in printed.doubts()[0]


def test_boards_that_are_all_alike_do_not_determine_the_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    found = calibrated(monkeypatch, np.random.default_rng(10))
    alike = replace(found.boards, rig_from_board=np.repeat(found.boards.rig_from_board[:1], 8, axis=0))
    with pytest.raises(InputError, match="the boards do not determine the cameras; tilt"):
        errors_of(StereoRig(found.left, found.right, NO_TCP, alike))


def test_cameras_that_do_not_tell_what_they_saw_have_no_such_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    found = calibrated(monkeypatch, np.random.default_rng(10))
    assert errors_of(StereoRig(found.left, found.right, NO_TCP)) is None
    unknown = replace(found.left, size_px=None)
    with pytest.raises(InputError, match="calibrated on boards, but have no size"):
        StereoRig(unknown, found.right, NO_TCP, found.boards)
