"""Inverse kinematics of any arm: damped least squares from many starts at once.

The damping is the squared miss itself plus a little (Sugihara 2011, IEEE Trans. Robot. 27:984), which keeps steps sound
near singular postures and makes them Gauss-Newton's at the end. Joints stay within their limits all the way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import RefusedError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import as_pose
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import LENGTH_MM, forward, jacobian
from ronnaplan.robot.arm.quality import joint_margins_deg

STARTS, STEPS = 128, 60
"""So many postures, drawn between the limits, are led to the pose in so many steps."""
LEAST_DAMPING = 1e-12
"""Keeps the equations of a step solvable in a singular posture that is as good as there."""
REACHED = 1e-9
"""A miss (rad, and mm per `LENGTH_MM`) below this is an answer."""
APART_RAD = 1e-3
"""Answers nearer than this in every joint are the same one."""


def inverse_numeric(
    arm: SerialArm, pose: ArrayLike, tool: str | None = None, *, starts: int = STARTS, seed: int = 0
) -> FloatArray:
    """Return the different postures (S, N) found, within the limits, that bring ``tool`` to ``pose`` (4, 4).

    They are ordered by their distance from the limits, the farthest first. Not all may be found. Raises
    `RefusedError` where none is.
    """
    asked = as_pose(pose, "the pose to reach")
    least, greatest = arm.limits_rad.T
    angles = np.random.default_rng(seed).uniform(least, greatest, (starts, len(arm)))
    for _ in range(STEPS):
        miss = _miss(forward(arm, angles, tool), asked)
        moved = jacobian(arm, angles, tool)
        moved[:, 3:] /= LENGTH_MM
        square = (miss**2).sum(axis=1)
        normal = moved.swapaxes(1, 2) @ moved + (square + LEAST_DAMPING)[:, None, None] * np.eye(len(arm))
        step = np.linalg.solve(normal, moved.swapaxes(1, 2) @ miss[:, :, None])[:, :, 0]
        angles = np.clip(angles + step, least, greatest)
    reached = angles[np.abs(_miss(forward(arm, angles, tool), asked)).max(axis=1) < REACHED]
    if not len(reached):
        raise RefusedError(
            f"none of {starts} starts led the arm {arm.name} to the pose within its limits; it may be out of reach"
        )
    return _different(arm, reached)


def _miss(now: FloatArray, asked: FloatArray) -> FloatArray:
    """Return rotation vector (rad) and translation (per `LENGTH_MM`) (S, 6) from ``now`` (S, 4, 4) to ``asked``."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(asked[:3, :3] @ now[:, :3, :3].swapaxes(1, 2)).as_rotvec()
    return np.concatenate([turn, (asked[:3, 3] - now[:, :3, 3]) / LENGTH_MM], axis=1)


def _different(arm: SerialArm, angles: FloatArray) -> FloatArray:
    """Return those of postures (M, N) that differ, the farthest from the limits first."""
    margins = joint_margins_deg(arm, angles).min(axis=1)
    kept: list[FloatArray] = []
    for one in angles[np.argsort(-margins, kind="stable")]:
        if all(np.abs(one - other).max() > APART_RAD for other in kept):
            kept.append(one)
    return np.array(kept)
