"""A pose with its covariance for ROS, as YAML with the fields of ``geometry_msgs/PoseWithCovarianceStamped``.

ROS has metres, quaternions (x, y, z, w) and a covariance of (x, y, z, rotations about the parent's axes), where x, y, z
are of the child's origin. Ours is of (rotation, translation) about the parent's origin: the two differ by the lever
between.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import Pose

MM = 1e-3
"""In metres."""


def ros_transform(document: RegistrationDocument) -> str:
    """Return the registration as the pose of the frame ``ct`` in the frame ``ots``."""
    return pose_yaml(document.pose, parent="ots", child="ct")


def pose_yaml(pose: Pose, *, parent: str, child: str) -> str:
    """Return the pose of ``child`` in ``parent`` as YAML; the pose maps points of the child into the parent."""
    from scipy.spatial.transform import Rotation

    place = dict(zip("xyz", map(yaml_number, MM * pose.matrix[:3, 3]), strict=True))
    turn = dict(zip("xyzw", map(yaml_number, Rotation.from_matrix(pose.matrix[:3, :3]).as_quat()), strict=True))
    rows = [", ".join(f"{value:.9e}" for value in row) for row in ros_covariance(pose)]
    return "\n".join(
        [
            "# geometry_msgs/PoseWithCovarianceStamped: metres, quaternion, covariance of (x, y, z, rotation)",
            "header:",
            f"  frame_id: {parent}",
            f"child_frame_id: {child}",
            "pose:",
            "  pose:",
            "    position: {" + ", ".join(f"{axis}: {value}" for axis, value in place.items()) + "}",
            "    orientation: {" + ", ".join(f"{axis}: {value}" for axis, value in turn.items()) + "}",
            "  covariance: [",
            ",\n".join(f"    {row}" for row in rows) + "]",
            "",
        ]
    )


def yaml_number(value: float) -> str:
    """Return a number of metres, or of a quaternion, with a point: YAML 1.1, which ROS reads, takes 1e-05 for text.

    >>> yaml_number(1e-05)
    '0.000010000000'
    """
    return f"{value:.12f}"


def ros_covariance(pose: Pose) -> FloatArray:
    """Return the covariance (6, 6) of the child's origin (m) and of its rotation about the parent's axes (rad)."""
    x, y, z = pose.matrix[:3, 3]
    lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    mapped = np.block([[-MM * lever, MM * np.eye(3)], [np.eye(3), np.zeros((3, 3))]])
    return np.asarray(mapped @ pose.covariance @ mapped.T, dtype=np.float64)
