"""What stands in the way where no base serves everything, and the nearest entry that would work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.pose import invert
from ronnaplan.robot.placement.clearances import place_trolley, posture_margins
from ronnaplan.robot.placement.judging import follow
from ronnaplan.robot.placement.search import Problem, base_pose
from ronnaplan.robot.placement.tasks import Ways
from ronnaplan.robot.placement.world import Machine, World

UNREACHED, LIMIT, SINGULAR, COLLISION, HIDDEN, SERVED = range(6)
"""How far a task comes, from a base."""
TURNS_DEG = np.arange(3.0, 46.0, 3.0)
AROUND = 12
"""Entries that are tried in the place of one that is blocked: turned about the target by so much, so many ways."""


@dataclass(frozen=True)
class Blocked:
    """How far the best base comes with a task: the stage, its margin (degrees or mm), and what joint or body it is."""

    stage: int
    margin: float
    which: int
    other: int

    def sentence(self, problem: Problem, bodies: Sequence[str], where: str) -> str:
        """Say it; ``bodies`` are the names of the machine's, ``where`` is of every base or of one."""
        joint, singular, clearance, view = problem.world.needs
        if self.stage == UNREACHED:
            return f"out of the arm's reach {where}"
        if self.stage == LIMIT:
            if self.margin < 0:
                return f"joint {self.which + 1} beyond its limit by {-self.margin:.0f} degrees {where}"
            asked = np.degrees(joint)
            near = f"joint {self.which + 1} within {self.margin:.0f} degrees of its limit"
            return f"{near} {where}; {asked:g} are asked for"
        if self.stage == SINGULAR:
            asked = np.degrees(singular)
            return f"{self.margin:.0f} degrees from a singular posture {where}; {asked:g} are asked for"
        if self.stage == COLLISION:
            body = bodies[self.which] if self.which < len(bodies) else "the instrument"
            thing = {-1: "what stands in the room, or the floor", -2: "the head"}.get(self.other) or bodies[
                self.other
            ]
            return f"{body} comes within {self.margin:.0f} mm of {thing} {where}; {clearance:g} are asked for"
        return f"the tracker does not see the tool's marker by {np.degrees(view):g} degrees or more {where}"


def best_of(problem: Problem, task: int, bases: FloatArray) -> Blocked:
    """Return how far ``task`` comes from the best of ``bases`` (N, 4), x, y, z and turn."""
    found = [_state(problem, task, base_pose(place)) for place in bases]
    return max(found, key=lambda one: (one.stage, one.margin))


def _state(problem: Problem, task: int, base: FloatArray) -> Blocked:
    trolley = place_trolley(problem.machine, base)
    told = state(problem.machine, problem.world, problem.ways, base, invert(base), trolley, task)
    return Blocked(int(told[0]), float(told[1]), int(told[2]), int(told[3]))


@njit(cache=True, nogil=True, error_model="numpy")
def state(
    machine: Machine,
    world: World,
    ways: Ways,
    base: FloatArray,
    from_room: FloatArray,
    trolley: FloatArray,
    task: int,
) -> tuple[int, float, int, int]:
    """Return the stage that the best way and posture of ``task`` reaches, its margin there, and what it is of."""
    stage, margin, which, other = 0, -np.inf, 0, 0
    steps = ways.steps[task]
    frames, bodies = np.empty((len(machine.axes) + 1, 4, 4)), np.empty((len(machine.links) + 1, 7))
    frames[0] = base
    angles, margins = np.empty((steps, 8, 6)), np.empty((8, 2))
    pair = np.zeros(2, dtype=np.int64)
    for n in range(ways.firsts[task], ways.firsts[task + 1]):
        follow(machine, from_room, ways.flanges[n], steps, angles, margins)
        for b in range(8):
            if margins[b, 0] == -np.inf:
                continue
            kept = np.ascontiguousarray(angles[:, b])
            here, value, one = _reached(
                machine, world, trolley, ways.instruments[task], kept, margins[b], frames, bodies, pair
            )
            if here > stage or (here == stage and value > margin):
                stage, margin, which, other = here, value, one, pair[1]
        if stage == SERVED:
            break
    return stage, margin, which, other


@njit(cache=True, nogil=True, error_model="numpy")
def _reached(
    machine: Machine,
    world: World,
    trolley: FloatArray,
    instrument: FloatArray,
    angles: FloatArray,
    margins: FloatArray,
    frames: FloatArray,
    bodies: FloatArray,
    pair: NDArray[np.int64],
) -> tuple[int, float, int]:
    """Return the stage that postures (P, 6) along a way come to, the margin there, and the joint or body it is of."""
    if margins[0] < world.needs[0]:
        return LIMIT, np.degrees(margins[0]), _tightest(machine, angles)
    if margins[1] < world.needs[1]:
        return SINGULAR, np.degrees(margins[1]), 0
    for p in range(len(angles)):
        away, view = posture_margins(machine, world, trolley, instrument, angles[p], frames, bodies, pair, True)
        if view < world.needs[3]:
            return HIDDEN, np.degrees(view), 0
        if away < world.needs[2]:
            return COLLISION, away, pair[0]
    return SERVED, np.inf, 0


@njit(cache=True, nogil=True, error_model="numpy")
def _tightest(machine: Machine, angles: FloatArray) -> int:
    """Return the joint that comes nearest to its limit, or farthest beyond, in ``angles`` (P, 6)."""
    least, joint = np.inf, 0
    for p in range(len(angles)):
        for j in range(6):
            here = min(angles[p, j] - machine.wrist.limits[j, 0], machine.wrist.limits[j, 1] - angles[p, j])
            if here < least:
                least, joint = here, j
    return joint


def turned_entries(entry_mm: FloatArray, target_mm: FloatArray) -> tuple[FloatArray, NDArray[np.float64]]:
    """Return entries (N, 3) about ``target_mm``, as far from it as ``entry_mm``, and their turns (N,) in degrees."""
    out = entry_mm - target_mm
    length, axis = float(np.linalg.norm(out)), unit(out)
    side = unit(np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())]))
    about = np.arange(AROUND) * 2 * np.pi / AROUND
    across = np.cos(about)[:, None] * side + np.sin(about)[:, None] * np.cross(axis, side)
    turns = np.radians(np.repeat(TURNS_DEG, AROUND))
    spread = np.tile(across, (len(TURNS_DEG), 1))
    directions = np.cos(turns)[:, None] * axis + np.sin(turns)[:, None] * spread
    return target_mm + length * directions, np.degrees(turns)
