"""Orientation of the robot's TCP in the tool's reference frame M by Eq. 5, from three points known to both."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray, as_covariances, as_points, unit
from ronnaplan.pose import Pose, first_told
from ronnaplan.rigid import require_spread
from ronnaplan.robot.chain import OTS, TCP, M, R
from ronnaplan.robot.pivot import PivotCalibration
from ronnaplan.transforms import about, transform_points


def frame_of_three(points_mm: ArrayLike) -> FloatArray:
    """Return the rotation (3, 3) of the frame TEMP built on three points (3, 3).

    Its x axis points from the first to the second point, its z axis off their plane.
    Raises `InputError` for another number of points or collinear ones.
    """
    points = as_points(points_mm, "the three points of TEMP")
    if len(points) != 3:
        raise InputError(f"{len(points)} points were given; the frame TEMP is built on three")
    require_spread(points, "points of TEMP")
    x = unit(points[1] - points[0])
    z = unit(np.cross(x, points[2] - points[0]))
    return np.column_stack([x, np.cross(z, x), z])


def tool_orientation(ots_mm: ArrayLike, robot_mm: ArrayLike, ots_from_m: Pose, robot_from_tcp: Pose) -> FloatArray:
    """Return the rotation (3, 3) of M from TCP by Eq. 5.

    ``ots_mm`` and ``robot_mm`` (3, 3) are the same three points that the TCP visited, in the tracker's and in the
    robot's coordinates; the two poses belong to one moment. Raises `FrameMismatchError` for poses of other frames, and
    what `frame_of_three` does.
    """
    _require_frames(ots_from_m, robot_from_tcp)
    temp_from_m = frame_of_three(ots_mm).T @ ots_from_m.rotation
    temp_from_tcp = frame_of_three(robot_mm).T @ robot_from_tcp.rotation
    return temp_from_m.T @ temp_from_tcp


def departure_of_eq_5_deg(
    ots_from_m: FloatArray, robot_from_tcp: FloatArray, tip_mm: FloatArray, found: FloatArray
) -> float:
    """Return by how much (degrees) Eq. 5 turns the TCP otherwise than ``found`` (3, 3), the rotation of M from TCP.

    Of poses of one recording (N, 4, 4), TEMP is built on the tip (3,), in M, at three that lie widely apart; Eq. 5 then
    gives a rotation of each pose, whose mean counts, of those that the tracker repeats of the first alone. Raises
    `InputError` where all tips are on a line.
    """
    from scipy.spatial.transform import Rotation

    told, _ = first_told(ots_from_m)
    ots_from_m, robot_from_tcp = ots_from_m[told], robot_from_tcp[told]
    ots, robot = transform_points(ots_from_m, tip_mm[None])[:, 0], robot_from_tcp[:, :3, 3]
    first = int(np.linalg.norm(robot - robot.mean(axis=0), axis=1).argmax())
    second = int(np.linalg.norm(robot - robot[first], axis=1).argmax())
    away = np.linalg.norm(np.cross(robot - robot[first], robot[second] - robot[first]), axis=1)
    three = [first, second, int(away.argmax())]
    rotations = [
        tool_orientation(ots[three], robot[three], Pose.exact(seen, OTS, M), Pose.exact(driven, R, TCP))
        for seen, driven in zip(ots_from_m, robot_from_tcp, strict=True)
    ]
    mean = Rotation.from_matrix(rotations).mean()
    return float(np.degrees((mean * Rotation.from_matrix(found).inv()).magnitude()))


def orientation_covariance(
    ots_mm: ArrayLike,
    robot_mm: ArrayLike,
    ots_mm2: ArrayLike,
    robot_mm2: ArrayLike,
    ots_from_m: Pose,
    robot_from_tcp: Pose,
) -> FloatArray:
    """Return the covariance (3, 3), in rad^2 and M's axes, of `tool_orientation`'s rotation, to first order.

    ``ots_mm2`` and ``robot_mm2`` (3, 3, 3), or (3, 3) for all three, are the points' covariances; the two poses add
    their own. Raises `FrameMismatchError` for poses of other frames, `InputError` for what is no covariance.
    """
    _require_frames(ots_from_m, robot_from_tcp)
    ots, robot = as_points(ots_mm), as_points(robot_mm)
    to_m = ots_from_m.rotation.T
    ots_from_robot = frame_of_three(ots) @ frame_of_three(robot).T
    seen = _frame_covariance(ots, as_covariances(ots_mm2, 3, "ots_mm2")) + ots_from_m.covariance[:3, :3]
    driven = (
        _frame_covariance(robot, as_covariances(robot_mm2, 3, "robot_mm2")) + robot_from_tcp.covariance[:3, :3]
    )
    return to_m @ (seen + ots_from_robot @ driven @ ots_from_robot.T) @ to_m.T


def tool_pose(pivot: PivotCalibration, rotation: FloatArray, rotation_rad2: FloatArray) -> Pose:
    """Return M from TCP: a pivot calibration's tip and a rotation (3, 3) with its covariance (3, 3) in M."""
    check_type(pivot, PivotCalibration, "the pivot calibration", "calibrate_pivot returns one")
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, pivot.tip_mm
    # The rotation turns about the tip, so about M's origin it also moves the tip back.
    lever = np.zeros((6, 6))
    lever[:3, :3] = rotation_rad2
    carry = about(-pivot.tip_mm)
    lever = carry @ lever @ carry.T
    lever[3:, 3:] += pivot.tip_covariance_mm2
    return Pose(matrix, lever, M, TCP)


def _require_frames(ots_from_m: Pose, robot_from_tcp: Pose) -> None:
    for pose, what in ((ots_from_m, "OTS from M"), (robot_from_tcp, "R from TCP")):
        check_type(pose, Pose, what, "make it with Pose(matrix, covariance, to_frame, from_frame)")
    OTS.require(ots_from_m.to_frame)
    M.require(ots_from_m.from_frame)
    R.require(robot_from_tcp.to_frame)
    TCP.require(robot_from_tcp.from_frame)


def _frame_covariance(points_mm: FloatArray, covariances_mm2: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) of TEMP's rotation vector, by central differences over the points."""
    frame = frame_of_three(points_mm)
    step = 1e-4 * float(np.linalg.norm(points_mm[1] - points_mm[0]))
    jacobian = np.zeros((3, 3, 3))
    for i in range(3):
        for axis in range(3):
            moved = np.zeros((3, 3))
            moved[i, axis] = step
            turn = (frame_of_three(points_mm + moved) - frame_of_three(points_mm - moved)) @ frame.T / (2 * step)
            jacobian[i, :, axis] = turn[2, 1], turn[0, 2], turn[1, 0]
    spread: FloatArray = np.einsum("iab,ibc,idc->ad", jacobian, covariances_mm2, jacobian)
    return spread
