"""What errors of joints, links and tool calibration make of the tool's pose, to first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.geometry import Frame
from ronnaplan.pose import Pose
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import as_angles, link_frames
from ronnaplan.robot.chain import R
from ronnaplan.transforms import adjoint

FLANGE = Frame("FLANGE")


@dataclass(frozen=True, kw_only=True)
class ArmErrors:
    """Standard deviations, each independent of the others.

    ``joint_deg`` of each joint's reading; ``link_deg`` and ``link_mm`` per axis of where each joint truly sits on the
    link before it (what a calibration of the arm leaves); zero is taken as known.
    """

    joint_deg: float = 0.0
    link_deg: float = 0.0
    link_mm: float = 0.0


def reached(arm: SerialArm, angles_rad: ArrayLike, errors: ArmErrors, tool: Pose | None = None) -> Pose:
    """Return R from the flange, or from ``tool``'s own frame, at ``angles_rad`` (N,) with its covariance.

    ``tool`` is a pose from a tool's frame to `FLANGE` (`FrameMismatchError` otherwise); its covariance is added.
    """
    angles = as_angles(arm, angles_rad)
    frames = link_frames(arm, angles)
    links = np.diag(np.repeat([np.radians(errors.link_deg) ** 2, errors.link_mm**2], 3))
    covariance = np.zeros((6, 6))
    for moved, axis in zip(frames[1:], arm.axes, strict=True):
        turned = moved[:3, :3] @ axis
        twist = np.concatenate([turned, np.cross(moved[:3, 3], turned)])
        covariance += np.radians(errors.joint_deg) ** 2 * np.outer(twist, twist)
    for n, origin in enumerate(arm.origins):
        carried = adjoint(frames[n] @ origin)
        covariance += carried @ links @ carried.T
    flange = Pose(frames[-1] @ arm.flange, covariance, R, FLANGE)
    return flange if tool is None else flange @ tool
