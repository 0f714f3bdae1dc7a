"""Orientation of the TCP in M: Eq. 5 and the hand-eye solution over many poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import FrameMismatchError, InputError, RefusedError
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import OTS, TCP, M, R
from ronnaplan.robot.hand_eye import calibrate_hand_eye
from ronnaplan.robot.orientation import (
    departure_of_eq_5_deg,
    frame_of_three,
    orientation_covariance,
    tool_orientation,
    tool_pose,
)
from ronnaplan.robot.pivot import calibrate_pivot
from ronnaplan.transforms import invert
from tests.filtered import filtered
from tests.long import few_and_others, few_or_all

TRIANGLE = np.array([[600.0, 100, 300], [900, 150, 280], [700, 400, 350]])


def matrix(rng: np.random.Generator, reach_mm: float = 300) -> np.ndarray:
    full = np.eye(4)
    full[:3, :3] = Rotation.random(rng=rng).as_matrix()
    full[:3, 3] = rng.normal(size=3) * reach_mm
    return full


def scene(seed: int) -> tuple[np.ndarray, np.ndarray, Pose, Pose]:
    """M from TCP, OTS from R, and one moment's poses of M and TCP."""
    rng = np.random.default_rng(seed)
    m_from_tcp, ots_from_r, robot_from_tcp = matrix(rng), matrix(rng, 2000), matrix(rng)
    ots_from_m = ots_from_r @ robot_from_tcp @ invert(m_from_tcp)
    return m_from_tcp, ots_from_r, Pose.exact(ots_from_m, OTS, M), Pose.exact(robot_from_tcp, R, TCP)


def test_equation_5_gives_the_orientation() -> None:
    for seed in range(10):
        m_from_tcp, ots_from_r, ots_from_m, robot_from_tcp = scene(seed)
        seen = TRIANGLE @ ots_from_r[:3, :3].T + ots_from_r[:3, 3]
        found = tool_orientation(seen, TRIANGLE, ots_from_m, robot_from_tcp)
        np.testing.assert_allclose(found, m_from_tcp[:3, :3], atol=1e-9)


@few_or_all("cases", 500, 1500)
def test_its_covariance_is_the_scatter_of_noisy_points(cases: int) -> None:
    rng = np.random.default_rng(3)
    m_from_tcp, ots_from_r, ots_from_m, robot_from_tcp = scene(3)
    seen = TRIANGLE @ ots_from_r[:3, :3].T + ots_from_r[:3, 3]
    spread = np.diag([0.2, 0.1, 0.4]) ** 2
    both = np.tile(spread, (3, 1, 1))
    turns = []
    for _ in range(cases):
        noisy = [points + rng.normal(size=(3, 3)) * np.sqrt(np.diag(spread)) for points in (seen, TRIANGLE)]
        off = tool_orientation(noisy[0], noisy[1], ots_from_m, robot_from_tcp) @ m_from_tcp[:3, :3].T
        turns.append(Rotation.from_matrix(off).as_rotvec())
    scatter = np.cov(np.array(turns).T)
    stated = orientation_covariance(seen, TRIANGLE, both, both, ots_from_m, robot_from_tcp)
    assert np.abs(stated - scatter).max() < 0.08 * np.trace(scatter)


def test_its_covariance_asks_for_the_frames_and_errors_that_it_needs() -> None:
    """Poses in each other's place gave a covariance of no rotation, and one error for all NumPy's own."""
    _, ots_from_r, ots_from_m, robot_from_tcp = scene(3)
    seen, own = TRIANGLE @ ots_from_r[:3, :3].T + ots_from_r[:3, 3], np.diag([0.04, 0.01, 0.16])
    each = np.tile(own, (3, 1, 1))
    np.testing.assert_array_equal(
        orientation_covariance(seen, TRIANGLE, own, own, ots_from_m, robot_from_tcp),
        orientation_covariance(seen, TRIANGLE, each, each, ots_from_m, robot_from_tcp),
    )
    with pytest.raises(FrameMismatchError):
        orientation_covariance(seen, TRIANGLE, own, own, robot_from_tcp, ots_from_m)
    for wrong, says in ((np.ones(3), "shape"), (np.nan * own, "not finite"), (-own, "not symmetric and positive")):
        with pytest.raises(InputError, match=says):
            orientation_covariance(seen, TRIANGLE, own, wrong, ots_from_m, robot_from_tcp)


def test_pivot_and_orientation_make_a_pose_whose_tip_has_the_pivots_error() -> None:
    poses = np.tile(np.eye(4), (60, 1, 1))
    rng = np.random.default_rng(0)
    poses[:, :3, :3] = Rotation.from_rotvec(rng.normal(size=(60, 3)) * 0.5).as_matrix()
    poses[:, :3, 3] = -poses[:, :3, :3] @ (10.0, 20, 150) + rng.normal(size=(60, 3)) * 0.1
    pivot = calibrate_pivot(poses)
    pose = tool_pose(pivot, np.eye(3), np.diag([1e-6, 2e-6, 3e-6]))
    np.testing.assert_allclose(pose.point_covariances([[0, 0, 0]])[0], pivot.tip_covariance_mm2, atol=1e-12)
    far = pose.point_covariances([[0, 0, 100]])[0] - pivot.tip_covariance_mm2
    np.testing.assert_allclose(np.diag(far), [2e-6 * 1e4, 1e-6 * 1e4, 0], atol=1e-12)
    np.testing.assert_allclose(pose.apply([[0, 0, 0]])[0], pivot.tip_mm)


def hand_eye_poses(seed: int, count: int, sd_rad: float, sd_mm: float) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    truth = np.random.default_rng(99)
    m_from_tcp, robot_from_ots = matrix(truth), matrix(truth, 2000)
    driven = np.array([matrix(truth) for _ in range(count)])
    seen = invert(robot_from_ots) @ driven @ invert(m_from_tcp)
    noise = np.tile(np.eye(4), (count, 1, 1))
    noise[:, :3, :3] = Rotation.from_rotvec(rng.normal(size=(count, 3)) * sd_rad).as_matrix()
    noise[:, :3, 3] = rng.normal(size=(count, 3)) * sd_mm
    return seen @ noise, driven, m_from_tcp, robot_from_ots


def test_hand_eye_of_exact_poses_is_exact() -> None:
    seen, driven, m_from_tcp, robot_from_ots = hand_eye_poses(1, 8, 0.0, 0.0)
    found = calibrate_hand_eye(seen, driven)
    np.testing.assert_allclose(found.m_from_tcp.matrix, m_from_tcp, atol=1e-6)
    np.testing.assert_allclose(found.robot_from_ots.matrix, robot_from_ots, atol=1e-6)


def test_poses_that_are_both_the_other_way_round_are_refused() -> None:
    """They agree as well, and tell where the robot's base is before the tracker in the place of the tool."""
    seen, driven, _, _ = hand_eye_poses(1, 8, 0.0, 0.0)
    with pytest.raises(RefusedError, match=r"the TCP lies [0-9]+ mm from M, .* not both the other way round"):
        calibrate_hand_eye(invert(seen), invert(driven))


@few_and_others("seed", range(1), range(1, 4))
def test_of_poses_alone_nothing_tells_which_are_the_trackers(seed: int) -> None:
    """The equation holds as well with all inverted and exchanged; where only places err, so does all that is told."""
    seen, driven, _, _ = hand_eye_poses(seed, 40, 0.0, 0.2)
    found, exchanged = calibrate_hand_eye(seen, driven), calibrate_hand_eye(driven, seen)
    np.testing.assert_allclose(exchanged.m_from_tcp.matrix, invert(found.m_from_tcp.matrix), atol=0.2)
    np.testing.assert_allclose(exchanged.robot_from_ots.matrix, invert(found.robot_from_ots.matrix), atol=0.5)
    assert exchanged.translation_rms_mm == pytest.approx(found.translation_rms_mm, rel=0.02)
    assert (exchanged.doubts, found.doubts) == ((), ())


@few_or_all("cases", 3, 8)
@few_and_others("memory", [0.9], [0.0])
def test_hand_eye_states_its_own_error_whatever_the_noises_memory(memory: float, cases: int) -> None:
    squares = []
    for seed in range(cases):
        seen, driven, m_from_tcp, robot_from_ots = hand_eye_poses(seed, 60, 0.0, 0.0)
        white = np.random.default_rng(seed).normal(size=(200, 6)) * np.repeat([1e-3, 0.2], 3)
        noise = filtered(np.sqrt(1 - memory**2), [memory], white)[-len(seen) :]
        seen[:, :3, 3] += noise[:, 3:]
        seen[:, :3, :3] = Rotation.from_rotvec(noise[:, :3]).as_matrix() @ seen[:, :3, :3]
        found = calibrate_hand_eye(seen, driven)
        for pose, truth in ((found.m_from_tcp, m_from_tcp), (found.robot_from_ots, robot_from_ots)):
            error = pose.translation_mm - truth[:3, 3]
            squares.append(error @ np.linalg.solve(pose.point_covariances([[0, 0, 0]])[0], error))
    assert 0.6 < np.mean(squares) / 3 < 1.5  # one standard deviation of the mean: 0.2
    assert found.rotation_rms_deg == pytest.approx(np.degrees(1e-3 * np.sqrt(3)), rel=0.3)


@few_and_others("late", [-1, 0], [1])
def test_poses_of_other_moments_are_told(late: int) -> None:
    """Of a robot that moves by 0.9 degrees a pose they put M 20 mm aside, with 0.9 degrees and 1.2 mm left."""
    rng, time = np.random.default_rng(4), np.linspace(0, 1, 202)[:, None]
    driven = np.tile(np.eye(4), (len(time), 1, 1))
    turns = 0.5 * np.hstack([np.sin(9 * time), np.cos(7 * time), 0.3 * np.sin(5 * time)])
    driven[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    driven[:, :3, 3] = 100 * np.hstack([2 * np.sin(5 * time), np.cos(8 * time), np.sin(11 * time)])
    seen = invert(matrix(rng, 2000)) @ driven @ invert(matrix(rng))
    seen[:, :3, :3] = Rotation.from_rotvec(rng.normal(size=(len(time), 3)) * 5e-4).as_matrix() @ seen[:, :3, :3]
    seen[:, :3, 3] += 0.1 * rng.normal(size=(len(time), 3))
    found = calibrate_hand_eye(seen[1 + late : 201 + late], driven[1:201])
    assert found.out_of_step == any("same moments" in doubt for doubt in found.doubts) == bool(late)


def test_poses_that_a_tracker_sends_again_while_the_robot_moves_on_are_left_out() -> None:
    """They were refused as of other moments, or moved M."""
    seen, driven, m_from_tcp, _ = hand_eye_poses(6, 60, 1e-3, 0.2)
    hidden = np.r_[21:30, 45]
    seen[hidden] = seen[hidden // 10 * 10]
    seen[50, :3, 3] += 20.0
    found = calibrate_hand_eye(seen, driven)
    assert (found.repeated, found.far) == (len(hidden), (50,))
    assert "an earlier one to the last digit were left out, 10 in all" in found.doubts[0]
    assert np.linalg.norm(found.m_from_tcp.translation_mm - m_from_tcp[:3, 3]) < 6  # of one pose that is 35 mm off
    assert not calibrate_hand_eye(*hand_eye_poses(6, 60, 1e-3, 0.2)[:2]).doubts


@few_or_all("cases", 2, 6)
def test_hand_eye_with_a_slow_error_in_the_tools_axes_states_its_own_error(cases: int) -> None:
    """It was stated 1.6 times too small: the axes were told apart by likelihoods of unlike numbers of frequencies."""
    rng = np.random.default_rng(8)
    time = np.linspace(0, 12 * np.pi, 100)
    swing = np.column_stack([np.sin(time), 0.6 * np.sin(0.4 * time + 1), np.cos(0.7 * time)])
    driven = np.tile(np.eye(4), (100, 1, 1))
    driven[:, :3, :3] = Rotation.from_rotvec(np.radians(40) * swing).as_matrix()
    driven[:, :3, 3] = 200 * np.column_stack([np.cos(0.6 * time), np.sin(0.8 * time), np.cos(0.35 * time + 1)])
    squares = []
    for _ in range(cases):
        white = rng.normal(size=(300, 6)) * np.repeat([1e-3, 0.2], 3)
        noise = filtered(np.sqrt(1 - 0.9**2), [0.9], white)[-100:]
        seen = driven.copy()
        seen[:, :3, 3] += np.einsum("nij,nj->ni", driven[:, :3, :3], noise[:, 3:])
        seen[:, :3, :3] = driven[:, :3, :3] @ Rotation.from_rotvec(noise[:, :3]).as_matrix()
        found = calibrate_hand_eye(seen, driven).m_from_tcp
        error = np.append(
            Rotation.from_matrix(found.rotation.T).as_rotvec(), -found.rotation.T @ found.translation_mm
        )
        back = found.inverse().covariance
        squares.append(error @ np.linalg.solve(back, error) / 6)
    assert 0.4 < np.mean(squares) < 1.6


@few_or_all("cases", 3, 8)
@few_and_others("in_tool", [True], [False])
def test_hand_eye_under_a_steady_drift_states_its_own_error(in_tool: bool, cases: int) -> None:
    """Of R from OTS it was stated up to a hundred times too large; true is what holds in the recording's middle."""
    squares = []
    time = np.linspace(-1, 1, 100)[:, None]
    for seed in range(200, 200 + cases):
        seen, driven, m_from_tcp, robot_from_ots = hand_eye_poses(seed, 100, 0.0, 0.0)
        rng = np.random.default_rng(seed)
        errors = (rng.normal(size=(100, 6)) + 2 * time * rng.normal(size=6)) * np.repeat([1e-3, 0.2], 3)
        turns, rotations = Rotation.from_rotvec(errors[:, :3]).as_matrix(), seen[:, :3, :3].copy()
        seen[:, :3, 3] += np.einsum("nij,nj->ni", rotations, errors[:, 3:]) if in_tool else errors[:, 3:]
        seen[:, :3, :3] = rotations @ turns if in_tool else turns @ rotations
        found = calibrate_hand_eye(seen, driven)
        for pose, truth in ((found.m_from_tcp, m_from_tcp), (found.robot_from_ots, robot_from_ots)):
            off = truth @ invert(pose.matrix)
            error = np.append(Rotation.from_matrix(off[:3, :3]).as_rotvec(), off[:3, 3])
            squares.append(error @ np.linalg.solve(pose.covariance, error) / 6)
    assert 0.6 < np.mean(squares[::2]) < 1.5  # M from TCP; one standard deviation of the mean: 0.2
    assert 0.6 < np.mean(squares[1::2]) < 1.5  # R from OTS


def test_many_poses_beat_one() -> None:
    """The point of the modern solution: Eq. 5 keeps the error of the one moment it uses."""
    seen, driven, m_from_tcp, robot_from_ots = hand_eye_poses(5, 30, 1e-3, 0.2)
    triangle_ots = (TRIANGLE - robot_from_ots[:3, 3]) @ robot_from_ots[:3, :3]
    one = tool_orientation(triangle_ots, TRIANGLE, Pose.exact(seen[0], OTS, M), Pose.exact(driven[0], R, TCP))

    def off(rotation: np.ndarray) -> float:
        return float(Rotation.from_matrix(rotation @ m_from_tcp[:3, :3].T).magnitude())

    assert off(calibrate_hand_eye(seen, driven).m_from_tcp.rotation) < 0.5 * off(one)


@few_or_all("cases", 3, 10)
def test_hand_eye_of_few_poses_states_its_own_error(cases: int) -> None:
    """Drifts can follow four poses almost anywhere; what is left does not say how well they are known."""
    squares = []
    for seed in range(cases):
        seen, driven, m_from_tcp, _ = hand_eye_poses(seed, 4, 1e-3, 0.2)
        found = calibrate_hand_eye(seen, driven).m_from_tcp
        off = m_from_tcp @ invert(found.matrix)
        error = np.append(Rotation.from_matrix(off[:3, :3]).as_rotvec(), off[:3, 3])
        squares.append(error @ np.linalg.solve(found.covariance, error) / 6)
    assert 0.25 < np.mean(squares) < 1.0  # 0.31: with caution


def test_unusable_calibrations_are_named() -> None:
    seen, driven, *_ = hand_eye_poses(1, 8, 0.0, 0.0)
    with pytest.raises(InputError, match="3 tracker and 8 robot"):
        calibrate_hand_eye(seen[:3], driven)
    with pytest.raises(InputError, match="24 poses were given, of which 3 of the tracker's differ"):
        calibrate_hand_eye(np.tile(seen[:3], (8, 1, 1)), np.tile(driven[:3], (8, 1, 1)))
    with pytest.raises(InputError, match="robot_from_tcp 0 is left-handed"):
        calibrate_hand_eye(seen, driven * np.array([1, 1, -1, 1]))
    turning = np.tile(np.eye(4), (8, 1, 1))
    turning[:, :3, :3] = Rotation.from_rotvec(np.outer(np.arange(8), [0, 0, 0.2])).as_matrix()
    turning[:, 0, 3] = 500.0
    with pytest.raises(InputError, match="about two axes"):
        calibrate_hand_eye(seen, turning)
    with pytest.raises(InputError, match="built on three"):
        frame_of_three(np.eye(3)[:2])
    with pytest.raises(InputError, match="one line"):
        frame_of_three(np.outer([0, 1, 2], [1.0, 1, 1]))
    *_, ots_from_m, robot_from_tcp = scene(0)
    with pytest.raises(FrameMismatchError):
        tool_orientation(TRIANGLE, TRIANGLE, robot_from_tcp, ots_from_m)


def test_eq_5_departs_from_a_rotation_by_what_that_is_wrong() -> None:
    rng = np.random.default_rng(3)
    m_from_tcp, robot_from_ots = np.eye(4), np.eye(4)
    m_from_tcp[:3, :3], m_from_tcp[:3, 3] = Rotation.random(rng=rng).as_matrix(), (20.0, -40.0, 150.0)
    robot_from_ots[:3, :3], robot_from_ots[:3, 3] = Rotation.random(rng=rng).as_matrix(), (300.0, 900.0, -50.0)
    driven = np.tile(np.eye(4), (12, 1, 1))
    driven[:, :3, :3], driven[:, :3, 3] = Rotation.random(12, rng=rng).as_matrix(), rng.uniform(-90, 90, (12, 3))
    seen = np.linalg.inv(robot_from_ots) @ driven @ np.linalg.inv(m_from_tcp)
    right, tip = m_from_tcp[:3, :3], m_from_tcp[:3, 3]
    assert departure_of_eq_5_deg(seen, driven, tip, right) == pytest.approx(0.0, abs=1e-5)
    turned = Rotation.from_rotvec([0.0, np.radians(1.5), 0.0]).as_matrix() @ right
    assert departure_of_eq_5_deg(seen, driven, tip, turned) == pytest.approx(1.5, abs=1e-5)
    driven[:, 1:3, 3] = 0.0
    with pytest.raises(InputError, match="TEMP"):
        departure_of_eq_5_deg(seen, driven, tip, right)
