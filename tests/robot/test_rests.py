"""Of a rest few poses count; of what moves, or stops at every place alike, all do."""

import numpy as np
from scipy.spatial.transform import Rotation

from ronnaplan.geometry import rms_mm
from ronnaplan.robot.hand_eye import calibrate_hand_eye
from ronnaplan.robot.rests import beside_rests
from tests.robot.test_orientation import hand_eye_poses


def turns(degrees: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) by so many degrees about one axis."""
    return np.asarray(Rotation.from_rotvec(np.radians(degrees)[:, None] * [0.6, 0, 0.8]).as_matrix())


def test_of_a_rest_a_tenth_of_the_poses_that_count_do_and_lie_evenly_in_it() -> None:
    counts = beside_rests(turns(np.r_[np.zeros(1000), np.arange(6, 606, 2)]))
    assert counts[1000:].all()
    of_rest = np.flatnonzero(counts[:1000])
    assert len(of_rest) == 33  # of 333
    assert np.ptp(np.diff(of_rest)) <= 1
    assert of_rest[[0, -1]].tolist() == [0, 999]


def test_of_a_short_rest_ten_poses_count() -> None:
    assert beside_rests(turns(np.r_[np.arange(0, 180, 6), np.full(50, 180)])).sum() == 40


def test_all_poses_of_what_stops_at_a_few_places_alike_count() -> None:
    assert beside_rests(turns(np.repeat(np.arange(0, 80, 10), 50))).all()


def test_what_moves_without_turning_does_not_rest() -> None:
    still = np.tile(np.eye(3), (400, 1, 1))
    line = np.linspace(0, 1000, 400)[:, None] * [0, 0.6, 0.8]
    assert beside_rests(still, line).all()


def test_a_robot_that_stands_still_for_most_of_a_recording_tells_of_no_joints_that_err() -> None:
    seen, driven, *_ = hand_eye_poses(3, 60, 1e-3, 0.2)
    rest = np.repeat(hand_eye_poses(3, 60, 0.0, 0.0)[0][:1], 200, axis=0)
    rest[:, :3, 3] += 0.005 * np.random.default_rng(3).normal(size=(200, 3))
    found = calibrate_hand_eye(
        np.concatenate([rest, seen]), np.concatenate([np.repeat(driven[:1], 200, 0), driven])
    )
    moving = calibrate_hand_eye(seen, driven)
    assert found.rested > 180
    assert not found.doubts
    assert rms_mm(found.m_from_tcp.covariance[:3, :3]) < 1.2 * rms_mm(moving.m_from_tcp.covariance[:3, :3])
