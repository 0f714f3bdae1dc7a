"""What stands in the way where no base serves everything, and the nearest entry that would work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray, axes_across, unit
from ronnaplan.robot.arm.compiled import ALL
from ronnaplan.robot.arm.links import place_links
from ronnaplan.robot.arm.margins import tightest
from ronnaplan.robot.placement.clearances import (
    HEAD,
    ROOM,
    Standing,
    clearance,
    is_high,
    parked,
    place_trolley,
    posture_margins,
    standing_on,
)
from ronnaplan.robot.placement.distances import segment_box, segment_segment
from ronnaplan.robot.placement.following import follow, settle
from ronnaplan.robot.placement.job import Job
from ronnaplan.robot.placement.machine import APART, Machine, how_near, place_bodies
from ronnaplan.robot.placement.room import base_pose
from ronnaplan.robot.placement.search import Problem
from ronnaplan.robot.placement.tasks import Task, Ways
from ronnaplan.robot.placement.world import (
    CLEARANCE_NEED,
    HEAD_SPACING_MM,
    JOINT_NEED,
    SINGULAR_NEED,
    VIEW_NEED,
    World,
)

UNPARKED, UNREACHED, LIMIT, SINGULAR, OVERLAP, COLLISION, HIDDEN, SERVED = range(8)
"""How far a task comes, from a base."""
TURNS_DEG = np.arange(3.0, 46.0, 3.0)
AROUND = 12
"""Entries that are tried in the place of one that is blocked: turned about the target by so much, so many ways."""


@dataclass(frozen=True)
class Blocked:
    """How far the best base comes with a task: the stage, its margin (degrees or mm), and what joint or body it is of.

    ``other`` is what a body comes near to: another body, `HEAD`, or from `ROOM` down the room's things. Of a trolley
    that cannot stand there it is one of the latter, or any other number where nobody says which.
    """

    stage: int
    margin: float
    which: int
    other: int

    def sentence(self, job: Job, where: str) -> str:
        """Say it with the names of the ``job``; ``where`` says of what bases it is told.

        Margins are rounded down, so that none looks as if it were enough.
        """
        joints, bodies, things = job.arm.joints, job.body_names, job.thing_names
        joint, singular, clearance, view = job.world.needs
        if self.stage == UNPARKED:
            near = self._other(things) if self.other < 0 else "the head or the room's things"
            return f"the trolley would stand nearer than {clearance:g} mm to {near} {where}"
        if self.stage == UNREACHED:
            return f"out of the arm's reach {where}"
        if self.stage == LIMIT:
            if self.margin < 0:
                return f"joint {joints[self.which]} beyond its limit by {-self.margin:.0f} degrees {where}"
            asked = np.degrees(joint)
            near = f"joint {joints[self.which]} within {floor(self.margin)} degrees of its limit"
            return f"{near} {where}; {asked:g} are asked for"
        if self.stage == SINGULAR:
            asked = np.degrees(singular)
            return f"{floor(self.margin)} degrees from a singular posture {where}; {asked:g} are asked for"
        body = bodies[self.which] if self.which < len(bodies) else "the instrument"
        if self.stage == OVERLAP:
            return f"{body} would meet {bodies[self.other]} {where}"
        if self.stage == COLLISION:
            other = bodies[self.other] if self.other >= 0 else self._other(things)
            return f"{body} {how_near(self.margin)} {other} {where}; {clearance:g} mm are asked for"
        return f"the tracker does not see the tool's marker by {np.degrees(view):g} degrees or more {where}"

    def _other(self, things: Sequence[str]) -> str:
        return ("the head", *things)[HEAD - self.other]


def is_parked(problem: Problem, places: FloatArray) -> bool:
    """Whether the trolley can stand at any of ``places`` (N, 4), x, y, z and turn."""
    return any(parked(problem.world, place_trolley(problem.machine, base_pose(place))) for place in places)


def best_of(problem: Problem, task: int, places: FloatArray) -> Blocked:
    """Return how far ``task`` comes from the best of ``places`` (N, 4), x, y, z and turn."""
    found = [_state(problem, task, base_pose(place)) for place in places]
    return max(found, key=lambda one: (one.stage, one.margin))


def _state(problem: Problem, task: int, base: FloatArray) -> Blocked:
    machine = problem.machine
    return Blocked(*state(machine, problem.world, problem.ways, standing_on(machine, base), task))


def at_reference(job: Job, problem: Problem, base: FloatArray, posture_deg: FloatArray) -> str | None:
    """Say what the arm meets in its reference posture (6,) on ``base`` (4, 4); None where it is free there."""
    machine, world = problem.machine, problem.world
    postures, no_instrument = np.radians(posture_deg)[None], np.zeros(7)
    met = Blocked(*nearest(machine, world, standing_on(machine, base), no_instrument, postures, -np.inf))
    if met.margin >= world.needs[CLEARANCE_NEED]:
        return None
    return met.sentence(job, "in the reference posture")


@njit(cache=True, nogil=True, error_model="numpy")
def state(
    machine: Machine, world: World, ways: Ways, standing: Standing, task: int
) -> tuple[int, float, int, int]:
    """Return the stage that the best way and posture of ``task`` reaches, its margin there, and what it is of."""
    if not parked(world, standing.trolley):
        return UNPARKED, -np.inf, 0, 0
    stage, margin, which, other = UNREACHED, -np.inf, 0, 0
    angles, margins = np.empty((ways.steps[task], 8, 6)), np.empty((8, 2))
    for n in range(ways.firsts[task], ways.firsts[task + 1]):
        follow(machine, world.needs, standing.from_room, ways.flanges[n], ALL, -np.inf, angles, margins)
        for b in range(8):
            if margins[b, 0] == -np.inf:
                continue
            settle(machine, standing.from_room, ways.flanges[n], b, angles, margins)
            if margins[b, 0] == -np.inf:
                continue
            kept = np.ascontiguousarray(angles[:, b])
            beyond = -np.inf if stage < COLLISION else (margin if stage == COLLISION else np.inf)
            here, value, one = _reached(machine, world, standing, ways.instruments[task], kept, margins[b], beyond)
            if here > stage or (here == stage and value > margin):
                stage, margin, which, other = here, value, one, standing.pair[1]
        if stage == SERVED:
            break
    return stage, margin, which, other


@njit(cache=True, nogil=True, error_model="numpy")
def _reached(
    machine: Machine,
    world: World,
    standing: Standing,
    instrument: FloatArray,
    angles: FloatArray,
    margins: FloatArray,
    beyond: float,
) -> tuple[int, float, int]:
    """Return the stage that postures (P, 6) along a way come to, the margin there, and the joint or body it is of.

    What that comes near to is the last of ``standing.pair``.

    Of a clearance that is too little, and not above ``beyond`` (mm), the two that are nearest are not sought.
    """
    if margins[0] < world.needs[JOINT_NEED]:
        return LIMIT, np.degrees(margins[0]), _tightest(machine, angles)
    if margins[1] < world.needs[SINGULAR_NEED]:
        return SINGULAR, np.degrees(margins[1]), 0
    need = world.needs[CLEARANCE_NEED]
    stage, least, body, other = nearest(machine, world, standing, instrument, angles, min(beyond, need))
    if least < need:
        standing.pair[1] = other
        return stage, least, body
    for p in range(len(angles)):
        _, view = posture_margins(machine, world, standing, instrument, angles[p], 0.0, True)
        if view < world.needs[VIEW_NEED]:
            return HIDDEN, np.degrees(view), 0
    return SERVED, np.inf, 0


@njit(cache=True, nogil=True, error_model="numpy")
def nearest(
    machine: Machine, world: World, standing: Standing, instrument: FloatArray, angles: FloatArray, enough: float
) -> tuple[int, float, int, int]:
    """Return the two that come nearest in postures (P, 6): the stage if that is too near, how near, and which.

    These are a body and what it comes near to. As soon as two are nearer than ``enough`` (mm), the nearest are not
    sought.
    """
    trolley, bodies, pair = standing.trolley, standing.bodies, standing.pair
    least, body, other = np.inf, 0, 0
    for p in range(len(angles)):
        place_links(machine.origins, machine.axes, angles[p], standing.frames)
        place_bodies(machine, instrument, standing.frames, bodies)
        away = clearance(machine, world, trolley, bodies, enough, np.inf, pair)
        if away < least:
            least, body, other = away, pair[0], pair[1]
            if other == ROOM:
                other -= _thing(world, trolley, bodies[body], is_high(machine, body))
        if least < enough:
            break
    of_wrist = other >= 0 and machine.kept[body, other] == APART
    return OVERLAP if of_wrist else COLLISION, least, body, other


@njit(cache=True, nogil=True, error_model="numpy")
def _thing(world: World, trolley: FloatArray, capsule: FloatArray, high: bool) -> int:
    """Return the number of what stands nearest to a capsule (7,): the room's boxes, capsules, the trolley's, the floor.

    Those of the trolley, and the floor, count only for what is ``high`` on the arm.
    """
    boxes, capsules = len(world.boxes), len(world.capsules)
    least, nearest = np.inf, 0
    for n in range(boxes + capsules + (len(trolley) + 1 if high else 0)):
        if n < boxes:
            away = segment_box(capsule, world.boxes[n], least)
        elif n < boxes + capsules:
            away = segment_segment(capsule, world.capsules[n - boxes]) - world.capsules[n - boxes, 6]
        elif n < boxes + capsules + len(trolley):
            away = segment_box(capsule, trolley[n - boxes - capsules], least)
        else:
            away = min(capsule[2], capsule[5])
        if away < least:
            least, nearest = away, n
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def _tightest(machine: Machine, angles: FloatArray) -> int:
    """Return the joint that comes nearest to its limit, or farthest beyond, in ``angles`` (P, 6)."""
    least, joint = np.inf, 0
    for p in range(len(angles)):
        here, which = tightest(machine.wrist.limits, angles[p])
        if here < least:
            least, joint = here, which
    return joint


def entries_beside(task: Task, world: World) -> tuple[list[Task], NDArray[np.float64]]:
    """Return a trajectory with other entries about its target, and by how many degrees each of them is turned (N,)."""
    starts, turns_deg = turned_entries(task.starts_mm[0], task.ends_mm[0], world.head[: world.scalp, :3])
    return [replace(task, starts_mm=start[None]) for start in starts], turns_deg


def no_entry_works(turns_deg: NDArray[np.float64]) -> str:
    """Say that no entry turned by any of ``turns_deg`` (N,) works."""
    return f"no entry turned by up to {turns_deg.max():.0f} degrees about the target works either"


def turned_entries(
    entry_mm: FloatArray, target_mm: FloatArray, head_mm: FloatArray
) -> tuple[FloatArray, NDArray[np.float64]]:
    """Return entries (N, 3) about ``target_mm`` and their turns (N,) in degrees.

    They lie as far above or beneath the head's surface, of which ``head_mm`` (H, 3) are places, as ``entry_mm``.
    """
    out = entry_mm - target_mm
    length, axis = float(np.linalg.norm(out)), unit(out)
    side, up = axes_across(axis)
    about = np.arange(AROUND) * 2 * np.pi / AROUND
    around = np.cos(about)[:, None] * side + np.sin(about)[:, None] * up
    turns = np.radians(np.repeat(TURNS_DEG, AROUND))
    spread = np.tile(around, (len(TURNS_DEG), 1))
    directions = np.cos(turns)[:, None] * axis + np.sin(turns)[:, None] * spread
    scalp_mm = _surface(np.concatenate([axis[None], directions]), target_mm, head_mm)
    deeper_mm = np.nan_to_num(scalp_mm[1:] - scalp_mm[0])
    return target_mm + (length + deeper_mm)[:, None] * directions, np.degrees(turns)


def _surface(directions: FloatArray, target_mm: FloatArray, head_mm: FloatArray) -> FloatArray:
    """Return how far (N,) the head's surface is from ``target_mm`` along ``directions`` (N, 3); NaN where it has none.

    It is the mean of the places about the line, so that a slope does not count.
    """
    places = head_mm - target_mm
    along = places @ directions.T
    aside = np.linalg.norm(places[:, None] - along[:, :, None] * directions, axis=2)
    about = (along > 0) & (aside < HEAD_SPACING_MM)
    counts = about.sum(axis=0)
    found: FloatArray = np.where(counts > 0, (along * about).sum(axis=0) / np.maximum(counts, 1), np.nan)
    return found
