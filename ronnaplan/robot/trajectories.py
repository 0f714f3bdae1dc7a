"""Planned trajectories in the robot's coordinates, as poses for a tool that advances along its own +z axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray, Frame, as_numbers, as_points, rms_mm, unit
from ronnaplan.planning.trajectory import SHORTEST_PATH_MM
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import R
from ronnaplan.text import listed
from ronnaplan.transforms import about, rigid

NEARLY_ALONG_DEG = 20.0
"""A tool's roll whose x axis is asked so near to its trajectory turns three times as far as trajectories differ."""
ALONG = 1e-3
"""An x axis whose sine to the trajectory is less has no direction across it."""


@dataclass(frozen=True, eq=False)
class RobotTrajectory:
    """One trajectory in R. The tool frame has its origin at the tip and its +z axis from entry to target."""

    name: str
    entry_mm: FloatArray
    target_mm: FloatArray
    tip_covariances: FloatArray
    """Covariances (2, 6, 6) of the tool at entry and target: rotation in rad and the tip's place in mm, in R's axes,
    as the chain's errors make them of an exact plan. The rotation turns about the tip."""
    at_entry: FloatArray
    """R from tool (4, 4) with the tip at the entry."""
    at_target: FloatArray
    """R from tool (4, 4) with the tip at the target."""

    @property
    def covariances_mm2(self) -> FloatArray:
        """Covariances (2, 3, 3) in R of entry and target."""
        return self.tip_covariances[:, 3:, 3:]

    @property
    def expected_errors_mm(self) -> FloatArray:
        """Expected root-mean-square errors (2,) at entry and target."""
        return rms_mm(self.covariances_mm2)

    @property
    def depth_mm(self) -> float:
        """Distance from entry to target."""
        return float(np.linalg.norm(self.target_mm - self.entry_mm))

    @property
    def direction(self) -> FloatArray:
        """Unit vector (3,) from entry to target, in R."""
        return self.at_target[:3, 2]

    @property
    def lateral_sd_mm(self) -> float:
        """Standard deviation at the target across the trajectory, in the worst direction."""
        across = self.at_target[:3, :2]
        return float(np.sqrt(np.linalg.eigvalsh(across.T @ self.covariances_mm2[1] @ across)[-1]))

    def before_entry(self, distance_mm: float) -> FloatArray:
        """Return R from tool (4, 4) with the tip ``distance_mm`` outside the entry, on the trajectory's line."""
        pose = self.at_entry.copy()
        pose[:3, 3] -= distance_mm * self.direction
        return pose


def robot_trajectory(
    name: str,
    entry_mm: ArrayLike,
    target_mm: ArrayLike,
    robot_from_ct: Pose,
    *,
    frame: Frame,
    x_axis: ArrayLike = (1.0, 0.0, 0.0),
) -> RobotTrajectory:
    """Return the trajectory from ``entry_mm`` to ``target_mm`` (3,), given in the CT ``frame``, in the robot's R.

    ``x_axis`` is the direction in R that the tool's x axis keeps as close to as the trajectory allows; it settles
    the roll about the tool's own axis. Raises `FrameMismatchError` for a plan of another scan than
    ``robot_from_ct`` and `InputError` for an entry on its target or an ``x_axis`` along the trajectory.
    """
    check_type(robot_from_ct, Pose, "R from CT", "robot_from_ct returns it")
    R.require(robot_from_ct.to_frame)
    both: Any = [entry_mm, target_mm]
    ends = as_points(both, name)
    length = float(np.linalg.norm(ends[1] - ends[0]))
    if length < SHORTEST_PATH_MM:
        raise InputError(f"entry and target of {name} are {length:.2f} mm apart; expected a trajectory")
    entry, target = robot_from_ct.apply(ends, frame)
    rotation = _tool_axes(target - entry, as_numbers(x_axis, "the tool's x axis", "a direction (3,)"), name)
    about_tip = about(np.array([entry, target]))
    covariances = about_tip @ robot_from_ct.covariance @ about_tip.transpose(0, 2, 1)
    return RobotTrajectory(name, entry, target, covariances, rigid(rotation, entry), rigid(rotation, target))


def roll_doubts(trajectories: Sequence[RobotTrajectory], x_axis: ArrayLike) -> tuple[str, ...]:
    """Return a sentence that names the trajectories nearly along ``x_axis`` (3,), where there are any."""
    asked = unit(as_numbers(x_axis, "the tool's x axis", "a direction (3,)"))
    least = np.cos(np.radians(NEARLY_ALONG_DEG))
    along = [one.name for one in trajectories if abs(float(one.direction @ asked)) > least]
    if not along:
        return ()
    return (
        f"the direction that the tool's x axis keeps close to is within {NEARLY_ALONG_DEG:g} degrees of "
        f"{listed(along)}: rolls about trajectories beside each other may differ by up to half a turn; choose "
        "a direction across them (--x-axis)",
    )


def _tool_axes(advance: FloatArray, x_axis: FloatArray, name: str) -> FloatArray:
    if x_axis.shape != (3,):
        raise InputError(f"the tool's x axis has shape {x_axis.shape}; expected a direction (3,)")
    z = unit(advance)
    side = unit(x_axis) - z * (unit(x_axis) @ z)
    if np.linalg.norm(side) < ALONG:
        raise InputError(f"the tool's x axis was asked along the trajectory {name}; choose another direction")
    x = unit(side)
    return np.column_stack([x, np.cross(z, x), z])
