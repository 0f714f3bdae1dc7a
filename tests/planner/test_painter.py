"""What is drawn again when something changes, and what is not."""

from __future__ import annotations

from typing import Any

import pytest

from ronnaplan.planner import painter as painting
from ronnaplan.planner.cuts import sampled
from ronnaplan.planner.painter import Painter
from ronnaplan.planner.panels import chosen_path
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.tab import Tab
from ronnaplan.scene.head import HeadParts
from tests.loops import run


def test_a_window_that_is_dragged_samples_no_cut_again(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = []

    def counting(*of: Any) -> Any:
        counted.append(of)
        return sampled(*of)

    monkeypatch.setattr(painting, "sampled", counting)
    monkeypatch.setattr(Painter, "rest_soon", lambda self: None)

    async def drag() -> None:
        painter = Tab(state, lambda _: None).painter
        painter.move()
        painter.refresh_views()
        first, before = len(counted), painter.shown["picture_axial"]
        state.look.set_window(-200.0, 300.0)
        painter.refresh_views()
        assert painter.shown["picture_axial"] != before
        assert len(counted) == first
        state.look.scroll("axial", 1)
        painter.refresh_views()
        assert len(counted) > first

    run(drag())


def test_a_trajectory_that_is_measured_is_told_of_while_others_still_are_measured(state: PlannerState) -> None:
    tab = Tab(state, lambda _: None, measured=lambda: False)
    tab.painter.refresh()
    assert tab.shown["chosen"]["problem"] == "measuring ..."
    assert tab.shown["chosen"]["measuring"]  # which looks like no fault
    state.case.judge(state.case.plan.trajectories[0])
    tab.painter.refresh()
    assert not tab.shown["chosen"]["measuring"]
    assert (tab.shown["chosen"]["problem"], tab.shown["chosen"]["measures"][0][0]) == ("", "length")


def test_the_head_is_drawn_while_trajectories_still_are_measured(state: PlannerState) -> None:
    """A path stands there at once, its tube as soon as that is known."""
    tab = Tab(state, lambda _: None, measured=lambda: False)
    tab.head.open(HeadParts())

    def names() -> set[str]:
        tab.painter.refresh()
        return {one["name"] for one in tab.shown["things"]}

    assert {"marker F1", "path left"} <= names()
    assert "tube left" not in names()
    state.case.judge(state.case.plan.trajectory("left"))
    assert "tube left" in names()


def test_the_panel_says_that_without_markers_no_error_is_expected(state: PlannerState) -> None:
    """It showed no error, and no word on why."""

    def said() -> str:
        wanting = chosen_path(state, state.case.judge(state.case.plan.trajectory("left")))["wanting"]
        assert isinstance(wanting, str)
        return wanting

    state.look.select("left")
    assert said() == ""
    for marker in state.case.found.points.labels:
        state.case.reject_marker(marker)
    assert said() == "no expected error: there are no markers"
