"""Spheres that the cameras found from poses of the robot, with the errors that each has for itself and in common."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ronnaplan.geometry import FloatArray, Points
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import R
from ronnaplan.transforms import point_jacobian, transform_points


@dataclass(frozen=True, eq=False)
class RobotMarkers:
    """Spheres (N) re-localized one after the other from robot poses (N), in the rig's coordinates at each."""

    labels: tuple[str, ...]
    in_rig_mm: FloatArray
    """(N, 3)."""
    own_mm2: FloatArray
    """Covariances (N, 3, 3) in R of the errors that each look has for itself: outlines, cameras, robot."""
    robot_from_tcp: FloatArray
    """(N, 4, 4)."""
    tcp_from_rig: Pose
    """Its error is common to all."""

    @property
    def positions_mm(self) -> FloatArray:
        """The spheres (N, 3) in R."""
        chained = self.robot_from_tcp @ self.tcp_from_rig.matrix
        return transform_points(chained, self.in_rig_mm[:, None])[:, 0]

    @property
    def common_jacobian(self) -> FloatArray:
        """What the error (6) of ``tcp_from_rig`` does to each sphere in R: (N, 3, 6)."""
        in_tcp = transform_points(self.tcp_from_rig.matrix, self.in_rig_mm)
        jacobian: FloatArray = self.robot_from_tcp[:, :3, :3] @ point_jacobian(in_tcp)
        return jacobian

    @property
    def points(self) -> Points:
        """The spheres in R, each with its whole error; those errors are not independent of each other."""
        jacobian = self.common_jacobian
        common = jacobian @ self.tcp_from_rig.covariance @ jacobian.transpose(0, 2, 1)
        return Points(self.positions_mm, self.own_mm2 + common, self.labels, R)

    def taken_from(self, robot_from_tcp: FloatArray) -> RobotMarkers:
        """Return the same looks from other poses (N, 4, 4) of the robot, their own errors turned with these."""
        turns = robot_from_tcp[:, :3, :3] @ self.robot_from_tcp[:, :3, :3].transpose(0, 2, 1)
        own = turns @ self.own_mm2 @ turns.transpose(0, 2, 1)
        return replace(self, robot_from_tcp=robot_from_tcp, own_mm2=own)

    def only(self, numbers: list[int]) -> RobotMarkers:
        """Return the looks of these ``numbers``."""
        return replace(
            self,
            labels=tuple(self.labels[n] for n in numbers),
            in_rig_mm=self.in_rig_mm[numbers],
            own_mm2=self.own_mm2[numbers],
            robot_from_tcp=self.robot_from_tcp[numbers],
        )
