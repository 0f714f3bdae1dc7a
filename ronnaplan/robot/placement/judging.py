"""The compiled judgement of a base: which way serves each task best, and how near that comes to what must not be.

The worth of a posture is the least of four margins in degrees: of the joints, of singular postures, of clearance
(a millimetre counts as a degree) and of the tracker's view. Clearance and view count for x / (1 - x / plenty), so that
beyond plenty they count no more. A margin below what is asked for makes a posture worth nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.compiled import near_postures, nearest_turn
from ronnaplan.robot.arm.links import invert_into, times
from ronnaplan.robot.arm.refined import refined
from ronnaplan.robot.arm.singular import singularity
from ronnaplan.robot.placement.clearances import parked, place_trolley, posture_margins
from ronnaplan.robot.placement.machine import Machine, frames_on
from ronnaplan.robot.placement.tasks import Ways
from ronnaplan.robot.placement.world import CLEARANCE_NEED, JOINT_NEED, SINGULAR_NEED, VIEW_NEED, World

LARGEST_STEP_RAD = 1.5
"""A joint that turns further between two poses of a way has gone through a singular posture."""
NOTHING = -1.0
"""Worth of what does not serve."""


@njit(cache=True, nogil=True, error_model="numpy")
def soft(value: float, plenty: float) -> float:
    """Return what a margin counts for."""
    return np.inf if value >= plenty else value / (1.0 - value / plenty)


@njit(cache=True, nogil=True, error_model="numpy")
def joint_margin(machine: Machine, angles: FloatArray) -> float:
    """Return the least distance (rad) of ``angles`` (6,) from their limits; negative beyond."""
    least = np.inf
    for j in range(6):
        low, high = machine.wrist.limits[j, 0], machine.wrist.limits[j, 1]
        least = min(least, min(angles[j] - low, high - angles[j]))
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def follow(
    machine: Machine, from_room: FloatArray, way: FloatArray, steps: int, angles: FloatArray, margins: FloatArray
) -> None:
    """Fill ``angles`` (P, 8, 6) along a ``way`` (P, 4, 4) and ``margins`` (8, 2) of each posture kept throughout.

    ``margins`` are those of joints and of singular postures in rad, the least along the way; minus infinity where the
    pose is not reached. ``from_room`` (4, 4) is the base from the room. All is by the nearest geometry that has a
    closed form: `settle` tells what a posture is by the arm as it is described.
    """
    pose = np.zeros((4, 4))
    alive = 255
    margins[:] = np.inf
    for p in range(steps):
        _seen_from_base(from_room, way[p], pose)
        alive &= near_postures(machine.wrist, pose, angles[p])
        for n in range(8):
            if not (alive >> n) & 1:
                continue
            if p > 0 and not _goes_on(angles[p - 1, n], angles[p, n]):
                alive &= ~(1 << n)
            margins[n, 0] = min(margins[n, 0], joint_margin(machine, angles[p, n]))
            margins[n, 1] = min(margins[n, 1], singularity(machine.wrist, angles[p, n]))
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
    margins[0] = min(margins[0], joint_margin(machine, angles[p, posture]))
    margins[1] = min(margins[1], singularity(machine.wrist, angles[p, posture]))
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


@njit(cache=True, nogil=True, error_model="numpy")
def judge_base(
    machine: Machine,
    world: World,
    ways: Ways,
    base: FloatArray,
    order: NDArray[np.int64],
    whole: bool,
    worth: FloatArray,
    chosen: NDArray[np.int64],
    least: float,
    plenty: float,
) -> float:
    """Return the least worth of all tasks at ``base`` (4, 4), room from base; below zero when one is not served.

    ``whole``: ``worth`` (T,) and ``chosen`` (T, 2), the way and the posture, are filled for every task with its best.
    Otherwise a task is left as soon as it cannot lower the result, and the first that is not served, or not above
    ``least``, ends the search; nothing above ``plenty`` is told apart. What one base teaches is kept for the next: the
    task that decided comes first in ``order`` (T,), and the way that served each is asked first (``chosen``).
    """
    trolley = place_trolley(machine, base)
    worth[:] = NOTHING
    if not parked(world, trolley):
        return -float(len(order)) - 1.0
    frames, bodies = frames_on(machine, base), np.empty((len(machine.links) + 1, 7))
    inverse = np.zeros((4, 4))
    invert_into(inverse, base)
    worst, unserved, decides = plenty, 0, 0
    for place in range(len(order)):
        task = order[place]
        enough = np.inf if whole else worst
        worth[task] = judge_task(
            machine, world, ways, inverse, trolley, task, least, enough, frames, bodies, chosen[task]
        )
        if worth[task] < worst:
            worst, decides = worth[task], place
        if worth[task] < 0.0:
            unserved += 1
            if not whole:
                break
    if not whole:
        first = order[decides]
        for n in range(decides, 0, -1):
            order[n] = order[n - 1]
        order[0] = first
    return worst if unserved == 0 else -float(unserved)


@njit(cache=True, nogil=True, error_model="numpy")
def judge_task(
    machine: Machine,
    world: World,
    ways: Ways,
    from_room: FloatArray,
    trolley: FloatArray,
    task: int,
    least: float,
    enough: float,
    frames: FloatArray,
    bodies: FloatArray,
    chosen: NDArray[np.int64],
) -> float:
    """Return the worth of ``task`` by its best way, or by any above ``enough``; `NOTHING` if none is above ``least``.

    ``chosen`` (2,) names way and posture; the way that it names beforehand is tried first where any will do.
    """
    first, count, steps = ways.firsts[task], ways.firsts[task + 1] - ways.firsts[task], ways.steps[task]
    angles, margins, hopes = np.empty((steps, 8, 6)), np.empty((8, 2)), np.empty((count, 8))
    instrument, best, begin = ways.instruments[task], NOTHING, chosen[0]
    for k in range(count):
        n = (begin + k) % count
        way = ways.flanges[first + n]
        hoped(machine, world, from_room, way, steps, angles, margins, hopes[n])
        while True:
            b = int(hopes[n].argmax())
            hope, beyond = hopes[n, b], max(best, least)
            if hope < enough or hope <= beyond:
                break
            hopes[n, b] = NOTHING
            found = worth_along(
                machine, world, way, from_room, trolley, instrument, b, angles, margins[b], beyond, frames, bodies
            )
            if found > best:
                best, chosen[0], chosen[1] = found, n, b
            if best >= enough:
                return best
    while True:
        n, b = divmod(int(hopes.argmax()), 8)
        beyond = max(best, least)
        if hopes[n, b] <= beyond:
            return best
        hopes[n, b] = NOTHING
        way = ways.flanges[first + n]
        follow(machine, from_room, way, steps, angles, margins)
        found = worth_along(
            machine, world, way, from_room, trolley, instrument, b, angles, margins[b], beyond, frames, bodies
        )
        if found > best:
            best, chosen[0], chosen[1] = found, n, b


@njit(cache=True, nogil=True, error_model="numpy")
def hoped(
    machine: Machine,
    world: World,
    from_room: FloatArray,
    way: FloatArray,
    steps: int,
    angles: FloatArray,
    margins: FloatArray,
    hopes: FloatArray,
) -> None:
    """Follow a ``way`` (P, 4, 4), and fill ``hopes`` (8,) with what the joints of each posture are worth along it."""
    follow(machine, from_room, way, steps, angles, margins)
    for b in range(8):
        hopes[b] = worth_of_joints(world, margins[b])


@njit(cache=True, nogil=True, error_model="numpy")
def worth_of_joints(world: World, margins: FloatArray) -> float:
    """Return what the ``margins`` (2,) of joints and of singular postures are worth; `NOTHING` below what is asked."""
    if margins[0] < world.needs[JOINT_NEED] or margins[1] < world.needs[SINGULAR_NEED]:
        return NOTHING
    return float(np.degrees(min(margins[0], margins[1])))


@njit(cache=True, nogil=True, error_model="numpy")
def worth_along(
    machine: Machine,
    world: World,
    way: FloatArray,
    from_room: FloatArray,
    trolley: FloatArray,
    instrument: FloatArray,
    posture: int,
    angles: FloatArray,
    margins: FloatArray,
    least: float,
    frames: FloatArray,
    bodies: FloatArray,
) -> float:
    """Return what a ``posture`` that `follow` told of is worth along its ``way``; `NOTHING` if not above ``least``.

    ``margins`` (2,) are those of its joints. They and ``angles`` (P, 8, 6) are settled on the way.
    """
    pair = np.empty(2, dtype=np.int64)
    left = worth = np.inf
    for p in range(len(angles)):
        if not settled_at(machine, from_room, way, p, posture, angles, margins):
            return NOTHING
        away, view = posture_margins(
            machine, world, trolley, instrument, angles[p, posture], frames, bodies, pair, True
        )
        if away < world.needs[CLEARANCE_NEED] or view < world.needs[VIEW_NEED]:
            return NOTHING
        left = min(left, min(soft(away, world.plenty[0]), np.degrees(soft(view, world.plenty[1]))))
        worth = min(worth_of_joints(world, margins), left)
        if worth <= least:
            return NOTHING
    return worth
