"""What a plan makes of the trajectories it is given."""

from __future__ import annotations

import numpy as np

from ronnaplan.ct.volume import SeriesSource
from ronnaplan.planning import Plan, Trajectory
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
