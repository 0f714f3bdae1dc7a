"""What blocks from every base of a floor for certain, so that none need be sought: a search would only end so."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.wrist import center_mm, shoulder_mm, stretched_mm, wrist_of
from ronnaplan.robot.placement.blocking import (
    COLLISION,
    UNPARKED,
    UNREACHED,
    Blocked,
    entries_beside,
    no_entry_works,
)
from ronnaplan.robot.placement.clearances import HEAD, ROOM, place_trolley
from ronnaplan.robot.placement.distances import box_box, segment_box, segment_segment
from ronnaplan.robot.placement.job import Job
from ronnaplan.robot.placement.machine import Machine, moved_capsule
from ronnaplan.robot.placement.room import Floor, base_pose
from ronnaplan.robot.placement.search import Problem
from ronnaplan.robot.placement.tasks import Fineness, Ways, ways_of
from ronnaplan.robot.placement.world import CLEARANCE_NEED, World
from ronnaplan.transforms import invert, transform_points

TURN_DEG = 1.0
"""Turns of the base are looked at so closely."""
SPARE_MM = 1e-3
"""Nothing is out of reach by less."""
ANYWHERE = "for every base on the floor"
BOX = 8
"""Numbers of a box, in place of a capsule's seven."""


@dataclass(frozen=True, eq=False)
class _Part:
    """What stands on the base: a box of the trolley, or a body of the arm, by its number there."""

    stage: int
    number: int
    row: FloatArray
    """A box (8,) or a capsule (7,) in the base's frame."""

    @property
    def reach_mm(self) -> float:
        """How far it is from the axis about which the base turns, at most."""
        if len(self.row) == BOX:
            return float(np.hypot(*self.row[:2]) + np.hypot(*self.row[3:5]))
        return float(max(np.hypot(*self.row[:2]), np.hypot(*self.row[3:5])) + self.row[6])

    def on(self, machine: Machine, base: FloatArray) -> FloatArray:
        """Return it in the room, on an upright ``base`` (4, 4)."""
        if len(self.row) == BOX:
            box: FloatArray = place_trolley(machine._replace(trolley=self.row[None]), base)[0]
            return box
        moved = np.empty(7)
        moved_capsule(base, self.row, moved)
        return moved


def blocked_anywhere(job: Job, problem: Problem, fineness: Fineness) -> tuple[str, ...]:
    """Say what blocks whatever base of the floor is taken; nothing where a search has to tell.

    ``problem`` is the job's with that ``fineness``.
    """
    near = in_the_way(job, problem, problem.floor, ANYWHERE)
    return (near,) if near is not None else tuple(_out_of_reach(job, problem, fineness))


def in_the_way(job: Job, problem: Problem, floor: Floor, where: str) -> str | None:
    """Say what comes too near to the trolley or the arm's lowest links from each base of ``floor``; None for nothing.

    The distance of two convex bodies is convex as one is shifted, so that it is largest in a corner of the floor.
    Between two turns it grows by no more than what stands on the base is moved.
    """
    machine, need = problem.machine, float(problem.world.needs[CLEARANCE_NEED])
    places, step_deg = _outermost(floor)
    bases = [base_pose(place) for place in places]
    for part in _parts(machine):
        enough = need - part.reach_mm * np.radians(step_deg) / 2
        first = part.on(machine, bases[0])
        for other, thing in _things(problem.world):
            if apart_mm(first, thing) >= enough:
                continue
            away = -np.inf
            for base in bases:
                away = max(away, apart_mm(part.on(machine, base), thing))
                if away >= enough:
                    break
            else:
                told = Blocked(part.stage, away, part.number, other)
                return told.sentence(job, where)
    return None


def apart_mm(one: FloatArray, other: FloatArray) -> float:
    """Return the distance between two of boxes (8,) and capsules (7,)."""
    if len(one) == len(other) == BOX:
        return float(box_box(one, other))
    if len(one) == len(other):
        return float(segment_segment(one, other) - one[6] - other[6])
    box, capsule = (one, other) if len(one) == BOX else (other, one)
    return float(segment_box(capsule, box, np.inf) - capsule[6])


def _outermost(floor: Floor) -> tuple[FloatArray, float]:
    """Return the floor's corners (N, 4) with all turns, and how far (degrees) these are from each other."""
    least, greatest = floor.turn_deg
    count = 1 + int(np.ceil((greatest - least) / TURN_DEG))
    sides = (np.unique(ends) for ends in (floor.x_mm, floor.y_mm, floor.z_mm))
    found = np.array(list(product(np.linspace(least, greatest, count), *sides)))  # corners first: most tell there
    return np.roll(found, -1, axis=1), (greatest - least) / max(count - 1, 1)


def _parts(machine: Machine) -> list[_Part]:
    """Return what is there however the arm is bent: the trolley's boxes, the bodies of link 0, and what link 1 fills.

    That are balls within the ends of its bodies, about axis 1.
    """
    parts = [_Part(UNPARKED, n, box) for n, box in enumerate(machine.trolley)]
    parts += [_Part(COLLISION, n, machine.bodies[n]) for n in np.flatnonzero(machine.links == 0).tolist()]
    origin, axis = machine.origins[0], machine.axes[0]
    for n in np.flatnonzero(machine.links == 1).tolist():
        for end in machine.bodies[n, :6].reshape(2, 3):
            middle = axis * (axis @ end)
            radius = machine.bodies[n, 6] - float(np.linalg.norm(end - middle))
            if radius > 0.0:
                place = origin[:3, :3] @ middle + origin[:3, 3]
                parts.append(_Part(COLLISION, n, np.array([*place, *place, radius])))
    return parts


def _things(world: World) -> list[tuple[int, FloatArray]]:
    """Return what stands in the room, boxes (8,) and capsules (7,), each with the number that it is told by."""
    rows = [*world.boxes, *world.capsules]
    balls = np.concatenate([world.head[:, :3], world.head], axis=1)
    return [*((ROOM - n, row) for n, row in enumerate(rows)), *((HEAD, row) for row in balls)]


def _out_of_reach(job: Job, problem: Problem, fineness: Fineness) -> list[str]:
    told = []
    for n in np.flatnonzero(beyond_reach(job.arm, problem.ways, problem.floor)):
        task = job.tasks[n]
        why = Blocked(UNREACHED, -np.inf, 0, 0).sentence(job, ANYWHERE)
        rest = ""
        if task.kind == "trajectory":
            others, turns_deg = entries_beside(task, job.world)
            if not beyond_reach(job.arm, ways_of(others, job.arm, fineness), problem.floor).all():
                continue  # an entry may be proposed, which is sought
            rest = f"; {no_entry_works(turns_deg)}"
        told.append(f"{task.kind} {task.name}: {why}{rest}")
    return told


def beyond_reach(arm: SerialArm, ways: Ways, floor: Floor) -> NDArray[np.bool_]:
    """Return which tasks (T,) no base on ``floor`` reaches, however it is turned: some place of every way is too far.

    It is told of where axes 5 and 6 meet from abreast of axis 2 on axis 1, or of where all of a shoulder's meet; of an
    arm whose axes stand and meet so but for errors, of joint 6 from joint 1, which no posture has farther apart than
    all links one after the other are long.
    """
    wrist = wrist_of(arm)
    if wrist.off == 0.0:
        foot, at = shoulder_mm(wrist), center_mm(wrist)
        reach = float(np.hypot(stretched_mm(wrist) + np.linalg.norm(wrist.axis_2), wrist.beside))
    else:
        foot, at = arm.origins[0][:3, 3], invert(arm.flange)[:3, 3]
        reach = float(np.linalg.norm(arm.origins[1:, :3, 3], axis=1).sum())
    high = floor.z_mm[0] + foot[2], floor.z_mm[1] + foot[2]
    places = transform_points(ways.flanges, at[None])[..., 0, :]
    x, y, z = (_outside(places[..., n], ends) for n, ends in enumerate((floor.x_mm, floor.y_mm, high)))
    away = np.hypot(np.maximum(np.hypot(x, y) - np.hypot(*foot[:2]), 0.0), z)
    steps = np.repeat(ways.steps, np.diff(ways.firsts))
    away[np.arange(away.shape[1]) >= steps[:, None]] = 0.0
    reached = away.max(axis=1) <= reach + SPARE_MM
    return ~np.logical_or.reduceat(reached, ways.firsts[:-1])


def _outside(places: FloatArray, ends: tuple[float, float]) -> FloatArray:
    """Return how far ``places`` are beyond the nearer of ``ends``, zero between them."""
    away: FloatArray = np.maximum(np.maximum(ends[0] - places, places - ends[1]), 0.0)
    return away
