"""Bases that serve most tasks, and steps from them to such as serve all, where the grid over the floor has none."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.judging import tasks_served
from ronnaplan.robot.placement.room import base_pose
from ronnaplan.robot.placement.search import ANY, SIDES, Problem, shared_out, within

LOOKED_AT = 300
"""Bases of which it is asked what each of them serves."""
CLIMBING = 6
"""So many of them, which serve most, are bettered."""
FIRST_STEP, LAST_STEP_MM = (100.0, 100.0, 100.0, 20.0), 5.0
"""Steps in x, y, z (mm) and turn (degrees) to begin with, and the least: tasks are lost and won within centimetres."""


class Climbed(NamedTuple):
    """Bases of which it was asked what they serve, and where steps from the best of them lead."""

    places: FloatArray
    """All of them (N, 4), those last to which steps lead."""
    served: NDArray[np.bool_]
    """Which tasks each serves (N, T)."""
    tops: FloatArray
    """Where steps lead (C, 4)."""


def served_each(problem: Problem, places: FloatArray, asked: int = 0) -> NDArray[np.bool_]:
    """Return which tasks each of ``places`` (N, 4) serves (N, T), whatever becomes of the others there.

    Of a place that serves fewer than are ``asked`` none is told: it is left as soon as that is known.
    """
    served = np.empty((len(places), len(problem)), dtype=np.bool_)

    def ask(rows: NDArray[np.int64]) -> None:
        order, chosen = np.arange(len(problem)), np.zeros((len(problem), 2), dtype=np.int64)
        for row in rows:
            base = base_pose(places[row])
            tasks_served(
                problem.machine, problem.world, problem.ways, base, order, chosen, asked, ANY, served[row]
            )

    shared_out(ask, len(places))
    return served


def serving_most(problem: Problem, places: FloatArray) -> Climbed:
    """Return some of ``places`` (N, 4), and where steps from the best of them lead.

    A base that serves all may lie in a few millimetres between those of a grid: what is left unserved about it shows
    the way there.
    """
    some = places[np.random.default_rng(0).permutation(len(places))[:LOOKED_AT]]
    each = served_each(problem, some)
    best = np.argsort(-each.sum(axis=1), kind="stable")[:CLIMBING]
    climbed = [_climbed(problem, some[n], each[n]) for n in best]
    tops, served = (np.array(one) for one in zip(*climbed, strict=True))
    return Climbed(np.concatenate([some, tops]), np.concatenate([each, served]), tops)


def _climbed(
    problem: Problem, place: FloatArray, served: NDArray[np.bool_]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return a place (4,) beside ``place`` that serves more tasks than any to its sides, and which (T,)."""
    step = np.array(FIRST_STEP)
    while step[0] >= LAST_STEP_MM and not served.all():
        tried = within(problem.floor, place + SIDES * step)
        each = served_each(problem, tried, asked=int(served.sum()) + 1)
        counts = each.sum(axis=1)
        if counts.max(initial=0) > served.sum():
            place, served = tried[counts.argmax()], each[counts.argmax()]
        else:
            step = step / 2
    return place, served
