"""What an arm comes near to with what it carries, and what stands in the way of a tracker that looks at its tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.arm.links import place_links
from ronnaplan.robot.placement.clearances import clearance, seen, to_head
from ronnaplan.robot.placement.distances import segment_point
from ronnaplan.robot.placement.machine import Machine, place_bodies
from ronnaplan.robot.placement.placement import COARSE
from ronnaplan.robot.placement.room import Capsule, ToolMarker
from ronnaplan.robot.placement.search import Problem
from ronnaplan.robot.placement.world import VIEW_NEED
from tests.robot.placement.cases import CENTER_MM, job, room

AWAY_MM = 1500.0
POSTURE_RAD = np.radians([20.0, -80.0, 70.0, 30.0, 40.0, 10.0])
NO_TROLLEY = np.empty((0, 8))


def test_the_marker_is_not_seen_through_the_tool_that_carries_it() -> None:
    marker, carried = ToolMarker((0.0, 90.0, 60.0), (0.0, 1.0, -1.0), 75.0), room().tool.bodies
    problem, frames, bodies = _held_up(marker)
    machine = problem.machine
    bare = machine._replace(links=machine.links[: machine.tool_from])
    flange = frames[-1] @ kr6_r900().flange

    def is_seen(towards: FloatArray, of_which: Machine) -> bool:
        tracker = flange[:3, :3] @ (np.array(marker.at_mm) + AWAY_MM * towards) + flange[:3, 3]
        world = problem.world._replace(tracker=tracker)
        return bool(seen(of_which, world, NO_TROLLEY, frames[-1], bodies) >= world.needs[VIEW_NEED])

    towards = np.random.default_rng(0).normal(size=(1000, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    hidden = np.array([any(_is_met(np.array(marker.at_mm), one, body) for body in carried) for one in towards])
    without = np.array([is_seen(one, bare) for one in towards])
    assert (hidden & without).sum() > 20
    assert [is_seen(one, machine) for one in towards] == (without & ~hidden).tolist()


@pytest.mark.parametrize("link", [1, 2, 3])
def test_an_instrument_is_kept_from_the_links_that_carry_it(link: int) -> None:
    problem, _, bodies = _held_up()
    bodies[-1, :3] = bodies[-2, :3]
    bodies[-1, 3:6] = bodies[link, :3] + 0.3 * (bodies[link, 3:6] - bodies[link, :3])
    bodies[-1, 6] = 1.2
    pair = np.zeros(2, dtype=np.int64)
    assert clearance(problem.machine, problem.world, NO_TROLLEY, bodies, -np.inf, np.inf, pair) < 0.0
    assert pair[0] == len(bodies) - 1


def test_the_distance_from_the_head_is_that_of_its_nearest_ball() -> None:
    rng, world = np.random.default_rng(5), job(1, 1, 0).problem(COARSE).world
    assert 10 * len(world.gathered) < len(world.head)
    for start_mm, along_mm, radius in zip(
        CENTER_MM + rng.normal(0.0, 150.0, (300, 3)),
        rng.normal(0.0, 80.0, (300, 3)),
        rng.uniform(0.0, 40.0, 300),
        strict=True,
    ):
        capsule = np.array([*start_mm, *(start_mm + along_mm), radius])
        least = min(segment_point(capsule, ball) - ball[3] for ball in world.head) - radius
        assert to_head(world, capsule, np.inf) == pytest.approx(least, abs=1e-9)
        assert to_head(world, capsule, 20.0) == pytest.approx(min(least, 20.0), abs=1e-9)


def test_clearance_that_is_enough_is_told_as_what_is_enough() -> None:
    problem, _, bodies = _held_up()
    pair = np.zeros(2, dtype=np.int64)

    def near_mm(enough_mm: float) -> float:
        return clearance(problem.machine, problem.world, NO_TROLLEY, bodies, -np.inf, enough_mm, pair)

    away_mm = near_mm(np.inf)
    assert 20.0 < away_mm < np.inf
    assert near_mm(away_mm - 5.0) == away_mm - 5.0
    assert near_mm(away_mm + 5.0) == away_mm


def _held_up(marker: ToolMarker | None = None) -> tuple[Problem, FloatArray, FloatArray]:
    """Return an arm in an empty room, far from the head, with its links' frames and all bodies."""
    tool = replace(room().tool, marker=marker or room().tool.marker)
    problem = job(1, 1, 0, boxes=(), capsules=(), tool=tool).problem(COARSE)
    machine = problem.machine
    frames, bodies = np.zeros((7, 4, 4)), np.empty((len(machine.links) + 1, 7))
    frames[0] = np.eye(4)
    frames[0, :3, 3] = -3000.0, 0.0, 900.0
    place_links(machine.origins, machine.axes, POSTURE_RAD, frames)
    place_bodies(machine, np.zeros(7), frames, bodies)
    return problem, frames, bodies


def _is_met(start_mm: FloatArray, towards: FloatArray, body: Capsule) -> bool:
    """Whether a ray meets a capsule, by its places every 0.1 mm."""
    places = start_mm + np.arange(0.0, 300.0, 0.1)[:, None] * towards
    first, last = np.array(body.start_mm), np.array(body.end_mm)
    share = np.clip((places - first) @ (last - first) / ((last - first) @ (last - first)), 0.0, 1.0)
    return bool((np.linalg.norm(places - first - share[:, None] * (last - first), axis=1) < body.radius_mm).any())
