"""Eq. 4, 6 and 7: where a marker lies in the robot's frame, and with what error."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame, Points
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import OTS, TCP, Capture, M, R, robot_from_ct, to_frame
from ronnaplan.robot.trajectories import robot_trajectory, roll_doubts

CT = Frame("CT", "1.2.3")


def pose(rng: np.random.Generator, to: Frame, origin: Frame, sd_rad: float = 2e-4, sd_mm: float = 0.1) -> Pose:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(rng=rng).as_matrix()
    matrix[:3, 3] = rng.normal(size=3) * 300
    return Pose(matrix, np.diag(np.repeat([sd_rad**2, sd_mm**2], 3)), to, origin)


def samples(rng: np.random.Generator, mean: Pose, count: int) -> np.ndarray:
    xi = rng.multivariate_normal(np.zeros(6), mean.covariance, count)
    return RigidTransform.from_exp_coords(xi).as_matrix() @ mean.matrix


def capture(rng: np.random.Generator) -> Capture:
    return Capture(pose(rng, OTS, M), pose(rng, M, TCP), pose(rng, R, TCP, 1e-4, 0.05))


def test_the_chain_is_the_papers_equations_step_by_step() -> None:
    rng = np.random.default_rng(1)
    moment = capture(rng)
    y_ots = np.array([10.0, -20, -1500, 1])
    eq4 = moment.ots_from_m.matrix @ moment.m_from_tcp.matrix
    eq6 = np.linalg.inv(eq4) @ y_ots
    eq7 = moment.robot_from_tcp.matrix @ eq6
    np.testing.assert_allclose(moment.robot_from_ots.apply(y_ots[None, :3])[0], eq7[:3], atol=1e-9)


def test_the_error_in_the_robots_frame_is_the_scatter_of_simulated_chains() -> None:
    rng = np.random.default_rng(2)
    moment = capture(rng)
    own = np.diag([0.04, 0.01, 0.09])
    marker = Points(np.array([[100.0, 50, -200]]), own[None], ("1",), OTS)
    found = to_frame(moment.robot_from_ots, marker)
    count = 20000
    ots_from_tcp = samples(rng, moment.ots_from_m, count) @ samples(rng, moment.m_from_tcp, count)
    chain = samples(rng, moment.robot_from_tcp, count) @ np.linalg.inv(ots_from_tcp)
    noisy = np.append(
        marker.positions_mm[0] + rng.multivariate_normal(np.zeros(3), own, count), np.ones((count, 1)), 1
    )
    image = np.einsum("nij,nj->ni", chain, noisy)[:, :3]
    np.testing.assert_allclose(found.positions_mm[0], image.mean(axis=0), atol=0.02)
    scatter = np.cov(image.T)
    assert np.abs(found.covariances_mm2[0] - scatter).max() < 0.05 * np.trace(scatter)
    assert found.frame == R


def test_poses_of_other_frames_are_refused() -> None:
    rng = np.random.default_rng(3)
    with pytest.raises(FrameMismatchError):
        Capture(pose(rng, OTS, TCP), pose(rng, M, TCP), pose(rng, R, TCP))
    moment = capture(rng)
    with pytest.raises(FrameMismatchError):
        to_frame(moment.robot_from_ots, Points(np.zeros((1, 3)), np.zeros((1, 3, 3)), ("1",), CT))
    with pytest.raises(InputError, match="expected one from CT"):
        robot_from_ct(pose(rng, OTS, M), moment)


def test_a_trajectory_keeps_its_length_and_the_tool_advances_along_it() -> None:
    rng = np.random.default_rng(4)
    chain = robot_from_ct(pose(rng, OTS, CT), capture(rng))
    entry, target = np.array([40.0, 30, 90]), np.array([10.0, 5, 20])
    found = robot_trajectory("left", entry, target, chain, frame=CT)
    assert found.depth_mm == pytest.approx(np.linalg.norm(target - entry))
    np.testing.assert_allclose(found.entry_mm, chain.apply([entry])[0])
    tip_after = found.at_entry @ np.array([0, 0, found.depth_mm, 1])
    np.testing.assert_allclose(tip_after[:3], found.target_mm, atol=1e-9)
    axes = found.at_target[:3, :3]
    np.testing.assert_allclose(axes, Rotation.from_matrix(axes).as_matrix(), atol=1e-12)
    outside = found.before_entry(50.0)
    assert np.linalg.norm(outside[:3, 3] - found.target_mm) == pytest.approx(found.depth_mm + 50)
    np.testing.assert_allclose(found.covariances_mm2, chain.point_covariances([entry, target]))
    assert 0 < found.lateral_sd_mm <= np.sqrt(np.linalg.eigvalsh(found.covariances_mm2[1])[-1])


def test_trajectories_whose_rolls_differ_by_far_more_than_they_do_are_named() -> None:
    """Tools on two trajectories 10 degrees apart, with the x axis asked amid them, lie half a turn apart."""
    exact = Pose(np.eye(4), 1e-9 * np.eye(6), R, CT)
    ends = {"left": (100.0, 9.0, 0.0), "right": (-100.0, 9.0, 0.0), "across": (0.0, 90.0, 90.0)}
    found = [robot_trajectory(name, end, (0.0, 0.0, 0.0), exact, frame=CT) for name, end in ends.items()]
    beside = robot_trajectory("beside", (100.0, -9.0, 0.0), (0.0, 0.0, 0.0), exact, frame=CT)
    turned = Rotation.from_matrix(found[0].at_entry[:3, :3].T @ beside.at_entry[:3, :3])
    assert np.degrees(turned.magnitude()) > 160
    (told,) = roll_doubts(found, (2.0, 0, 0))
    assert "within 20 degrees of left, right: rolls" in told
    assert roll_doubts(found, (0, 0, 1.0)) == ()


def test_a_trajectory_of_another_scan_or_without_direction_is_refused() -> None:
    rng = np.random.default_rng(5)
    chain = robot_from_ct(pose(rng, OTS, CT), capture(rng))
    with pytest.raises(FrameMismatchError):
        robot_trajectory("left", [0, 0, 0], [0, 0, 9], chain, frame=Frame("CT", "9.9"))
    with pytest.raises(InputError, match=r"0\.00 mm apart"):
        robot_trajectory("left", [1, 2, 3], [1, 2, 3], chain, frame=CT)
    along = chain.rotation @ np.array([0.0, 0, 1])
    with pytest.raises(InputError, match="along the trajectory"):
        robot_trajectory("left", [0, 0, 0], [0, 0, 9], chain, frame=CT, x_axis=along)
    for axis, says in (((0, 1), r"shape \(2,\)"), ("x", "not numbers"), ((0, 0, 0), "no direction")):
        with pytest.raises(InputError, match=says):
            robot_trajectory("left", [0, 0, 0], [0, 0, 9], chain, frame=CT, x_axis=axis)
    for entry in ("here", [[1, 2, 3]], [0, 0]):
        with pytest.raises(InputError, match="left are not numbers"):
            robot_trajectory("left", entry, [0, 0, 9], chain, frame=CT)
