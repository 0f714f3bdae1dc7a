"""Cameras that moved against each other between the boards of their calibration are refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phantoms import cameras as rendering
from phantoms.robot_session import CAMERAS, DISTORTIONS, MATRICES, SIZE
from ronnaplan.errors import InputError, RefusedError
from ronnaplan.robot.stereo import calibration
from ronnaplan.robot.stereo.calibration import StereoCalibration, calibrate_on_board
from ronnaplan.transforms import invert
from tests.long import few_or_all
from tests.robot.stereo.test_calibration import CORNERS, SQUARE, board_place

BOARDS = 8
NOISE_PX = 0.01
GRID = np.append(np.mgrid[: CORNERS[0], : CORNERS[1]].T.reshape(-1, 2) * SQUARE, np.zeros((63, 1)), axis=1)


def calibrated(
    monkeypatch: pytest.MonkeyPatch, turned_deg: np.ndarray, *, seed: int = 3, bent_px: float = 0.0
) -> StereoCalibration:
    """Cameras of boards of which the right one saw each turned by so much; its lens may bend otherwise by a wave."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    seen = []
    poses = sorted((board_place(rng, 28.0) for _ in turned_deg), key=lambda pose: float(pose[0, 3]))
    for pose, turned in zip(poses, turned_deg, strict=True):
        pair = []
        for k, place in enumerate(CAMERAS):
            slipped = np.eye(4)
            slipped[:3, :3] = Rotation.from_rotvec(axis * np.radians(turned) * k).as_matrix()
            in_camera = invert(place @ slipped) @ pose
            at = rendering.project(GRID @ in_camera[:3, :3].T + in_camera[:3, 3], MATRICES[k], DISTORTIONS[k])
            at = at + bent_px * np.sin(5 * np.pi * at / np.array(SIZE[::-1]))
            pair.append((at + rng.normal(size=at.shape) * NOISE_PX)[:, None])
        seen.append((pair[0], pair[1]))
    monkeypatch.setattr(calibration, "seen_by_both", lambda left, right, corners: seen)
    blank = [np.zeros(SIZE, dtype=np.uint8)] * len(seen)
    return calibrate_on_board(blank, blank, corners=CORNERS, square_mm=SQUARE)


@pytest.mark.parametrize("turned_deg", [0.02, 0.05])
def test_a_camera_that_slips_between_two_boards_is_refused_and_told_when(
    monkeypatch: pytest.MonkeyPatch, turned_deg: float
) -> None:
    with pytest.raises(
        RefusedError, match=r"one camera moved .* between boards 5 and 6 of the 8 .* take all boards"
    ):
        calibrated(monkeypatch, turned_deg * (np.arange(BOARDS) >= 5))


def test_a_camera_that_goes_off_steadily_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RefusedError, match="one camera moved against the other steadily"):
        calibrated(monkeypatch, np.linspace(0.0, 0.05, BOARDS))


@pytest.mark.parametrize("bent_px", [0.0, 0.05])
@few_or_all("cases", 3, 30)
def test_cameras_that_rest_are_calibrated_whatever_their_lenses_lack(
    monkeypatch: pytest.MonkeyPatch, bent_px: float, cases: int
) -> None:
    """Boards that go from left to right, so that what a lens lacks goes with their order.

    Some of the boards, near each other as they are, do not determine a lens that bends otherwise.
    """
    determined = 0
    for seed in range(cases):
        try:
            assert calibrated(monkeypatch, np.zeros(BOARDS), seed=seed, bent_px=bent_px).boards_used == BOARDS
        except InputError:
            continue
        determined += 1
    assert determined > cases / 2
