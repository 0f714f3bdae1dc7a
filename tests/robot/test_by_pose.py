"""Errors that depend on the robot's pose: joints whose zeros are off."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.pose import Pose, invert
from ronnaplan.robot.hand_eye import calibrate_hand_eye
from tests.robot.test_orientation import matrix

HOME = np.radians([10, -100, 110, -100, -90, 20])
RANGE = np.radians([20, 12, 15, 25, 30, 50])
LINKS = ((180.7, 0, 90), (0, -612.7, 0), (0, -571.55, 0), (174.15, 0, 90), (119.85, 0, -90), (116.55, 0, 0))
"""Offset and length in mm, twist in degrees: an arm like a UR10e."""


def flange(joints: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    for angle, (offset, length, twist) in zip(joints, LINKS, strict=True):
        link = np.eye(4)
        turn = Rotation.from_rotvec([0, 0, angle]).as_matrix()
        link[:3, :3] = turn @ Rotation.from_rotvec([np.radians(twist), 0, 0]).as_matrix()
        link[:3, 3] = turn @ (length, 0, 0) + (0, 0, offset)
        pose = pose @ link
    return pose


def normalized(found: Pose, truth: np.ndarray) -> float:
    off = truth @ invert(found.matrix)
    error = np.append(Rotation.from_matrix(off[:3, :3]).as_rotvec(), off[:3, 3])
    return float(error @ np.linalg.solve(found.covariance, error)) / 6


@pytest.mark.parametrize("off_deg", [0.0, 0.2])
def test_joints_whose_zeros_are_off_are_told_and_counted(off_deg: float) -> None:
    """M had a normalized error of 16 and R of 50, with nothing but a larger RMS to tell."""
    of_tool, of_base, told = [], [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        joints = HOME + rng.uniform(-1, 1, (40, 6)) * RANGE
        tool, m_from_tcp, robot_from_ots = (matrix(rng, reach) for reach in (100, 100, 1000))
        off = rng.choice([-1, 1], 6) * np.radians(off_deg)
        driven, true = (np.array([flange(one) @ tool for one in angles]) for angles in (joints, joints + off))
        seen = invert(robot_from_ots) @ true @ invert(m_from_tcp)
        turns = Rotation.from_rotvec(rng.normal(size=(40, 3)) * np.radians(0.06)).as_matrix()
        seen[:, :3, :3] = turns @ seen[:, :3, :3]
        seen[:, :3, 3] += 0.25 * rng.normal(size=(40, 3))
        found = calibrate_hand_eye(seen, driven)
        of_tool.append(normalized(found.m_from_tcp, m_from_tcp))
        of_base.append(normalized(found.robot_from_ots, robot_from_ots))
        told.append(any("depend on the robot's pose" in doubt for doubt in found.doubts))
    assert told == [off_deg > 0] * 4
    assert np.mean(of_tool) < 5
    assert np.mean(of_base) < 1.5
