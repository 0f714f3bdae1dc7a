"""How near what the flange carries comes to the wrist, from which it is only kept from overlapping.

What of it is apart from the wrist in any posture is looked at on all ways that were found, and told where it comes
nearer than the room asks for.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from math import floor

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.machine import APART, Machine, carried_distances
from ronnaplan.robot.placement.route import STEP_DEG

Passage = tuple[str, FloatArray]
"""Where on the route it is, and the postures (P, 6), in degrees, between which all joints turn evenly."""


def what_comes_near(
    machine: Machine, passages: Sequence[Passage], names: Sequence[str], least_mm: float
) -> tuple[str, ...]:
    """Return a sentence for each body of the tool and of the wrist that come nearer than ``least_mm`` on ``passages``.

    Those that are near in every posture are left out: so they are drawn. Bodies have ``names`` (K,).
    """
    least = np.where(machine.kept[machine.tool_from : -1, : machine.tool_from] == APART, least_mm, -np.inf)
    where = np.full(least.shape, -1)
    for number, (_, postures_deg) in enumerate(passages):
        here = nearest_mm(machine, postures_deg)
        where[here < least] = number
        least = np.minimum(here, least)
    # The ways were found free by other postures between the same ones: half a mm less than none is none.
    return tuple(
        f"{names[machine.tool_from + k]} comes within {max(floor(least[k, j]), 0)} mm of {names[j]} "
        f"{passages[where[k, j]][0]}: the two are only kept from overlapping"
        for k, j in np.argwhere(where >= 0).tolist()
    )


def nearest_mm(machine: Machine, postures_deg: FloatArray) -> FloatArray:
    """Return how near each body of the tool comes to each of the arm (T, A) on the way by ``postures_deg`` (P, 6)."""
    corners = np.radians(postures_deg)
    counts = [int(np.ceil(np.abs(b - a).max() / np.radians(STEP_DEG))) for a, b in itertools.pairwise(corners)]
    parts = [
        a + (b - a) * (np.arange(count) / max(count, 1))[:, np.newaxis]
        for (a, b), count in zip(itertools.pairwise(corners), counts, strict=True)
    ]
    tool, postures = machine.bodies[machine.tool_from :], np.concatenate([*parts, corners[-1:]])
    nearest: FloatArray = carried_distances(machine, tool, postures).min(axis=0)
    return nearest
