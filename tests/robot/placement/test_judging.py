"""A base is worth what its worst task is, however little of the others is looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.robot.placement import tasks
from ronnaplan.robot.placement.judging import judge_base
from ronnaplan.robot.placement.parking import probability, strayed
from ronnaplan.robot.placement.placement import CLOSER, COARSE, FINE
from ronnaplan.robot.placement.room import Box, Capsule, ToolMarker
from ronnaplan.robot.placement.search import base_pose, serves, worths
from ronnaplan.robot.placement.tasks import view_task
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
    for place, each in zip(places, worth, strict=True):
        judge_base(
            problem.machine,
            problem.world,
            problem.ways,
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
