"""A base is worth what its worst task is, however little of the others is looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.geometry import unit
from ronnaplan.robot.placement import tasks
from ronnaplan.robot.placement.at_best import ROUNDING
from ronnaplan.robot.placement.judging import judge_base
from ronnaplan.robot.placement.most import served_each
from ronnaplan.robot.placement.parking import probability, strayed
from ronnaplan.robot.placement.placement import CLOSER, COARSE, FINE
from ronnaplan.robot.placement.room import Box, Capsule, ToolMarker, base_pose
from ronnaplan.robot.placement.search import serves, worths
from ronnaplan.robot.placement.tasks import view_task
from ronnaplan.robot.placement.world import CLEARANCE_NEED, VIEW_NEED
from tests.long import few_and_others
from tests.robot.placement.cases import CENTER_MM, job, room

NO_CAMERAS = replace(
    room().tool,
    bodies=room().tool.bodies[:1],
    marker=ToolMarker((0.0, 90.0, 60.0), (0.0, 1.0, -1.0), 75.0),
)
"""A tool that hides nothing of its marker."""


@few_and_others("seed", [1], [3])
def test_what_saves_time_changes_no_worth(seed: int) -> None:
    problem, rng = job(seed, 4, 2).problem(COARSE), np.random.default_rng(seed)
    places = rng.uniform([-900.0, -800.0, 850.0, 20.0], [-500.0, -300.0, 1000.0, 70.0], (60, 4))
    worth, chosen = np.empty((len(places), len(problem))), np.zeros((len(problem), 2), dtype=np.int64)
    order = np.arange(len(problem))
    every_way = problem.ways._replace(kept=np.full_like(problem.ways.kept, np.inf))
    for place, each in zip(places, worth, strict=True):
        judge_base(
            problem.machine,
            problem.world,
            every_way,
            base_pose(place),
            order,
            True,
            each,
            chosen,
            0.0,
            np.inf,
        )
    least = worth.min(axis=1)
    assert 5 < (least >= 0.0).sum() < 55
    found = worths(problem, places)
    np.testing.assert_array_equal(found[least >= 0.0], least[least >= 0.0])
    assert (found[least < 0.0] < 0.0).all()
    assert (serves(problem, places) == (least >= 0.0)).all()
    is_served = worth >= 0.0
    np.testing.assert_array_equal(served_each(problem, places), is_served)
    serves_five = is_served.sum(axis=1) >= 5
    assert 5 < serves_five.sum() < 55
    np.testing.assert_array_equal(served_each(problem, places, asked=5), is_served & serves_five[:, None])


def test_what_a_way_keeps_at_best_is_what_tool_and_marker_keep_there() -> None:
    """By points along the tool's bodies, a plate over the head, and the angle at which the tracker sees the marker."""
    plate = Box("plate", (-150.0, 0.0, 1230.0), (60.0, 300.0, 20.0))
    given = job(3, 12, 0, boxes=(plate,), capsules=())
    problem, tool = given.problem(replace(COARSE, step_mm=1000.0)), given.room.tool
    ways, need, shares = problem.ways, problem.world.needs, np.linspace(0.0, 1.0, 2001)[:, None]
    assert tool.marker is not None
    aside, away = np.full((2, len(ways.flanges)), np.inf)
    for p in range(2):
        turn, place = ways.flanges[:, p, :3, :3], ways.flanges[:, p, :3, 3]
        to_tracker = problem.world.tracker - turn @ np.array(tool.marker.at_mm) - place
        cosine = np.einsum("ni,ni->n", turn @ unit(tool.marker.normal), to_tracker)
        cosine /= np.linalg.norm(to_tracker, axis=1)
        aside = np.minimum(aside, np.radians(tool.marker.seen_deg) - np.arccos(cosine))
        for body in tool.bodies:
            points = np.array(body.start_mm) + shares * np.subtract(body.end_mm, body.start_mm)
            placed = points @ turn.swapaxes(1, 2) + place[:, None]
            beyond = np.maximum(np.abs(placed - plate.center_mm) - np.array(plate.size_mm) / 2, 0.0)
            away = np.minimum(away, np.linalg.norm(beyond, axis=-1).min(axis=1) - body.radius_mm)
    is_seen = ways.kept[:, 1] >= need[VIEW_NEED]
    near = is_seen & (away < need[CLEARANCE_NEED])
    assert 10 < near.sum() < is_seen.sum() < len(is_seen) - 10
    is_free = is_seen & (ways.kept[:, 0] >= need[CLEARANCE_NEED])
    assert 10 < is_free.sum() < is_seen.sum()
    assert not (near & is_free).any()
    np.testing.assert_allclose(ways.kept[is_free, 1], aside[is_free], atol=2 * ROUNDING)
    assert (ways.kept[is_free, 0] < away[is_free] + 0.01).all()


def test_the_probability_that_is_told_is_no_less_for_want_of_sides_to_view_from(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A marker beside the ear, a pole and a screen: from six sides it is hardly seen where the base stands askew."""
    given = job(
        1,
        1,
        0,
        tool=NO_CAMERAS,
        boxes=(*room().boxes, Box("screen", (198.0, 0.0, 1300.0), (20.0, 900.0, 400.0))),
        capsules=(*room().capsules, Capsule("pole", (-78.0, 409.0, 900.0), (-78.0, 409.0, 1700.0), 25.0)),
    )
    place, ear_mm = np.array([-853.0, -200.0, 900.0, 36.5]), np.array([-27.3, 87.4, 1045.1])

    def told() -> float:
        view = [view_task("M", ear_mm, CENTER_MM, given.room.camera)]
        problem, closer = given.problem(COARSE, view), given.problem(CLOSER, view)
        return probability(problem, closer, place, given.room.parking, samples=256)

    found = told()
    monkeypatch.setattr(tasks, "SIDES", 6 * 16)
    assert found > told() - 0.02
    monkeypatch.setattr(tasks, "SIDES", 6)
    assert found > told() + 0.05


def test_the_probability_that_is_told_is_that_of_serving_as_is_looked_at_after_parking() -> None:
    """Of a trajectory that few rolls serve: those of the search miss it from three places in ten."""
    given, place = job(730007, 16, 8), np.array([-763.3, -200.0, 800.8, 91.5])
    search, closer, after = (given.problem(one, given.tasks[3:4]) for one in (COARSE, CLOSER, FINE))
    told = probability(search, closer, place, given.room.parking, samples=64)
    assert told == serves(after, strayed(place, given.room.parking, 64)).mean()


def test_who_looks_closely_at_a_base_tries_the_rolls_by_which_the_search_found_it() -> None:
    given, place = job(5022, 16, 8, tool=NO_CAMERAS), np.array([[-812.0, -92.0, 917.0, 49.0]])
    (found,) = worths(given.problem(COARSE), place)
    assert found > 15.0
    assert worths(given.problem(replace(COARSE, rolls=FINE.rolls)), place) >= found
