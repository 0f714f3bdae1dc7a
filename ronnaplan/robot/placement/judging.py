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
from ronnaplan.robot.arm.compiled import ALL
from ronnaplan.robot.placement.clearances import Standing, parked, posture_margins, standing_on
from ronnaplan.robot.placement.following import NOTHING, follow, hoped, settled_at, worth_of_joints
from ronnaplan.robot.placement.machine import Machine
from ronnaplan.robot.placement.tasks import Ways
from ronnaplan.robot.placement.world import CLEARANCE_NEED, VIEW_NEED, World


@njit(cache=True, nogil=True, error_model="numpy")
def soft(value: float, plenty: float) -> float:
    """Return what a margin counts for."""
    return np.inf if value >= plenty else value / (1.0 - value / plenty)


@njit(cache=True, nogil=True, error_model="numpy")
def worth_at_most(world: World, clearance: float, view: float) -> float:
    """Return what a posture that keeps ``clearance`` (mm) and ``view`` (rad) is worth, whatever its joints keep."""
    if clearance < world.needs[CLEARANCE_NEED] or view < world.needs[VIEW_NEED]:
        return NOTHING
    return min(soft(clearance, world.plenty[0]), float(np.degrees(soft(view, world.plenty[1]))))


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
    task that decided comes first in ``order`` (T,), and what served each is asked first (``chosen``).
    """
    standing = standing_on(machine, base)
    worth[:] = NOTHING
    if not parked(world, standing.trolley):
        return -float(len(order)) - 1.0
    worst, unserved, decides = plenty, 0, 0
    for place in range(len(order)):
        task = order[place]
        enough = np.inf if whole else worst
        worth[task] = judge_task(machine, world, ways, standing, task, least, enough, chosen[task])
        if worth[task] < worst:
            worst, decides = worth[task], place
        if worth[task] < 0.0:
            unserved += 1
            if not whole:
                break
    if not whole:
        _put_first(order, decides)
    return worst if unserved == 0 else -float(unserved)


@njit(cache=True, nogil=True, error_model="numpy")
def tasks_served(
    machine: Machine,
    world: World,
    ways: Ways,
    base: FloatArray,
    order: NDArray[np.int64],
    chosen: NDArray[np.int64],
    asked: int,
    enough: float,
    served: NDArray[np.bool_],
) -> None:
    """Fill ``served`` (T,) with which tasks ``base`` (4, 4) serves, whatever becomes of the others there.

    Where these are fewer than ``asked``, with none. Worths above ``enough`` are not told apart. ``order`` and
    ``chosen`` are kept as by `judge_base`.
    """
    standing = standing_on(machine, base)
    served[:] = False
    if not parked(world, standing.trolley):
        return
    spare = len(order) - asked
    for place in range(len(order)):
        task = order[place]
        served[task] = judge_task(machine, world, ways, standing, task, 0.0, enough, chosen[task]) >= 0.0
        if not served[task]:
            _put_first(order, place)
            spare -= 1
            if spare < 0:
                served[:] = False
                return


@njit(cache=True, nogil=True, error_model="numpy")
def _put_first(order: NDArray[np.int64], place: int) -> None:
    first = order[place]
    for n in range(place, 0, -1):
        order[n] = order[n - 1]
    order[0] = first


@njit(cache=True, nogil=True, error_model="numpy")
def judge_task(
    machine: Machine,
    world: World,
    ways: Ways,
    standing: Standing,
    task: int,
    least: float,
    enough: float,
    chosen: NDArray[np.int64],
) -> float:
    """Return the worth of ``task`` by its best way, or by any above ``enough``; `NOTHING` if none is above ``least``.

    ``chosen`` (2,) names way and posture; what it names beforehand is tried first where any will do.
    """
    flanges, instrument = ways.flanges[ways.firsts[task] : ways.firsts[task + 1]], ways.instruments[task]
    kept = ways.kept[ways.firsts[task] : ways.firsts[task + 1]]
    count, begin, best = len(flanges), chosen[0], NOTHING
    angles, hopes = np.empty((ways.steps[task], 8, 6)), np.full((count, 8), NOTHING)
    hopes[begin, chosen[1]] = enough
    for k in range(-1, count + 1):  # what is named, each way after the other, and at last all of them
        first, ways_asked = (begin + max(k, 0)) % count, 1
        if k == count:
            first, ways_asked = 0, count
        elif k >= 0 and worth_at_most(world, kept[first, 0], kept[first, 1]) > max(best, least):
            hoped(machine, world.needs, standing.from_room, flanges[first], max(best, least), angles, hopes[first])
        while True:
            n, b = divmod(int(hopes[first : first + ways_asked].argmax()), 8)
            n, beyond = n + first, max(best, least)
            if hopes[n, b] <= beyond or (hopes[n, b] < enough and k < count):
                break
            if worth_at_most(world, kept[n, 0], kept[n, 1]) <= beyond:
                hopes[n] = NOTHING
                continue
            found = worth_of(machine, world, standing, flanges[n], instrument, b, beyond, angles, hopes[n])
            if found > best:
                best, chosen[0], chosen[1] = found, n, b
            if best >= enough:
                return best
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def worth_of_each(
    machine: Machine, world: World, ways: Ways, standing: Standing, task: int, worths: FloatArray
) -> None:
    """Fill ``worths`` (N, 8) with what each posture is worth along each way of ``task``; `NOTHING` if it serves not."""
    flanges, instrument = ways.flanges[ways.firsts[task] : ways.firsts[task + 1]], ways.instruments[task]
    angles, margins = np.empty((ways.steps[task], 8, 6)), np.empty((8, 2))
    for n in range(len(flanges)):
        follow(machine, world.needs, standing.from_room, flanges[n], ALL, 0.0, angles, margins)
        for b in range(8):
            worths[n, b] = NOTHING
            if margins[b, 0] > 0.0:
                worths[n, b] = worth_along(
                    machine, world, standing, flanges[n], instrument, b, angles, margins[b], 0.0
                )


@njit(cache=True, nogil=True, error_model="numpy")
def worth_of(
    machine: Machine,
    world: World,
    standing: Standing,
    way: FloatArray,
    instrument: FloatArray,
    posture: int,
    beyond: float,
    angles: FloatArray,
    hopes: FloatArray,
) -> float:
    """Return what a ``posture`` is worth along its ``way``; `NOTHING` if not above ``beyond``.

    So it is where its joints are worth less than the ``hopes`` (8,) were, which then say what they are: others may be
    worth more, and are asked first.
    """
    margins = np.empty((8, 2))
    follow(machine, world.needs, standing.from_room, way, 1 << posture, beyond, angles, margins)
    hope = worth_of_joints(world.needs, margins[posture, 0], margins[posture, 1])
    is_less = hope < hopes[posture] or hope <= beyond
    hopes[posture] = hope if is_less else NOTHING
    if is_less:
        return NOTHING
    return worth_along(machine, world, standing, way, instrument, posture, angles, margins[posture], beyond)


@njit(cache=True, nogil=True, error_model="numpy")
def worth_along(
    machine: Machine,
    world: World,
    standing: Standing,
    way: FloatArray,
    instrument: FloatArray,
    posture: int,
    angles: FloatArray,
    margins: FloatArray,
    least: float,
) -> float:
    """Return what a ``posture`` that `follow` told of is worth along its ``way``; `NOTHING` if not above ``least``.

    ``margins`` (2,) are those of its joints. They and ``angles`` (P, 8, 6) are settled on the way.
    """
    need = world.needs[CLEARANCE_NEED]
    left = worth = np.inf
    for p in range(len(angles)):
        if not settled_at(machine, standing.from_room, way, p, posture, angles, margins):
            return NOTHING
        so_far = min(worth_of_joints(world.needs, margins[0], margins[1]), left)
        # clearance that counts for more than that decides nothing, and is not sought
        enough = max(so_far / (1.0 + so_far / world.plenty[0]), need)
        away, view = posture_margins(machine, world, standing, instrument, angles[p, posture], enough, True)
        kept = worth_at_most(world, away if away < enough else np.inf, view)
        if kept == NOTHING:
            return NOTHING
        left = min(left, kept)
        worth = min(so_far, left)
        if worth <= least:
            return NOTHING
    return worth
