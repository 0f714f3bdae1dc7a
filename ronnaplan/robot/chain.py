"""The coordinate chain from the tracker to the robot: Eq. 4, 6 and 7, with frames checked and errors carried.

Frames: ``OTS`` the tracker, ``M`` the reference frame on the robot's tool, ``TCP`` the tool center point,
``R`` the robot base. ``a_from_b`` maps coordinates of B into A; the papers' T_A_B.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import Frame, Points
from ronnaplan.pose import Pose
from ronnaplan.transforms import invert

OTS, M, TCP, R = Frame("OTS"), Frame("M"), Frame("TCP"), Frame("R")


@dataclass(frozen=True)
class Capture:
    """One moment: the tracker's view of M, the calibrated tool, and the robot's own TCP pose at that moment.

    Raises `FrameMismatchError` when a pose joins other frames than its place in the chain needs.
    """

    ots_from_m: Pose
    m_from_tcp: Pose
    robot_from_tcp: Pose

    def __post_init__(self) -> None:
        for pose, to_frame, from_frame in (
            (self.ots_from_m, OTS, M),
            (self.m_from_tcp, M, TCP),
            (self.robot_from_tcp, R, TCP),
        ):
            to_frame.require(pose.to_frame)
            from_frame.require(pose.from_frame)

    @property
    def ots_from_tcp(self) -> Pose:
        """Eq. 4: ``ots_from_m @ m_from_tcp``."""
        return self.ots_from_m @ self.m_from_tcp

    @property
    def tcp_from_ots(self) -> Pose:
        """The inverse used in Eq. 6."""
        return self.ots_from_tcp.inverse()

    @property
    def robot_from_ots(self) -> Pose:
        """Eq. 7 after Eq. 6: ``robot_from_tcp @ ots_from_tcp^-1``."""
        return self.robot_from_tcp @ self.tcp_from_ots

    def moved_since(self, robot_from_ots: Pose) -> tuple[float, float]:
        """Return how far (mm, at the TCP, and degrees) the tracker stands from where ``robot_from_ots`` had it."""
        from scipy.spatial.transform import Rotation

        motion = self.robot_from_ots.matrix @ invert(robot_from_ots.matrix)
        place = self.robot_from_tcp.translation_mm
        shift_mm = float(np.linalg.norm(motion[:3, :3] @ place + motion[:3, 3] - place))
        return shift_mm, float(np.degrees(Rotation.from_matrix(motion[:3, :3]).magnitude()))


def to_frame(pose: Pose, points: Points) -> Points:
    """Return ``points`` mapped by ``pose``, with the pose's error added to their own.

    The pose's error is common to all points, so their covariances are each right but not independent of each
    other. Raises `FrameMismatchError` for points of another frame.
    """
    check_type(pose, Pose, "what maps the points", "make it with Pose(matrix, covariance, to_frame, from_frame)")
    check_type(points, Points, "the points", "a result has them as its points: found.points")
    positions = pose.apply(points.positions_mm, points.frame)
    covariances = pose.point_covariances(points.positions_mm, points.covariances_mm2)
    return Points(positions, covariances, points.labels, pose.to_frame)


def robot_from_ct(ots_from_ct: Pose, capture: Capture) -> Pose:
    """Return Eq. 3's transform by way of the tracker: ``robot_from_ots @ ots_from_ct``, with all errors carried.

    Raises `InputError` when ``ots_from_ct`` does not start in a CT frame, `FrameMismatchError` when it does
    not end in the tracker's.
    """
    check_type(ots_from_ct, Pose, "OTS from CT", "a registration has one as its pose: registration.pose")
    check_type(capture, Capture, "the moment", "make it with Capture(ots_from_m, m_from_tcp, robot_from_tcp)")
    if ots_from_ct.from_frame.name != "CT":
        raise InputError(f"a registration from {ots_from_ct.from_frame} was offered; expected one from CT")
    return capture.robot_from_ots @ ots_from_ct
