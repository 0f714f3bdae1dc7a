"""A pose for ROS is the pose, and its covariance that of simulated poses."""

from __future__ import annotations

import re

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from ronnaplan.documents.ros import pose_yaml, ros_covariance
from ronnaplan.geometry import Frame
from ronnaplan.pose import Pose


def a_pose() -> Pose:
    rng = np.random.default_rng(5)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(rng=rng).as_matrix()
    matrix[:3, 3] = [200.0, -50.0, -1500.0]
    spread = rng.normal(size=(6, 6)) * np.repeat([1e-4, 0.05], 3)[:, None]
    return Pose(matrix, spread @ spread.T, Frame("OTS"), Frame("CT"))


def test_the_covariance_is_the_scatter_of_origin_and_rotation() -> None:
    pose = a_pose()
    xi = np.random.default_rng(6).multivariate_normal(np.zeros(6), pose.covariance, 40_000)
    drawn = RigidTransform.from_exp_coords(xi).as_matrix() @ pose.matrix
    places_m = drawn[:, :3, 3] / 1000
    turns = (Rotation.from_matrix(drawn[:, :3, :3]) * Rotation.from_matrix(pose.matrix[:3, :3]).inv()).as_rotvec()
    scatter = np.cov(np.hstack([places_m, turns]).T)
    scale = np.sqrt(np.diag(scatter))
    np.testing.assert_allclose(
        ros_covariance(pose) / np.outer(scale, scale), scatter / np.outer(scale, scale), atol=0.04
    )


def test_the_text_holds_the_pose_in_metres_and_a_unit_quaternion() -> None:
    import yaml

    pose = a_pose()
    read = yaml.safe_load(re.sub(r"e([+-]\d+)", r"e\1", pose_yaml(pose, parent="ots", child="ct")))
    assert (read["header"]["frame_id"], read["child_frame_id"]) == ("ots", "ct")
    inner = read["pose"]["pose"]
    np.testing.assert_allclose([inner["position"][axis] for axis in "xyz"], [0.2, -0.05, -1.5])
    turned = Rotation.from_quat([inner["orientation"][axis] for axis in "xyzw"]).as_matrix()
    np.testing.assert_allclose(turned, pose.matrix[:3, :3], atol=1e-12)
    np.testing.assert_allclose(
        np.array(read["pose"]["covariance"], dtype=float).reshape(6, 6), ros_covariance(pose), rtol=1e-8
    )


def test_numbers_without_a_point_are_not_taken_for_text() -> None:
    """ROS reads YAML 1.1, where 1e-05 is a text and 1.0e-05 a number."""
    import yaml

    matrix = np.eye(4)
    matrix[:3, 3] = [0.01, 0.0, -2000.0]
    pose = Pose(matrix, np.eye(6), Frame("OTS"), Frame("CT"))
    inner = yaml.safe_load(pose_yaml(pose, parent="ots", child="ct"))["pose"]["pose"]
    assert inner["position"] == {"x": 1e-5, "y": 0.0, "z": -2.0}
    assert all(isinstance(number, float) for group in inner.values() for number in group.values())
