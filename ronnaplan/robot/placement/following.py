"""The joints of a posture along a way, and what margins they keep; compiled."""

from __future__ import annotations

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.compiled import ALL, near_postures, nearest_turn
from ronnaplan.robot.arm.links import times
from ronnaplan.robot.arm.margins import singularity, tightest
from ronnaplan.robot.arm.refined import refined
from ronnaplan.robot.arm.wrist import Wrist
from ronnaplan.robot.placement.machine import Machine
from ronnaplan.robot.placement.world import JOINT_NEED, SINGULAR_NEED

LARGEST_STEP_RAD = 1.5
"""A joint that turns further between two poses of a way has gone through a singular posture."""
NOTHING = -1.0
"""Worth of what does not serve."""


@njit(cache=True, nogil=True, error_model="numpy")
def lessen(wrist: Wrist, angles: FloatArray, margins: FloatArray) -> None:
    """Lessen ``margins`` (2,) of joints and of singular postures, in rad, to those of ``angles`` (6,)."""
    margins[0] = min(margins[0], tightest(wrist.limits, angles)[0])
    margins[1] = min(margins[1], singularity(wrist, angles))


@njit(cache=True, nogil=True, error_model="numpy")
def worth_of_joints(needs: FloatArray, joint: float, singular: float) -> float:
    """Return what margins of ``joint`` limits and ``singular`` postures are worth; `NOTHING` below ``needs`` (K,)."""
    if joint < needs[JOINT_NEED] or singular < needs[SINGULAR_NEED]:
        return NOTHING
    return float(np.degrees(min(joint, singular)))


@njit(cache=True, nogil=True, error_model="numpy")
def hoped(
    machine: Machine,
    needs: FloatArray,
    from_room: FloatArray,
    way: FloatArray,
    beyond: float,
    angles: FloatArray,
    hopes: FloatArray,
) -> None:
    """Fill ``hopes`` (8,) with what the joints of each posture are worth at both ends of a ``way`` (P, 4, 4).

    Along it they are worth no more. `NOTHING` stands for what is not above ``beyond``.
    """
    pose, alive, last = np.zeros((4, 4)), ALL, len(angles) - 1
    margins = np.full((8, 2), np.inf)
    for p in range(0, last + 1, max(last, 1)):
        _seen_from_base(from_room, way[p], pose)
        alive &= near_postures(machine.wrist, pose, alive, angles[p])
        for n in range(8):
            if (alive >> n) & 1:
                lessen(machine.wrist, angles[p, n], margins[n])
                hopes[n] = worth_of_joints(needs, margins[n, 0], margins[n, 1])
                if hopes[n] <= beyond:
                    alive &= ~(1 << n)
        if alive == 0:
            break
    for n in range(8):
        if not (alive >> n) & 1:
            hopes[n] = NOTHING


@njit(cache=True, nogil=True, error_model="numpy")
def follow(
    machine: Machine,
    needs: FloatArray,
    from_room: FloatArray,
    way: FloatArray,
    asked: int,
    beyond: float,
    angles: FloatArray,
    margins: FloatArray,
) -> None:
    """Fill ``angles`` (P, 8, 6) along a ``way`` (P, 4, 4) and ``margins`` (8, 2) of each posture kept throughout.

    ``margins`` are those of joints and of singular postures in rad, the least along the way; minus infinity where the
    pose is not reached, or the posture worth no more than ``beyond``, or not ``asked`` for (bits). ``from_room`` (4, 4)
    is the base from the room. All is by the nearest geometry that has a closed form: `settle` tells what a posture is
    by the arm as it is described.
    """
    pose = np.zeros((4, 4))
    alive = asked
    margins[:] = np.inf
    for p in range(len(angles)):
        _seen_from_base(from_room, way[p], pose)
        alive &= near_postures(machine.wrist, pose, alive, angles[p])
        if alive == 0:
            break
        for n in range(8):
            if not (alive >> n) & 1:
                continue
            if p > 0 and not _goes_on(angles[p - 1, n], angles[p, n]):
                alive &= ~(1 << n)
                continue
            lessen(machine.wrist, angles[p, n], margins[n])
            if worth_of_joints(needs, margins[n, 0], margins[n, 1]) <= beyond:
                alive &= ~(1 << n)
    for n in range(8):
        if not (alive >> n) & 1:
            margins[n] = -np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def settle(
    machine: Machine, from_room: FloatArray, way: FloatArray, posture: int, angles: FloatArray, margins: FloatArray
) -> None:
    """Bring one ``posture`` that `follow` told of to the ``way`` (P, 4, 4) by the arm as it is described.

    ``angles`` (P, 8, 6) and ``margins`` (8, 2) are what `follow` filled, and what is corrected.
    """
    for p in range(len(angles)):
        if not settled_at(machine, from_room, way, p, posture, angles, margins[posture]):
            margins[posture] = -np.inf
            return


@njit(cache=True, nogil=True, error_model="numpy")
def settled_at(
    machine: Machine,
    from_room: FloatArray,
    way: FloatArray,
    p: int,
    posture: int,
    angles: FloatArray,
    margins: FloatArray,
) -> bool:
    """Do so at pose ``p``, with ``margins`` (2,) the least up to there; false where the pose is not reached.

    It is left for last, as it takes longest, and most postures are given up at a way's beginning for what they meet.
    """
    if machine.wrist.off == 0.0:
        return True
    if p == 0:
        margins[:] = np.inf
    pose = np.zeros((4, 4))
    _seen_from_base(from_room, way[p], pose)
    if refined(machine.wrist.chain, machine.wrist.handed, pose, angles[p], 1 << posture) == 0:
        return False
    if p > 0 and not _goes_on(angles[p - 1, posture], angles[p, posture]):
        return False
    lessen(machine.wrist, angles[p, posture], margins)
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _seen_from_base(from_room: FloatArray, flange: FloatArray, pose: FloatArray) -> None:
    """Fill ``pose`` (4, 4) with ``flange`` (4, 4), room from flange, seen from the base."""
    times(from_room, flange, pose)
    for a in range(3):
        pose[a, 3] = from_room[a, 3]
        for b in range(3):
            pose[a, 3] += from_room[a, b] * flange[b, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def _goes_on(before: FloatArray, angles: FloatArray) -> bool:
    """Turn ``angles`` (6,) by whole turns to the nearest to ``before``; false where a joint still leaps."""
    leaps = False
    for j in range(6):
        angles[j] = nearest_turn(angles[j], before[j])
        leaps = leaps or abs(angles[j] - before[j]) > LARGEST_STEP_RAD
    return not leaps
