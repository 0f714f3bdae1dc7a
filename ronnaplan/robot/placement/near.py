"""How near what the flange carries comes to the wrist, from which it is not kept apart.

Capsules of links that few joints part may overlap in every posture, so that no search can keep them apart. Of the arm
itself the maker's limits or its controller do, but neither knows the tool. So what of that is apart from the wrist in
any posture is looked at on all ways that were found, and told where it comes nearer than the room asks for.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.compiled import place_links
from ronnaplan.robot.placement.clearances import APART_LINKS, place_bodies
from ronnaplan.robot.placement.distances import segment_segment
from ronnaplan.robot.placement.route import STEP_DEG
from ronnaplan.robot.placement.world import Machine

SAMPLED = 512
"""In so many postures between the limits of the joints two bodies are apart in one, if ever: two joints part them."""

Way = tuple[str, FloatArray]
"""Where on the route it is, and the postures (P, 6), in degrees, between which all joints turn evenly."""


def what_comes_near(
    machine: Machine, ways: Sequence[Way], names: Sequence[str], least_mm: float
) -> tuple[str, ...]:
    """Return a sentence for each body of the tool and of the wrist that come nearer than ``least_mm`` on the ways.

    Those that are as near in every posture are left out: so they are drawn. Bodies have ``names`` (K,).
    """
    of_wrist = machine.links[machine.tool_from :, np.newaxis] - machine.links[: machine.tool_from] < APART_LINKS
    low, high = machine.wrist.limits.T
    postures = np.random.default_rng(0).uniform(low, high, (SAMPLED, len(low)))
    least = np.where(of_wrist & (_distances(machine, postures).max(axis=0) >= least_mm), least_mm, -np.inf)
    where = np.full(least.shape, -1)
    for number, (_, postures_deg) in enumerate(ways):
        here = nearest_mm(machine, postures_deg)
        where[here < least] = number
        least = np.minimum(here, least)
    return tuple(
        f"{names[machine.tool_from + k]} and {names[j]} {_apart(least[k, j])} {ways[where[k, j]][0]}, where nothing "
        "keeps them apart"
        for k, j in np.argwhere(where >= 0).tolist()
    )


def _apart(left_mm: float) -> str:
    if abs(left_mm) < 0.5:
        return "touch"
    return f"are {left_mm:.0f} mm apart" if left_mm > 0.0 else f"overlap by {-left_mm:.0f} mm"


def nearest_mm(machine: Machine, postures_deg: FloatArray) -> FloatArray:
    """Return how near each body of the tool comes to each of the arm (T, A) on the way by ``postures_deg`` (P, 6)."""
    corners = np.radians(postures_deg)
    counts = [int(np.ceil(np.abs(b - a).max() / np.radians(STEP_DEG))) for a, b in itertools.pairwise(corners)]
    parts = [
        a + (b - a) * (np.arange(count) / max(count, 1))[:, np.newaxis]
        for (a, b), count in zip(itertools.pairwise(corners), counts, strict=True)
    ]
    nearest: FloatArray = _distances(machine, np.concatenate([*parts, corners[-1:]])).min(axis=0)
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def _distances(machine: Machine, postures: FloatArray) -> FloatArray:
    """Return the distances (P, T, A) of the tool's bodies from the arm's in ``postures`` (P, 6), rad."""
    first, count = machine.tool_from, len(machine.links)
    frames, bodies = np.zeros((len(machine.axes) + 1, 4, 4)), np.empty((count + 1, 7))
    for a in range(4):
        frames[0, a, a] = 1.0
    apart = np.empty((len(postures), count - first, first))
    for p in range(len(postures)):
        place_links(machine.origins, machine.axes, postures[p], frames)
        place_bodies(machine, np.zeros(7), frames, bodies)
        for k in range(first, count):
            for j in range(first):
                apart[p, k - first, j] = segment_segment(bodies[k], bodies[j]) - bodies[k, 6] - bodies[j, 6]
    return apart
