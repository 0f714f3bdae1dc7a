"""A base is worth what its worst task is, however little of the others is looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.robot.placement.judging import judge_base
from ronnaplan.robot.placement.placement import COARSE, FINE
from ronnaplan.robot.placement.search import base_pose, serves, worths
from tests.robot.placement.cases import job


@pytest.mark.parametrize("seed", [1, 3])
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


def test_who_looks_closely_at_a_base_tries_the_rolls_by_which_the_search_found_it() -> None:
    given, place = job(5022, 16, 8), np.array([[-812.0, -92.0, 917.0, 49.0]])
    (found,) = worths(given.problem(COARSE), place)
    assert found > 15.0
    assert worths(given.problem(replace(COARSE, rolls=FINE.rolls)), place) >= found
