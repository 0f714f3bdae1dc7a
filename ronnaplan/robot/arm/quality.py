"""How far an arm is from its limits and from postures in which it loses a direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import as_angles


def joint_margins_deg(arm: SerialArm, angles_rad: ArrayLike) -> FloatArray:
    """Return how far each joint (..., N) is from the nearer of its limits, degrees; negative beyond it."""
    angles = as_angles(arm, angles_rad)
    nearer = np.minimum(angles - arm.limits_rad[:, 0], arm.limits_rad[:, 1] - angles)
    return np.degrees(nearer)


def singularity_deg(arm: SerialArm, angles_rad: ArrayLike) -> FloatArray:
    """Return the angle (...) in degrees to the nearest singular posture of an arm that has a closed form.

    Three there are: joint 5 straight (axis 6 along axis 4), the elbow stretched or folded, the wrist's center over axis
    1 (told as the angle that it is seen under from axis 2). With a spherical shoulder they are joint 2 straight (axis 3
    along axis 1), the elbow, and the shoulder in the plane of axes 5 and 6, where joint 5 turns it or, onto axis 5,
    joint 4. Of an arm that is nearly of a closed form they are those of the nearest that is.

    Raises `InputError` for an arm without a closed form.
    """
    from ronnaplan.robot.arm.margins import singularity
    from ronnaplan.robot.arm.wrist import wrist_of

    wrist, angles = wrist_of(arm), as_angles(arm, angles_rad)
    flat = np.ascontiguousarray(angles.reshape(-1, len(arm)))
    return np.degrees([singularity(wrist, one) for one in flat]).reshape(angles.shape[:-1])
