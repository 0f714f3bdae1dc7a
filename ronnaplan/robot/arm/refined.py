"""Postures of an arm as it is described, from those of the nearest geometry that has a closed form; compiled.

A calibrated arm's axes are nowhere quite parallel, perpendicular or meeting. From the posture of a geometry that is off
by a hundredth, Newton's method on the arm's own kinematics takes two or three steps to the last digits.
"""

from __future__ import annotations

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import LENGTH_MM
from ronnaplan.transforms import frame_along, invert

REACHED = 1e-12
"""A posture whose flange misses the pose by less, in rad and in mm per `LENGTH_MM`, is an answer."""
STEPS = 10
"""Newton's steps that may be taken; beyond three only near singular postures."""
LARGEST_STEP_RAD = 1.0
"""A step by which a joint turns further leads away from the posture that it began with."""
SAME_RAD = 1e-6
"""Postures nearer than this in every joint are the same one."""


def chain_of(arm: SerialArm) -> FloatArray:
    """Return poses (N + 1, 4, 4) between which the joints turn about z: the flange is their product, turns between."""
    about_z = [frame_along(np.zeros(3), axis) for axis in arm.axes]
    before = [np.eye(4), *(invert(one) for one in about_z)]
    fixed, after = [*arm.origins, arm.flange], [*about_z, np.eye(4)]
    return np.stack([a @ b @ c for a, b, c in zip(before, fixed, after, strict=True)])


@njit(cache=True, nogil=True, error_model="numpy")
def refined(chain: FloatArray, handed: float, pose: FloatArray, angles: FloatArray, found: int) -> int:
    """Bring those of the postures ``angles`` (8, 6) that ``found`` tells to ``pose`` (4, 4); return which reach it.

    ``handed`` is the sign of the Jacobian's determinant in posture 0. It changes with every bit of a posture's number:
    an answer with another sign belongs to another posture. What two lead to is told once.
    """
    frame, before, joints, system = np.empty((3, 4)), np.empty((3, 4)), np.empty((6, 6)), np.empty((6, 7))
    for n in range(8):
        if not (found >> n) & 1:
            continue
        sign = -handed if (n ^ (n >> 1) ^ (n >> 2)) & 1 else handed
        if not _brought(chain, pose, angles[n], sign, frame, before, joints, system):
            found &= ~(1 << n)
        for m in range(n):
            if (found >> n) & (found >> m) & 1 and _alike(angles[m], angles[n]):
                found &= ~(1 << n)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _alike(one: FloatArray, other: FloatArray) -> bool:
    """Whether two postures (6,) are the same, whole turns aside."""
    for n in range(6):
        apart = one[n] - other[n]
        if abs(apart - 2.0 * np.pi * np.round(apart / (2.0 * np.pi))) > SAME_RAD:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _brought(
    chain: FloatArray,
    pose: FloatArray,
    angles: FloatArray,
    sign: float,
    frame: FloatArray,
    before: FloatArray,
    joints: FloatArray,
    system: FloatArray,
) -> bool:
    """Bring ``angles`` (6,) to ``pose``; false where they do not get there, or by a determinant of another ``sign``."""
    handed = sign
    for _ in range(STEPS):
        _place_joints(chain, angles, frame, before, joints)
        if _missed(pose, frame, system) < REACHED:
            return handed == sign
        for n in range(6):
            ax, ay, az = joints[n, 0], joints[n, 1], joints[n, 2]
            x, y, z = frame[0, 3] - joints[n, 3], frame[1, 3] - joints[n, 4], frame[2, 3] - joints[n, 5]
            system[0, n], system[1, n], system[2, n] = ax, ay, az
            system[3, n] = (ay * z - az * y) / LENGTH_MM
            system[4, n] = (az * x - ax * z) / LENGTH_MM
            system[5, n] = (ax * y - ay * x) / LENGTH_MM
        handed = _solved(system)
        for n in range(6):
            if not abs(system[n, 6]) <= LARGEST_STEP_RAD:
                return False
            angles[n] += system[n, 6]
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _place_joints(
    chain: FloatArray, angles: FloatArray, frame: FloatArray, before: FloatArray, joints: FloatArray
) -> None:
    """Fill ``joints`` (6, 6) with each joint's axis and a place on it, ``frame`` (3, 4) with the flange."""
    for a in range(3):
        for b in range(4):
            frame[a, b] = chain[0, a, b]
    for n in range(6):
        c, s = np.cos(angles[n]), np.sin(angles[n])
        for a in range(3):
            joints[n, a], joints[n, 3 + a] = frame[a, 2], frame[a, 3]
            before[a, 0] = c * frame[a, 0] + s * frame[a, 1]
            before[a, 1] = c * frame[a, 1] - s * frame[a, 0]
            before[a, 2], before[a, 3] = frame[a, 2], frame[a, 3]
        link = chain[n + 1]
        for a in range(3):
            for b in range(4):
                frame[a, b] = before[a, 0] * link[0, b] + before[a, 1] * link[1, b] + before[a, 2] * link[2, b]
            frame[a, 3] += before[a, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def _missed(pose: FloatArray, frame: FloatArray, system: FloatArray) -> float:
    """Fill the last column of ``system`` (6, 7) with turn and way from ``frame`` to ``pose``; return the largest.

    The turn is its axis by its sine; beyond a right angle, where that tells nothing, the miss is infinite.
    """
    along = 0.0
    for a in range(6):
        system[a, 6] = 0.0
    for b in range(3):
        x, y, z = frame[0, b], frame[1, b], frame[2, b]
        system[0, 6] += (y * pose[2, b] - z * pose[1, b]) / 2.0
        system[1, 6] += (z * pose[0, b] - x * pose[2, b]) / 2.0
        system[2, 6] += (x * pose[1, b] - y * pose[0, b]) / 2.0
        along += x * pose[0, b] + y * pose[1, b] + z * pose[2, b]
    largest = 0.0
    for a in range(3):
        system[3 + a, 6] = (pose[a, 3] - frame[a, 3]) / LENGTH_MM
        largest = max(largest, max(abs(system[a, 6]), abs(system[3 + a, 6])))
    return largest if along > 1.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _largest_below(system: FloatArray, k: int) -> int:
    """Return the row, from ``k`` down, with the largest element of column ``k``."""
    best = k
    for r in range(k + 1, 6):
        if abs(system[r, k]) > abs(system[best, k]):
            best = r
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def _solved(system: FloatArray) -> float:
    """Solve the ``system`` (6, 7) in its last column, by elimination; return the sign of the determinant."""
    sign = 1.0
    for k in range(6):
        best = _largest_below(system, k)
        if best != k:
            sign = -sign
            for c in range(k, 7):
                system[k, c], system[best, c] = system[best, c], system[k, c]
        sign *= np.sign(system[k, k])
        inverse = 1.0 / system[k, k]
        for r in range(k + 1, 6):
            share = system[r, k] * inverse
            for c in range(k + 1, 7):
                system[r, c] -= share * system[k, c]
    for k in range(5, -1, -1):
        for c in range(k + 1, 6):
            system[k, 6] -= system[k, c] * system[c, 6]
        system[k, 6] /= system[k, k]
    return sign
