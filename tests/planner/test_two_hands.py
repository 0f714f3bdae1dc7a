"""The planner beside other hands: what they write is shown, kept, and never written over; what fails is taken back."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ronnaplan.documents.plan import change_plan, read_plan
from ronnaplan.planner.app import LOOK_AGAIN_S
from tests import cases
from tests.loops import run
from tests.planner.browser import Planner
from tests.planner.pages import Page


async def shown(page: Page, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Wait until the page shows something, and return all that it shows."""
    for _ in range(600):
        state = await page.state()
        if holds(state):
            return state
        await asyncio.sleep(0.1)
    raise AssertionError(f"never shown; the messages are {state['message']!r}, {state['news']!r}")


def test_a_change_of_what_another_hand_changed_is_refused_and_the_page_shows_theirs(kept: Planner) -> None:
    path = kept.folder / "plan.json"

    async def act() -> None:
        async with Page(kept.url) as page:
            for number in range(20):  # until a change comes before the planner has looked
                theirs = f"theirs {number}"
                change_plan(path, lambda plan, theirs=theirs: plan.edit("left", notes=theirs))  # type: ignore[misc]
                await page.trigger("notes", "left", f"mine {number}")
                state = await page.state()
                if state["refusals"]:
                    break
            assert "'left' was changed by another hand" in state["message"]
            assert state["chosen"]["notes"] == read_plan(path).trajectory("left").notes == f"theirs {number}"

    run(act())


def test_a_verdict_that_one_page_finds_as_it_is_drawn_is_shown_on_those_drawn_before(kept: Planner) -> None:
    """What another hand has changed is measured at once for the page that shows it."""
    path = kept.folder / "plan.json"
    change_plan(path, lambda plan: plan.add(replace(plan.trajectory("left"), name="other")))

    def known(state: dict[str, Any]) -> bool:
        return len(state["paths"]) == 2 and all(row["verdict"][0] for row in state["paths"])

    async def act() -> None:
        async with Page(kept.url) as first, Page(kept.url) as second:
            await first.ask("trame.lifecycle.update", "client_connected")
            await shown(
                first, lambda state: known(state) and bool(state["things"])
            )  # which is drawn as it is there
            await first.trigger("select", "other")
            await second.trigger("select", "left")
            change_plan(path, lambda plan: plan.edit("left", target_mm=np.add(cases.TARGET_MM, [0.0, 0.0, 1.0])))
            await shown(second, lambda state: state["chosen"]["target"][2] == 21.0)
            await shown(first, known)

    try:
        run(act())
    finally:
        change_plan(path, lambda plan: plan.remove("other"))


@pytest.mark.skipif(sys.platform != "linux", reason="another process can be forbidden to write on Linux only")
def test_a_write_that_fails_is_said_and_made_once_it_can_be(kept: Planner) -> None:
    import resource

    path = kept.folder / "plan.json"
    limits = resource.prlimit(kept.process.pid, resource.RLIMIT_FSIZE)
    written = path.read_bytes()

    async def act() -> None:
        async with Page(kept.url) as page:
            before = (await page.state())["chosen"]["notes"]
            resource.prlimit(kept.process.pid, resource.RLIMIT_FSIZE, (100, limits[1]))
            await page.trigger("notes", "left", "unsaved")
            state = await page.state()
            assert "cannot write" in state["message"]
            assert state["refusals"] == 1
            assert state["chosen"]["notes"] == before
            state = await shown(page, lambda state: bool(state["unsaved"]))
            assert state["unsaved"]["change"]
            assert "the last change" in state["unsaved"]["what"]
            assert path.read_bytes() == written
            await page.trigger("select", "left")  # to look about is no change, and is refused by no disk
            await page.trigger("layout", "four")
            state = await shown(page, lambda state: "where you look" in state["unsaved"]["what"])
            assert (state["message"], state["look"]["layout"]) == ("", "four")
            assert [one.name for one in kept.folder.glob(".ronnaplan.*")] == []
            resource.prlimit(kept.process.pid, resource.RLIMIT_FSIZE, limits)
            state = await shown(page, lambda state: state["chosen"]["notes"] == "unsaved")
            assert "is written now" in state["news"]
            await shown(page, lambda state: not state["unsaved"])
            assert read_plan(path).trajectory("left").notes == "unsaved"
            resource.prlimit(kept.process.pid, resource.RLIMIT_FSIZE, (100, limits[1]))
            await page.trigger("notes", "left", "given up")
            await shown(page, lambda state: bool(state["unsaved"]))
            await page.trigger("give_up")
            resource.prlimit(kept.process.pid, resource.RLIMIT_FSIZE, limits)
            await shown(page, lambda state: not state["unsaved"])
            assert read_plan(path).trajectory("left").notes == "unsaved"

    run(act())


def test_another_hand_s_change_is_shown_by_itself_and_the_planner_s_next_one_keeps_it(kept: Planner) -> None:
    path = kept.folder / "plan.json"
    other = cases.plan().trajectory("left")

    async def act() -> None:
        async with Page(kept.url) as page:
            change_plan(path, lambda plan: plan.edit("left", notes="theirs"))
            state = await shown(page, lambda state: state["chosen"]["notes"] == "theirs")
            assert "another hand" in state["news"]
            change_plan(path, lambda plan: plan.edit("left", name="renamed").add(other))
            await page.trigger("notes", "left", "mine")  # the page may not show yet that this is another one
            refused = (await page.state())["refusals"]
            state = await shown(page, lambda state: len(state["paths"]) == 2)
            assert read_plan(path).trajectory("renamed").notes == "theirs"
            assert read_plan(path).trajectory("left").notes == ("" if refused else "mine")

    assert LOOK_AGAIN_S <= 1.0
    run(act())
