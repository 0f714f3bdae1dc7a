"""Names of trajectories and depths are written within the pane, and none on another."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ronnaplan.planner.names import EM_PIXELS, LINE_EM, write_names
from ronnaplan.planner.over_cut import over_cut
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.state import PlannerState
from tests import cases

PANE = Pane(400.0, 200.0)
"""Wider than high: in halves of the shorter side, two to the right and one down."""

LINE = LINE_EM * 2 * EM_PIXELS / 200.0


def written(*paths: tuple[str, float, float], marker: tuple[float, float] | None = None) -> list[dict[str, Any]]:
    """Where the names of paths (name and entry) are written."""
    markers = [] if marker is None else [{"label": "F1", "x": marker[0], "y": marker[1], "r": 0.0}]
    named = write_names([{"name": name, "entry": [x, y]} for name, x, y in paths], markers, PANE, 1.0)
    return [one["written"] for one in named]


def test_a_name_stands_to_the_right_of_its_entry_and_to_the_left_where_the_pane_ends() -> None:
    right, left = written(("STN", 0.0, 0.0), ("hippocampus", 1.5, 0.5))
    assert (right["anchor"], left["anchor"]) == ("start", "end")
    assert 0.0 < right["x"] < 0.1
    assert 1.4 < left["x"] < 1.5


def test_a_name_that_fits_on_neither_side_begins_within_the_pane() -> None:
    (one,) = written(("a name that is longer than this pane is wide, as nobody would give it", 0.0, 0.0))
    assert one["anchor"] == "start"
    assert one["x"] == -2.0


def test_no_name_covers_another_nor_that_of_a_marker() -> None:
    first, second, third = written(("left", 0.0, 0.0), ("right", 0.05, 0.02), ("far", 0.0, 0.6))
    assert second["y"] == pytest.approx(first["y"] + 0.02 + LINE)
    assert third["y"] == pytest.approx(first["y"] + 0.6)
    (beside_a_marker,) = written(("left", 0.0, 0.0), marker=(0.05, 0.0))
    assert beside_a_marker["y"] == pytest.approx(first["y"] - LINE)


def test_a_name_at_the_upper_edge_is_whole() -> None:
    (one,) = written(("left", 0.0, -0.99))
    assert one["y"] == pytest.approx(2 * EM_PIXELS / 200.0 - 1.0)


def test_the_name_of_an_entry_outside_goes_with_it() -> None:
    (one,) = written(("left", 2.5, 0.0))
    assert one["x"] > 2.5


def test_both_sides_of_a_plan_are_told_apart_in_a_sagittal_cut(state: PlannerState) -> None:
    left, mirrored = state.case.plan.trajectory("left"), np.array([-1.0, 1.0, 1.0])
    state.case.add(
        replace(left, name="right", entry_mm=left.entry_mm * mirrored, target_mm=left.target_mm * mirrored)
    )
    above, below = (one["written"] for one in over_cut(state, "sagittal", False, Pane())["paths"])
    assert above["x"] == below["x"]
    assert below["y"] > above["y"] + 1.0


def lie_across(state: PlannerState) -> None:
    """Lay the path to the left, through the target's axial cut, which is shown."""
    state.case.edit("left", entry_mm=cases.TARGET_MM + np.array([55.0, 0.0, 0.0]))
    state.look.select("left")
    state.look.jump(cases.TARGET_MM)


def told(state: PlannerState, view: str, side: float) -> list[dict[str, Any]]:
    """The depths that are told along the path in a view of so many pixels a side."""
    (path,) = over_cut(state, view, False, Pane(side, side))["paths"]
    return [tick for tick in path["ticks"] if tick["label"]]


def test_depths_stand_below_a_path_across_and_to_the_left_of_one_upwards(state: PlannerState) -> None:
    lie_across(state)
    across = told(state, "axial", 1000.0)
    assert {one["anchor"] for one in across} == {"middle"}
    assert all(one["at"][1] > max(end[1] for end in one["ends"]) for one in across)
    upwards = told(state, "inline", 1000.0)
    assert {one["anchor"] for one in upwards} == {"end"}
    assert all(one["at"][0] < min(end[0] for end in one["ends"]) for one in upwards)


def test_depths_are_told_as_often_as_there_is_room(state: PlannerState) -> None:
    lie_across(state)
    wide, narrow = told(state, "axial", 1000.0), told(state, "axial", 250.0)
    assert [one["label"] for one in wide] == ["10", "20", "30", "40", "50"]
    assert [one["label"] for one in narrow] == ["50"]
