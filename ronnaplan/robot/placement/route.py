"""The order in which the arm moves least, by ways that are free.

A move is straight in the joints; where that is not free it goes by the reference posture. What a move counts is the
turn of the joint that turns most, in degrees, as for joints of one speed. A posture may be taken with whole turns of
its joints, as far as their limits allow: the same for the links, another for the moves to it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.clearances import posture_margins, standing_on
from ronnaplan.robot.placement.machine import Machine
from ronnaplan.robot.placement.order import LESS, cheapest, shortest
from ronnaplan.robot.placement.search import Problem
from ronnaplan.robot.placement.serving import Served, served_by_each
from ronnaplan.robot.placement.world import CLEARANCE_NEED, World

STEP_DEG = 2.0
"""Postures on a move are looked at this closely."""
MOST_TURNS = 64
"""So many whole turns of a posture are tried, those nearest to the reference: all that six joints of two turns have."""

Corner = tuple[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Route:
    """The tasks in order, from and to the ``reference_deg`` (6,) posture; ``by_reference`` names those reached by it.

    ``stuck`` names tasks to which no free way was found. It goes straight from each of its ``corners`` to the next:
    what is there, and the posture (6,) in degrees.
    """

    order: tuple[str, ...]
    travel_deg: float
    by_reference: tuple[str, ...]
    stuck: tuple[str, ...]
    reference_deg: FloatArray
    corners: tuple[Corner, ...]


@dataclass(frozen=True, eq=False)
class _Moves:
    """What moves at one base count (degrees), by or without the ``reference`` (6,); each is looked at once."""

    problem: Problem
    base: FloatArray
    reference: FloatArray
    known: dict[tuple[bytes, bytes], float] = field(default_factory=dict)

    def direct(self, a: FloatArray, b: FloatArray) -> float:
        """Return what the straight move between two postures (6,) counts; infinite where it is not free."""
        key = (a.tobytes(), b.tobytes())
        if key not in self.known:
            machine, world = self.problem.machine, self.problem.world
            free = is_free(machine, world, self.base, np.radians([a, b]), np.radians(STEP_DEG))
            self.known[key] = self.known[key[::-1]] = _farthest_turn_deg(a, b) if free else np.inf
        return self.known[key]

    def by_reference(self, a: FloatArray, b: FloatArray) -> float:
        """Return what the move between angles (6,), degrees, counts by way of the reference."""
        return self.direct(self.reference, a) + self.direct(self.reference, b)

    def least(self, a: FloatArray, b: FloatArray) -> float:
        """Return what the better of both ways between angles (6,), degrees, counts."""
        around = self.by_reference(a, b)
        return around if _farthest_turn_deg(a, b) > around else min(self.direct(a, b), around)


@dataclass(frozen=True, eq=False)
class _Tour:
    """An ``order`` of the tasks from and to the reference, the turn that each is taken ``at``, and its length."""

    order: tuple[int, ...]
    at: tuple[int, ...]
    length: float


def plan_route(
    problem: Problem, base: FloatArray, served: Sequence[Served], reference_deg: FloatArray
) -> tuple[Route, tuple[Served, ...]]:
    """Return the way through all ``served``: the markers first, then the trajectories, each from its own beginning.

    With it come the ``served``, in the order of the ``problem``, by the whole turns that the way takes them with; the
    least margin of all of them stays. One that no free move reaches is taken by the best of its ways that one does.
    """
    reference = _reference(problem, served, reference_deg)
    moves = _Moves(problem, base, reference)
    served, turned = _with_turns(moves, served)
    stuck = [n for n, choices in enumerate(turned) if not len(choices)]
    groups = [
        [n for n, one in enumerate(served) if one.kind == kind and n not in stuck]
        for kind in ("marker", "trajectory")
    ]
    own = [one.angles_deg[0] for one in served]
    starts = [
        [_nearest(choices, to) for choices, to in zip(turned, near, strict=True)]
        for near in (own, [reference] * len(own))
    ]
    tour = min((_tour(moves, turned, groups, start) for start in starts), key=lambda found: round(found.length, 6))
    postures = [
        choices[at] if len(choices) else first for choices, at, first in zip(turned, tour.at, own, strict=True)
    ]
    around = [
        b
        for a, b in itertools.pairwise(tour.order)
        if moves.by_reference(postures[a], postures[b]) < moves.direct(postures[a], postures[b])
    ]
    rest = ("the reference posture", reference)
    corners = [rest]
    for n in tour.order:
        corners += [*([rest] if n in around else []), (served[n].name, postures[n])]
    if tour.order:
        corners.append(rest)
    route = Route(
        tuple(served[n].name for n in tour.order),
        tour.length,
        tuple(served[n].name for n in around),
        tuple(served[n].name for n in stuck),
        reference,
        tuple(corners),
    )
    return route, tuple(_shifted(problem, one, to) for one, to in zip(served, postures, strict=True))


def _reference(problem: Problem, served: Sequence[Served], reference_deg: FloatArray) -> FloatArray:
    """Return the reference with joint 1 before the tasks' middle, those of another turn taken with the turn near it."""
    reference: FloatArray = np.array(reference_deg, dtype=np.float64)
    limits = np.degrees(problem.machine.wrist.limits[0])
    if served:
        firsts = np.array([one.angles_deg[0, 0] for one in served])
        along = np.radians(firsts)
        middle = float(np.degrees(np.arctan2(np.sin(along).sum(), np.cos(along).sum())))
        near = firsts + 360.0 * np.round((middle - firsts) / 360.0)
        within = (near >= limits[0]) & (near <= limits[1])
        reference[0] += float(np.median(np.where(within, near, firsts)))
    reference[0] = np.clip(reference[0], *limits)
    return reference


def _with_turns(moves: _Moves, served: Sequence[Served]) -> tuple[list[Served], list[FloatArray]]:
    """Return the tasks, and the turns (T, 6) by which the reference reaches each, of one that is stuck none.

    None is taken by another of its ways where the reference itself is not free, as no way leads from it.
    """
    least_deg = min((one.joint_deg for one in served), default=0.0)
    may_leave = np.isfinite(moves.direct(moves.reference, moves.reference))

    def with_turns(number: int, best: Served) -> tuple[Served, FloatArray]:
        others = served_by_each(moves.problem, best, number, moves.base) if may_leave else ()
        for one in itertools.chain([best], others):
            found = _reached(moves, _turns(moves.problem, one, min(least_deg, one.joint_deg)))
            if len(found):
                return one, found
        return best, np.empty((0, 6))

    taken = [with_turns(n, one) for n, one in enumerate(served)]
    return [one for one, _ in taken], [found for _, found in taken]


def _turns(problem: Problem, one: Served, least_deg: float) -> FloatArray:
    """Return the first posture with all whole turns (T, 6) by which all the way keeps ``least_deg`` from limits."""
    limits = np.degrees(problem.machine.wrist.limits)
    low, high = one.angles_deg.min(axis=0) - least_deg, one.angles_deg.max(axis=0) + least_deg
    firsts = np.minimum(np.ceil((limits[:, 0] - low - LESS) / 360.0), 0.0)
    lasts = np.maximum(np.floor((limits[:, 1] - high + LESS) / 360.0), 0.0)
    each = [np.arange(first, last + 1) for first, last in zip(firsts, lasts, strict=True)]
    found: FloatArray = one.angles_deg[0] + 360.0 * np.array(list(itertools.product(*each)))
    return found


def _reached(moves: _Moves, postures: FloatArray) -> FloatArray:
    """Return those of ``postures`` (T, 6) that the reference reaches by a free move, the nearest first."""
    order = np.argsort(np.abs(postures - moves.reference).max(axis=1), kind="stable")[:MOST_TURNS]
    free = [n for n in order.tolist() if np.isfinite(moves.direct(moves.reference, postures[n]))]
    return postures[free]


def _nearest(choices: FloatArray, to: FloatArray) -> int:
    return int(np.abs(choices - to).sum(axis=1).argmin()) if len(choices) else 0


def _shifted(problem: Problem, one: Served, first: FloatArray) -> Served:
    """Return ``one`` with the whole turns that its ``first`` posture (6,) has, all along its way."""
    if (first == one.angles_deg[0]).all():
        return one
    angles = one.angles_deg + (first - one.angles_deg[0])
    limits = np.degrees(problem.machine.wrist.limits)
    margin = float(np.minimum(angles - limits[:, 0], limits[:, 1] - angles).min())
    return replace(one, angles_deg=angles, joint_deg=margin)


def _tour(moves: _Moves, turned: Sequence[FloatArray], groups: Sequence[list[int]], start: Sequence[int]) -> _Tour:
    """Return the way through all ``groups``, its turns and its order bettered by turns as long as that shortens it."""
    tour = _in_order(moves, turned, groups, tuple(start))
    while True:
        at = _best_turns(moves, turned, tour)
        kept = _Tour(tour.order, at, _through(moves, turned, tour.order, at))
        again = _in_order(moves, turned, groups, at)
        if again.length >= kept.length - LESS:
            return kept
        tour = again


def _in_order(
    moves: _Moves, turned: Sequence[FloatArray], groups: Sequence[list[int]], at: tuple[int, ...]
) -> _Tour:
    """Return the tasks of the ``groups`` in the order of least cost, each taken by the turn that it is ``at``."""
    cost = np.zeros((len(turned) + 1, len(turned) + 1))
    members = [n for group in groups for n in group]
    postures = {-1: moves.reference, **{n: turned[n][at[n]] for n in members}}
    for a, b in itertools.combinations(postures, 2):
        cost[a + 1, b + 1] = cost[b + 1, a + 1] = moves.least(postures[a], postures[b])
    order: list[int] = []
    for group in groups:
        order += shortest(cost, order[-1] if order else 0, [n + 1 for n in group])
    found = tuple(n - 1 for n in order)
    return _Tour(found, at, _through(moves, turned, found, at))


def _best_turns(moves: _Moves, turned: Sequence[FloatArray], tour: _Tour) -> tuple[int, ...]:
    """Return the turns by which the tour is shortest in its order.

    All straight moves are taken for free first, then those of the shortest way are looked at, until all of them are.
    """
    layers = [moves.reference[None], *(turned[n] for n in tour.order), moves.reference[None]]
    around = [np.abs(layer - moves.reference).max(axis=1) for layer in layers]
    costs = [
        np.minimum(np.abs(a[:, None] - b).max(axis=-1), to_a[:, None] + to_b)
        for (a, b), (to_a, to_b) in zip(itertools.pairwise(layers), itertools.pairwise(around), strict=True)
    ]
    while True:
        way = cheapest(costs)
        longer = False
        for k, (a, b) in enumerate(itertools.pairwise(way)):
            least = moves.least(layers[k][a], layers[k + 1][b])
            longer |= least > costs[k][a, b] + LESS
            costs[k][a, b] = least
        if not longer:
            break
    at = list(tour.at)
    for n, choice in zip(tour.order, way[1:-1], strict=True):
        at[n] = choice
    return tuple(at)


def _through(moves: _Moves, turned: Sequence[FloatArray], order: Sequence[int], at: Sequence[int]) -> float:
    """Return the length of the way from the reference through all of ``order`` and back; of none nothing moves."""
    if not order:
        return 0.0
    postures = [moves.reference, *(turned[n][at[n]] for n in order), moves.reference]
    return float(sum(moves.least(a, b) for a, b in itertools.pairwise(postures)))


def _farthest_turn_deg(a: FloatArray, b: FloatArray) -> float:
    return float(np.abs(a - b).max())


@njit(cache=True, nogil=True, error_model="numpy")
def is_free(machine: Machine, world: World, base: FloatArray, ends: FloatArray, step: float) -> bool:
    """Whether the straight move between the postures ``ends`` (2, 6) in rad keeps all clearances; no instrument."""
    standing, instrument, need = standing_on(machine, base), np.zeros(7), world.needs[CLEARANCE_NEED]
    count = int(np.ceil(np.abs(ends[1] - ends[0]).max() / step)) + 1
    for n in range(count + 1):
        angles = ends[0] + (ends[1] - ends[0]) * (n / count)
        away, _ = posture_margins(machine, world, standing, instrument, angles, need, False)
        if away < need:
            return False
    return True
