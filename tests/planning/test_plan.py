"""What a plan makes of the trajectories it is given."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.ct.volume import SeriesSource
from ronnaplan.errors import InputError
from ronnaplan.planning import Plan, Ruler, Trajectory
from ronnaplan.planning.trajectory import COLOURS


def path(name: str, colour: str = "") -> Trajectory:
    return Trajectory(name, np.array([0.0, 0, 80]), np.array([0.0, 0, 10]), colour=colour)


def test_trajectories_without_a_colour_get_one_each_and_keep_it() -> None:
    plan = Plan(SeriesSource(), None, (path("A"), path("B", COLOURS[0])))
    plan = plan.add(path("C")).edit("A", notes="kept")
    assert [one.colour for one in plan] == [COLOURS[0], COLOURS[0], COLOURS[2]]
    assert [one.colour for one in plan.remove("A")] == [COLOURS[0], COLOURS[2]]
    assert [one.colour for one in plan.undo().undo().redo()] == [COLOURS[0], COLOURS[0], COLOURS[2]]
    assert plan.edit("B", colour="").trajectory("B").colour == COLOURS[1]


def test_a_measurement_that_is_not_there_is_refused_by_the_names_of_those_that_are() -> None:
    plan = Plan(SeriesSource()).add_ruler(Ruler("D1", np.array([[0.0, 0, 0], [3.0, 4, 0]])))
    assert plan.ruler("D1") is plan.rulers[0]
    for ask in (plan.ruler, plan.remove_ruler):
        with pytest.raises(InputError, match=r"no measurement 'D2'; it has D1"):
            ask("D2")
    assert plan.remove_ruler("D1").rulers == ()


@pytest.mark.parametrize("name", ["left HC ", " left HC", "left  HC"])
def test_a_name_that_differs_from_another_by_blanks_only_is_refused(name: str) -> None:
    plan = Plan(SeriesSource(), None, (path("left HC"), path("B")))
    with pytest.raises(InputError, match=r"already has a trajectory 'left HC'; choose another name"):
        plan.add(path(name))
    with pytest.raises(InputError, match=r"already has a trajectory 'left HC'; choose another name"):
        plan.edit("B", name=name)
    assert plan.edit("left HC", name=name).trajectory(name).name == name
    kept = Plan(SeriesSource(), None, (path("left HC"), path(name)))  # of an earlier version
    assert kept.edit(name, notes="kept").trajectory(name).notes == "kept"
