"""How far a posture is from its joints' limits, and from those in which the arm loses a direction; compiled.

`quality` tells both in degrees, of many postures.
"""

from __future__ import annotations

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.compiled import swung
from ronnaplan.robot.arm.wrist import Wrist


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _singular_backwards(wrist: Wrist, angles: FloatArray) -> float:
    """Do as `singularity` of an arm with a spherical shoulder.

    The determinant of the Jacobian is the product of four factors: the sine between axes 3 and 1, the area that the
    elbow spans, how far the shoulder is from axis 5, and the sine between the elbow's plane and that of axes 5 and 6.
    """
    straight = abs(np.arcsin(min(max(np.sin(angles[1] + wrist.bend), -1.0), 1.0)))
    by, bx = swung(wrist.lower, angles[3])
    cross = abs(wrist.upper[0] * bx - wrist.upper[1] * by)
    along = abs(wrist.upper[0] * by + wrist.upper[1] * bx)
    turned = angles[4] + wrist.plane
    least = min(straight, np.arctan2(cross, along), np.arctan2(abs(np.cos(turned)), abs(np.sin(turned))))
    cosine = -wrist.upper[1] / np.hypot(bx, by)
    if abs(cosine) <= 1.0:  # joint 4 can turn the shoulder onto axis 5
        least = min(least, abs(np.arccos(cosine) - abs(np.arctan2(by, bx))))
    return float(least)


@njit(cache=True, nogil=True, error_model="numpy")
def singularity(wrist: Wrist, angles: FloatArray) -> float:
    """Return the angle in rad from ``angles`` (6,) to the nearest singular posture.

    The determinant of the Jacobian is a product of three factors with either wrist: how far axis 6 is from axis 4's
    direction, the elbow, and the wrist's center, which along axis 2 must not be seen over axis 1.
    """
    if wrist.backwards:
        return _singular_backwards(wrist, angles)
    straight = abs(np.arcsin(min(max(np.sin(angles[4] + wrist.bend), -1.0), 1.0)))
    bent = wrist.elbow_sign * angles[2]
    lx, lz = swung(wrist.lower, bent)
    cross = abs(wrist.upper[0] * lz - wrist.upper[1] * lx)
    along = abs(wrist.upper[0] * lx + wrist.upper[1] * lz)
    elbow = np.arctan2(cross, along)
    gx, gz = wrist.upper[0] + lx, wrist.upper[1] + lz
    if wrist.parallel:
        hx, hz = swung(wrist.hand, bent + wrist.hand_sign * angles[3])
        gx, gz = gx + hx, gz + hz
    c, s = np.cos(angles[1]), np.sin(angles[1])
    x, z = c * gx + s * gz, c * gz - s * gx
    over = np.arctan2(abs(x + wrist.axis_2[0]), abs(z))
    return float(min(straight, elbow, over))


@njit(cache=True, nogil=True, error_model="numpy")
def tightest(limits: FloatArray, angles: FloatArray) -> tuple[float, int]:
    """Return how far (rad) ``angles`` (N,) are from the nearest of all ``limits`` (N, 2), and which joint's that is.

    Negative beyond it.
    """
    least, joint = np.inf, 0
    for j in range(len(angles)):
        here = min(angles[j] - limits[j, 0], limits[j, 1] - angles[j])
        if here < least:
            least, joint = here, j
    return least, joint
