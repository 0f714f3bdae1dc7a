"""Each page looks, points and is told for itself; what takes long follows the hand; nothing of another page is lost."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ronnaplan.case.surroundings import Surroundings
from ronnaplan.errors import UsageError
from ronnaplan.planner.app import PlannerApp
from ronnaplan.planner.shown import Shown
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.tab import FOLLOW_S, Tab
from ronnaplan.planner.working import BusyError
from tests import cases
from tests.loops import run
from tests.planner.conftest import reopened

VIEW = (400.0, 400.0)
X = np.array([1.0, 0.0, 0.0])


def over(tab: Tab, place_mm: np.ndarray) -> tuple[float, float, float, float]:
    """Pixels of a place in the axial view, and the size of the view."""
    cut = tab.state.look.cut("axial")
    across, down, _ = cut.on_screen_mm(place_mm).tolist()
    scale = VIEW[0] / cut.field_mm
    return (VIEW[0] / 2 + across * scale, VIEW[1] / 2 + down * scale, *VIEW)


def test_values_are_sent_when_they_change_and_a_page_sets_only_its_own() -> None:
    sent: list[dict[str, Any]] = []
    shown = Shown(sent.append)
    shown.update({"look": 1, "message": "wrong"})
    shown.flush()
    shown["look"] = 1
    shown.flush()
    assert sent == [{"look": 1, "message": "wrong"}]
    shown.take([{"key": "look", "value": 5}, {"key": "message", "value": "taken away"}])
    assert shown["look"] == 1
    shown["message"] = "taken away"
    shown.flush()
    assert len(sent) == 1


def test_a_window_that_was_chosen_is_kept_also_where_the_page_is_closed_at_once(state: PlannerState) -> None:
    async def use() -> None:
        tab = Tab(state.beside())
        tab.painter.refresh()
        await tab.answer("window", ("brain",))
        tab.close()

    run(use())
    assert reopened(state).look.window == "brain"


def test_a_page_that_was_only_opened_writes_nothing_into_the_case(state: PlannerState) -> None:
    """Nor does one whose browser draws nothing in 3-D, which asks for pictures by itself."""

    async def use() -> None:
        tab = Tab(state.beside())
        tab.painter.refresh()
        await tab.answer("pictures", ())
        tab.close()

    before = sorted(state.storage.plan.parent.iterdir())
    run(use())
    assert sorted(state.storage.plan.parent.iterdir()) == before


def test_that_a_job_is_waited_for_is_told_until_it_ends_and_another_refusal_stays(state: PlannerState) -> None:
    working = [True]
    tab = Tab(state, idle=lambda: not working[0])
    for error, left in ((BusyError("wait for that"), ""), (UsageError("there is no such view"),) * 2):
        working[0] = True
        tab.refuse(error)
        tab.refresh()
        assert tab.shown["message"] == str(error)
        working[0] = False
        tab.refresh()
        assert tab.shown["message"] == str(left)


def test_a_drag_of_one_page_is_let_go_before_another_page_changes_something(state: PlannerState) -> None:
    async def use() -> None:
        here, there = (Tab(state.beside(), lambda _: None) for _ in range(2))
        for tab in (here, there):
            tab.painter.refresh()
        here.state.show_path("left")
        target = state.case.plan.trajectory("left").target_mm
        await here.answer("press", ("axial", *over(here, target), 0, False))
        await here.answer("move", ("axial", *over(here, target + X * 3)))
        assert state.case.dragging
        await there.answer("hover", ("axial", 1.0, 1.0, *VIEW))
        assert state.case.dragging
        await there.answer("notes", ("left", "from there"))
        kept = state.case.plan.trajectory("left")
        assert kept.notes == "from there"
        assert kept.target_mm[0] == pytest.approx(target[0] + 3.0, abs=0.01)
        await here.answer("move", ("axial", *over(here, target + X * 5)))
        await here.answer("release", ("axial",))
        kept = state.case.plan.trajectory("left")
        assert (kept.notes, kept.target_mm[0]) == ("from there", pytest.approx(target[0] + 5.0, abs=0.01))

    run(use())


def test_an_end_whose_release_never_came_is_kept_before_anything_else_is_done(state: PlannerState) -> None:
    """As where the system takes a finger away, or a key is pressed meanwhile; what that did is not undone by moves."""

    async def use() -> None:
        tab = Tab(state)
        tab.refresh()
        tab.state.show_path("left")
        target = state.case.plan.trajectory("left").target_mm
        for way, again in ((3.0, target + X * 3), (5.0, target - X * 40)):  # pressed again: it, and nothing
            held = state.case.plan.trajectory("left").target_mm
            await tab.answer("press", ("axial", *over(tab, held), 0, False))
            await tab.answer("move", ("axial", *over(tab, target + X * way)))
            await tab.answer("press", ("axial", *over(tab, again), 0, False))
            await tab.answer("release", ("axial",))
            assert not state.case.dragging
            kept = reopened(state).case.plan.trajectory("left")
            assert kept.target_mm[0] == pytest.approx(target[0] + way, abs=0.01)
        for name, given in (("rename_path", ("left", "right")), ("key", ("delete",))):
            path = state.case.plan.trajectories[0]
            await tab.answer("press", ("axial", *over(tab, path.target_mm), 0, False))
            await tab.answer("move", ("axial", *over(tab, path.target_mm + X * 6)))
            await tab.answer(name, given)
            await tab.answer("move", ("axial", *over(tab, path.target_mm + X * 8)))
            await tab.answer("release", ("axial",))
            assert [one.name for one in reopened(state).case.plan] == ["right"][: name == "rename_path"]
        assert state.case.plan.revision == reopened(state).case.plan.revision

    run(use())


def test_a_tap_adds_a_trajectory_while_another_page_drags(state: PlannerState) -> None:
    async def use() -> None:
        here, there = (Tab(state.beside(), lambda _: None) for _ in range(2))
        for tab in (here, there):
            tab.refresh()
            tab.state.show_path("left")
        target = state.case.plan.trajectory("left").target_mm
        there.state.look.begun_mm, there.pointer.adding = cases.ENTRY_MM + X * 4, True
        await there.answer("press", ("axial", *over(there, target + X * 20), 0, False, False, False, True))
        await here.answer("press", ("axial", *over(here, target), 0, False))
        await here.answer("move", ("axial", *over(here, target + X * 4)))
        await there.answer("release", ("axial",))
        await here.answer("move", ("axial", *over(here, target + X * 5)))
        await here.answer("release", ("axial",))
        first, second = reopened(state).case.plan
        assert first.target_mm[0] == pytest.approx(target[0] + 5.0, abs=0.01)
        assert second.name == "T1"

    run(use())


def test_a_page_that_is_closed_lets_go_and_is_told_of_the_plan_no_more(state: PlannerState) -> None:
    drawn: list[bool] = []
    app: Any = SimpleNamespace(tabs={}, state=state, refresh=lambda: drawn.append(state.case.dragging))

    async def use() -> None:
        before = len(state.case.followers)
        tab = Tab(state.beside(), lambda _: None)
        tab.painter.refresh()
        tab.state.show_path("left")
        target = state.case.plan.trajectory("left").target_mm
        await tab.answer("press", ("axial", *over(tab, target), 0, False))
        await tab.answer("move", ("axial", *over(tab, target + X * 2)))
        app.tabs["page"] = tab
        PlannerApp.closed(app, "page")
        assert drawn == [False]  # on the others as it was let go
        assert not state.case.dragging
        assert state.case.plan.trajectory("left").target_mm[0] == pytest.approx(target[0] + 2.0, abs=0.01)
        assert len(state.case.followers) == before

    run(use())


def test_the_end_that_is_dragged_is_drawn_at_once_and_measured_a_little_later(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def use() -> None:
        sent: list[dict[str, Any]] = []
        tab = Tab(state.beside(), sent.append)
        tab.refresh()
        tab.state.show_path("left")
        tab.refresh()
        judged = []
        judge = Surroundings.judge

        def counting(*given: Any, **how: Any) -> Any:
            judged.append(given)
            return judge(*given, **how)

        monkeypatch.setattr(Surroundings, "judge", counting)
        await tab.answer("press", ("axial", *over(tab, cases.TARGET_MM), 0, False))
        sent.clear()
        judged.clear()
        for step in range(3, 8):  # the first is farther than a click may slip
            await tab.answer("move", ("axial", *over(tab, cases.TARGET_MM + X * step)))
        assert len([one for one in sent if "drawn_axial" in one]) == 5
        assert not judged
        assert not any("chosen" in one for one in sent)
        while not any("chosen" in one for one in sent):
            await asyncio.sleep(FOLLOW_S / 4)
        told = [one["chosen"] for one in sent if "chosen" in one]
        assert told[-1]["target"][0] == pytest.approx(cases.TARGET_MM[0] + 7.0, abs=0.01)
        await tab.answer("release", ("axial",))

    run(use())


def test_the_hu_told_are_of_where_one_points_now_and_aloud_only_by_keyboard(state: PlannerState) -> None:
    """The wheel moves the slices beneath a pointer that rests, and a drag takes it along; keys move the crosshair."""

    async def use() -> None:
        tab = Tab(state.beside())
        tab.painter.refresh()
        middle = (VIEW[0] / 2, VIEW[1] / 2, *VIEW)
        told = []
        for name, given in (
            ("hover", ("axial", *middle)),
            ("wheel", ("axial", 3, False, *middle)),
            ("press", ("axial", *middle, 0, False)),
            ("move", ("axial", 0.6 * VIEW[0], *middle[1:])),
            ("release", ("axial",)),
        ):
            await tab.answer(name, given)
            told.append(tab.shown["under"])
        assert len({*told[:2], told[3]}) == 3
        assert tab.shown["spoken"] == ""
        await tab.answer("at_crosshair", ("axial",))
        x, y, z = tab.state.look.crosshair_mm
        assert f"LPS {x:.1f}, {y:.1f}, {z:.1f}" in tab.shown["spoken"]
        await tab.answer("nudge", ("axial", 5, 0))
        assert f"LPS {tab.state.look.crosshair_mm[0]:.1f}, " in tab.shown["spoken"] == tab.shown["under"]
        assert tab.state.look.crosshair_mm[0] != x
        tab.close()

    run(use())


def test_the_hu_under_a_pointer_that_rests_follow_a_cut_that_another_page_moves(state: PlannerState) -> None:
    async def use() -> None:
        here, there = (Tab(state.beside()) for _ in range(2))
        here.painter.refresh()
        await here.answer("hover", ("inline", *VIEW, *VIEW))
        before = here.shown["under"]
        x, y, z = cases.TARGET_MM + X * 4
        await there.answer("place", ("left", "target", 0, f"{x}, {y}, {z}"))
        here.refresh()
        assert before != here.shown["under"] != ""
        for tab in (here, there):
            tab.close()

    run(use())
