"""Names of trajectories and depths are written where there is room for them in a view."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ronnaplan.documents.plan import write_plan
from ronnaplan.planner.over_cut import over_cut
from ronnaplan.planner.panes import TITLE_EM, Pane
from ronnaplan.planner.state import PlannerState
from tests import cases


def test_both_sides_of_a_plan_are_told_apart_in_a_sagittal_cut(state: PlannerState) -> None:
    left, mirrored = state.case.plan.trajectory("left"), np.array([-1.0, 1.0, 1.0])
    state.case.add(
        replace(left, name="right", entry_mm=left.entry_mm * mirrored, target_mm=left.target_mm * mirrored)
    )
    drawn = {one["name"]: one["written"] for one in over_cut(state, "sagittal", False, Pane())["paths"]}
    assert drawn["left"]["x"] == drawn["right"]["x"]
    assert drawn["right"]["y"] > drawn["left"]["y"] + 1.0


@pytest.mark.parametrize("selected", ["left", "beside"])
def test_the_selected_trajectory_is_drawn_over_all_others_and_named_first(
    state: PlannerState, selected: str
) -> None:
    """Its depths would be covered by other names else."""
    left = state.case.plan.trajectory("left")
    alone = over_cut(state, "coronal", False, Pane())["paths"][0]["written"]
    state.case.add(replace(left, name="beside"))
    state.look.select(selected)
    drawn = over_cut(state, "coronal", False, Pane())["paths"]
    assert [one["selected"] for one in drawn] == [False, True]
    assert drawn[-1]["name"] == selected
    assert (drawn[-1]["written"]["x"], drawn[-1]["written"]["y"]) == (alone["x"], alone["y"])


def test_the_selected_trajectory_is_named_where_markers_leave_no_room(state: PlannerState) -> None:
    left = state.case.plan.trajectory("left")
    one, (x, y, z) = state.case.found.fiducials[0], left.entry_mm.tolist()
    crowd = tuple(
        one.model_copy(update={"label": f"M{n} at the entry", "center": (x, y, z + 0.7 * n), "diameter_mm": 2.0})
        for n in range(-30, 30)
    )
    state.case.replace_markers(state.case.found.model_copy(update={"fiducials": crowd}))
    state.look.jump(left.entry_mm)
    for selected in ("left", "beside"):
        if selected == "beside":
            state.case.add(replace(left, name="beside"))
        state.look.select(selected)
        drawn = over_cut(state, "coronal", False, Pane())["paths"]
        assert drawn[-1]["written"]["text"] == selected


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


def test_a_path_of_hundreds_of_metres_has_no_more_depths_than_are_seen(state: PlannerState) -> None:
    """As a file may hold: all of them took the page half a minute."""
    lie_across(state)
    plan = state.case.plan.edit("left", entry_mm=cases.TARGET_MM + np.array([90_000.0, 0.0, 0.0]))
    write_plan(state.storage.plan, plan)
    assert state.case.look_again()
    state.look.select("left")
    for view in ("axial", "inline"):
        (path,) = over_cut(state, view, False, Pane())["paths"]
        assert len(path["ticks"]) < 100, view
    assert [one["label"] for one in told(state, "axial", 1000.0)][:5] == ["10", "20", "30", "40", "50"]


def test_no_name_stands_on_a_depth(state: PlannerState) -> None:
    """Neither could be read there."""
    left = state.case.plan.trajectory("left")
    for number, share in enumerate((0.35, 0.45, 0.55, 0.65)):
        for side in (-32.0, 32.0):  # so far from it that some names have room towards it only
            beside = left.entry_mm + share * (left.target_mm - left.entry_mm) + np.array([side, 0.0, 0.0])
            state.case.add(
                replace(left, name=f"approach number {number}, {side:+.0f} mm beside it", entry_mm=beside)
            )
    state.look.select("left")
    pane = Pane(350.0, 350.0)
    drawn = over_cut(state, "inline", False, pane)
    room = pane.room(drawn["half"])
    depths = [
        room.box(one["label"], one["at"][0], one["at"][1], one["anchor"])
        for one in drawn["paths"][-1]["ticks"]
        if one["label"]
    ]
    names = [room.box(**one["written"]) for one in drawn["paths"] if one["written"]["text"]]
    assert len(depths) > 4
    assert len(names) > 2
    for name in names:
        for depth in depths:
            assert name[2] <= depth[0] or depth[2] <= name[0] or name[3] <= depth[1] or depth[3] <= name[1]


def test_the_title_shows_beginning_and_end_of_a_long_name(state: PlannerState) -> None:
    """Of two that begin alike one could not tell which is shown."""
    name = "left anterior hippocampus through the middle temporal gyrus, second"
    state.case.rename("left", name)
    state.look.select(state.case.plan.trajectories[0].name)
    drawn = over_cut(state, "inline", False, Pane(340.0, 340.0))
    assert drawn["title"].startswith("in line with left ant")
    assert drawn["title"].endswith("second")
    assert len(drawn["title"]) < 45
    assert name in drawn["spoken"]  # a voice has room for all of it


def test_values_of_measurements_and_names_of_points_stand_within_the_view(state: PlannerState) -> None:
    """At a corner of the view, where they would stand in its title, or beyond its edge."""
    pane = Pane(400.0, 400.0)
    cut = state.look.cut("axial")
    half = cut.field_mm / 2
    corner, below = (
        cut.center_mm + half * (across * cut.right + down * cut.down)
        for across, down in ((0.99, -0.99), (0.99, -0.5))
    )
    state.add_ruler("D", [below, corner])
    state.set_landmark("AC", corner)
    drawn = over_cut(state, "axial", False, pane)
    for one in (*drawn["rulers"], *drawn["points"]):
        left, top, right, _ = pane.room(half).box(**one["written"])
        assert -drawn["wide"] <= left < right <= drawn["wide"]
        assert top >= pane.room(half).em * TITLE_EM - drawn["high"]


def test_no_name_stands_on_a_letter_at_an_edge(state: PlannerState) -> None:
    """Straight below the title, in the middle, a cut tells where superior is."""
    pane = Pane(200.0, 200.0)
    cut = state.look.cut("coronal")
    half, pixel = cut.field_mm / 2, pane.pixel(cut.field_mm / 2)
    state.set_landmark("AC", cut.center_mm - 5.0 * pixel * cut.right + (40.0 * pixel - half) * cut.down)
    (point,) = over_cut(state, "coronal", False, pane)["points"]
    _, top, _, _ = pane.room(half).box(**point["written"])
    assert top >= 40.0 * pixel - half


def test_the_title_keeps_a_name_from_right_to_left_whole(state: PlannerState) -> None:
    name = "\u05e9\u05de\u05d0\u05dc (CT (2))"
    state.case.rename("left", name)
    state.look.select(name)
    assert over_cut(state, "second", False, Pane())["title"] == f"in line with \u2068{name}\u2069, at right angles"
