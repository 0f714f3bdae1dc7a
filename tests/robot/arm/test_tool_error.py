"""What errors of joints, links and calibration make of the tool's pose, against sampling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from ronnaplan.errors import FrameMismatchError
from ronnaplan.geometry import Frame
from ronnaplan.pose import Pose
from ronnaplan.robot.arm.forward import forward
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.arm.tool_error import FLANGE, ArmErrors, reached
from ronnaplan.robot.chain import TCP, R
from ronnaplan.transforms import rigid
from tests.long import few_and_others

ANGLES = np.radians([20.0, -70, 95, 40, 50, -30])


@few_and_others("errors", [ArmErrors(joint_deg=0.02)], [ArmErrors(joint_deg=0.005, link_deg=0.01, link_mm=0.1)])
def test_errors_come_out_at_the_tip_as_sampling_says(errors: ArmErrors) -> None:
    arm, rng, count = kr6_r900(), np.random.default_rng(1), 800
    tool = Pose(rigid(np.eye(3), np.array([0.0, 40, 250])), np.diag([1e-8] * 3 + [0.01] * 3), FLANGE, TCP)
    stated = reached(arm, ANGLES, errors, tool)
    assert (stated.to_frame, stated.from_frame) == (R, TCP)
    np.testing.assert_allclose(stated.matrix, forward(arm, ANGLES) @ tool.matrix, atol=1e-9)
    tips = np.empty((count, 3))
    scale = np.repeat([np.radians(errors.link_deg), errors.link_mm], 3)
    for n in range(count):
        moved = RigidTransform.from_exp_coords(rng.normal(size=(6, 6)) * scale).as_matrix()
        true = replace(arm, origins=arm.origins @ moved)
        angles = ANGLES + np.radians(errors.joint_deg) * rng.normal(size=6)
        slipped = RigidTransform.from_exp_coords(rng.multivariate_normal(np.zeros(6), tool.covariance)).as_matrix()
        tips[n] = (forward(true, angles) @ slipped @ tool.matrix)[:3, 3]
    predicted = stated.point_covariances(np.zeros((1, 3)))[0]
    ratio = np.linalg.eigvals(np.linalg.solve(predicted, np.cov(tips.T))).real
    assert (np.abs(ratio - 1) < 0.2).all()


def test_a_tool_of_another_frame_is_refused() -> None:
    with pytest.raises(FrameMismatchError, match="FLANGE"):
        reached(kr6_r900(), ANGLES, ArmErrors(), Pose.exact(np.eye(4), Frame("M"), TCP))
