"""How each task is served from one base: the joints all along it, and the margins they keep."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.search import Problem
from ronnaplan.robot.placement.tasks import Kind, Task
from ronnaplan.robot.placement.world import World


@dataclass(frozen=True, eq=False)
class Served:
    """One task: ``angles_deg`` (P, 6) along its way, and the least margins on it."""

    name: str
    kind: Kind
    angles_deg: FloatArray
    joint_deg: float
    singularity_deg: float
    clearance_mm: float
    tracker_deg: float
    """Infinite where nothing is tracked."""


def serve(problem: Problem, tasks: tuple[Task, ...], base: FloatArray) -> tuple[Served | None, ...]:
    """Return how ``tasks``, those of ``problem``, are served best from ``base`` (4, 4); None for one that is not."""
    from ronnaplan.robot.placement.judging import judge_base

    worth, chosen = np.empty(len(problem)), np.zeros((len(problem), 2), dtype=np.int64)
    order = np.arange(len(problem))
    judge_base(problem.machine, problem.world, problem.ways, base, order, True, worth, chosen, 0.0, np.inf)
    return tuple(
        _served(problem, task, n, base, int(chosen[n, 0]), int(chosen[n, 1])) if worth[n] >= 0.0 else None
        for n, task in enumerate(tasks)
    )


def served_by_each(problem: Problem, task: Task | Served, number: int, base: FloatArray) -> Iterator[Served]:
    """Yield how ``task``, the one of that ``number`` in ``problem``, is served by each way and posture, best first."""
    from ronnaplan.robot.placement.clearances import standing_on
    from ronnaplan.robot.placement.judging import worth_of_each

    ways = problem.ways
    worths = np.empty((int(ways.firsts[number + 1] - ways.firsts[number]), 8))
    worth_of_each(problem.machine, problem.world, ways, standing_on(problem.machine, base), number, worths)
    for place in np.argsort(-worths, axis=None, kind="stable").tolist():
        way, posture = divmod(place, 8)
        if worths[way, posture] < 0.0:
            return
        yield _served(problem, task, number, base, way, posture)


def least_worth(world: World, served: Sequence[Served]) -> float:
    """Return what the worst of the tasks is worth, by which places are compared."""
    from ronnaplan.robot.placement.following import worth_of_joints
    from ronnaplan.robot.placement.judging import worth_at_most

    return min(
        min(
            worth_of_joints(world.needs, *np.radians([one.joint_deg, one.singularity_deg])),
            worth_at_most(world, one.clearance_mm, float(np.radians(one.tracker_deg))),
        )
        for one in served
    )


def _served(
    problem: Problem, task: Task | Served, number: int, base: FloatArray, way: int, posture: int
) -> Served:
    from ronnaplan.robot.placement.clearances import posture_margins, standing_on
    from ronnaplan.robot.placement.following import follow, settle

    machine, world, ways = problem.machine, problem.world, problem.ways
    steps = int(ways.steps[number])
    angles, margins = np.empty((steps, 8, 6)), np.empty((8, 2))
    flanges, standing = ways.flanges[ways.firsts[number] + way], standing_on(machine, base)
    follow(machine, world.needs, standing.from_room, flanges, 1 << posture, -np.inf, angles, margins)
    settle(machine, standing.from_room, flanges, posture, angles, margins)
    kept = np.ascontiguousarray(angles[:, posture])
    instrument = ways.instruments[number]
    along = np.array([posture_margins(machine, world, standing, instrument, one, np.inf, True) for one in kept])
    joint, singular = np.degrees(margins[posture])
    return Served(
        name=task.name,
        kind=task.kind,
        angles_deg=np.degrees(kept),
        joint_deg=float(joint),
        singularity_deg=float(singular),
        clearance_mm=float(along[:, 0].min()),
        tracker_deg=float(np.degrees(along[:, 1].min())),
    )
