"""The order in which the arm moves least, by ways that are free.

A move is straight in the joints; where that is not free it goes by the reference posture. What a move counts is the
turn of the joint that turns most, in degrees, as for joints of one speed.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.clearances import place_trolley, posture_margins
from ronnaplan.robot.placement.search import Problem
from ronnaplan.robot.placement.serving import Served
from ronnaplan.robot.placement.world import Machine, World

STEP_DEG = 2.0
"""Postures on a move are looked at this closely."""


@dataclass(frozen=True, eq=False)
class Route:
    """The tasks in order, from and to the ``reference_deg`` (6,) posture; ``by_reference`` names those reached by it.

    ``stuck`` names tasks to which no free way was found.
    """

    order: tuple[str, ...]
    travel_deg: float
    by_reference: tuple[str, ...]
    stuck: tuple[str, ...]
    reference_deg: FloatArray


def plan_route(problem: Problem, base: FloatArray, served: Sequence[Served], reference_deg: FloatArray) -> Route:
    """Return the way through all ``served``: the markers first, then the trajectories, each from its own beginning."""
    reference = np.array(reference_deg, dtype=np.float64)
    reference[0] += float(np.median([one.angles_deg[0, 0] for one in served])) if served else 0.0
    reference[0] = np.clip(reference[0], *np.degrees(problem.machine.wrist.limits[0]))
    postures = np.array([reference, *(one.angles_deg[0] for one in served)])
    direct = _moves(problem, base, postures)
    by_reference = direct[:, :1] + direct[:1, :]
    cost = np.minimum(direct, by_reference)
    stuck = ~np.isfinite(cost[0])
    order: list[int] = []
    for kind in ("marker", "trajectory"):
        group = [n + 1 for n, one in enumerate(served) if one.kind == kind and not stuck[n + 1]]
        order += _shortest(cost, order[-1] if order else 0, group)
    through = [0, *order, 0]
    pairs = list(itertools.pairwise(through))
    return Route(
        tuple(served[n - 1].name for n in order),
        float(sum(cost[pair] for pair in pairs)),
        tuple(served[b - 1].name for a, b in pairs if a and b and by_reference[a, b] < direct[a, b]),
        tuple(served[n - 1].name for n in np.flatnonzero(stuck).tolist()),
        reference,
    )


def _moves(problem: Problem, base: FloatArray, postures_deg: FloatArray) -> FloatArray:
    """Return what straight moves between postures (N, 6) count (N, N); infinite where they are not free."""
    found: FloatArray = np.abs(postures_deg[:, None] - postures_deg).max(axis=-1)
    trolley = place_trolley(problem.machine, base)
    for a in range(len(found)):
        for b in range(a):
            ends = np.radians(postures_deg[[a, b]])
            if not is_free(problem.machine, problem.world, trolley, base, ends, np.radians(STEP_DEG)):
                found[a, b] = found[b, a] = np.inf
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def is_free(
    machine: Machine, world: World, trolley: FloatArray, base: FloatArray, ends: FloatArray, step: float
) -> bool:
    """Whether the straight move between the postures ``ends`` (2, 6) in rad keeps all clearances; no instrument."""
    frames, bodies = np.empty((len(machine.axes) + 1, 4, 4)), np.empty((len(machine.links) + 1, 7))
    frames[0] = base
    pair, instrument = np.empty(2, dtype=np.int64), np.zeros(7)
    count = int(np.ceil(np.abs(ends[1] - ends[0]).max() / step)) + 1
    for n in range(count + 1):
        angles = ends[0] + (ends[1] - ends[0]) * (n / count)
        away, _ = posture_margins(machine, world, trolley, instrument, angles, frames, bodies, pair, False)
        if away < world.needs[2]:
            return False
    return True


def _shortest(cost: FloatArray, start: int, group: list[int]) -> list[int]:
    """Return ``group`` in the order of least cost from ``start``: nearest first from every one, parts then reversed."""
    best: list[int] = []
    least = np.inf
    for first in group:
        order, left = [first], set(group) - {first}
        while left:
            nearest = min(left, key=lambda n: (cost[order[-1], n], n))
            order.append(nearest)
            left.remove(nearest)
        order = _reversed_parts(cost, start, order)
        total = _length(cost, start, order)
        if total < least:
            best, least = order, total
    return best


def _reversed_parts(cost: FloatArray, start: int, order: list[int]) -> list[int]:
    """Reverse or move parts of ``order`` as long as that shortens it."""
    length, better = _length(cost, start, order), True
    while better:
        better = False
        for a in range(len(order)):
            for b in range(a + 1, len(order) + 1):
                part, rest = order[a:b], order[:a] + order[b:]
                others = [order[:a] + part[::-1] + order[b:]]
                others += [rest[:c] + part + rest[c:] for c in range(len(rest) + 1)] if b - a <= 3 else []
                for other in others:
                    total = _length(cost, start, other)
                    if total < length - 1e-9:
                        order, length, better = other, total, True
                        break
                if better:
                    break
            if better:
                break
    return order


def _length(cost: FloatArray, start: int, order: list[int]) -> float:
    through = [start, *order]
    return float(sum(cost[a, b] for a, b in itertools.pairwise(through)))
