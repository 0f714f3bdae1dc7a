"""Whatever a page sends with an action: it is done as it says, or refused in a sentence and nothing has changed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from ronnaplan.errors import UsageError
from ronnaplan.planner.actions import Actions
from ronnaplan.planner.arguments import LONGEST_TEXT, checked
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.state import PlannerState
from tests.loops import run
from tests.planner.browser import Planner
from tests.planner.pages import Page

AT = (100.0, 100.0, 400.0, 400.0)
BAD: list[tuple[str, list[Any]]] = [
    ("press", ["axial", "100", *AT[1:], 0, False]),
    ("press", ["axial", 1e308, *AT[1:], 0, False]),
    ("press", ["axial", float("nan"), *AT[1:], 0, False]),
    ("press", ["axial", *AT, 0, "no"]),
    ("press", ["axial", *AT]),
    ("press", [["axial"], *AT, 0, False]),
    ("move", ["axial", None, *AT[1:]]),
    ("move", []),
    ("wheel", ["axial", 1e9, True, *AT]),
    ("wheel", ["axial", True, True, *AT]),
    ("release", []),
    ("key", [{}]),
    ("key", ["no such key"]),
    ("window", [3]),
    ("select", [{"name": "left"}]),
    ("lock", ["left", "yes"]),
    ("rename_path", ["left", None]),
    ("rename_path", ["left", "x" * (LONGEST_TEXT + 1)]),
    ("notes", ["left", 5]),
    ("notes", ["left", "x" * (LONGEST_TEXT + 1)]),
    ("colour", ["left", ["#ffffff"]]),
    ("colour", ["left", "red"]),
    ("instrument", ["left", 1]),
    ("electrode", ["left", None]),
    ("place", ["left", "entry", 3, "1"]),
    ("place", ["left", "entry", -1, "1"]),
    ("place", ["left", "__class__", 0, "1"]),
    ("place", ["left", "entry", 0, "nan"]),
    ("place", ["left", "entry", 0, [1]]),
    ("place_acpc", ["left", 3, "1"]),
    ("place_acpc", ["left", 0, "1"]),
    ("show_end", ["left", "middle"]),
    ("size", ["left", "name", "1"]),
    ("size", ["left", "length", {}]),
    ("take", [-1]),
    ("take", [0.5]),
    ("landmark", ["AC", 5]),
    ("landmark", ["AC", "1 2"]),
    ("jump_landmark", [None]),
    ("jump", [None]),
    ("jump_rejected", [2**63]),
    ("accept", ["0"]),
    ("rename", ["F1", 5]),
    ("readings", ["../../etc/passwd"]),
    ("readings", [b"readings.csv"]),
    ("pick_reading", [1]),
    ("localize", ["11.5.5"]),
    ("localize", [[11.5]]),
    ("propose", [None]),
    ("placement", ["many"]),
    ("listen", [1]),
    ("surface", ["skull"]),
]


def test_badly_typed_actions_are_refused_one_by_one_and_change_nothing(kept: Planner) -> None:
    plan = kept.folder / "plan.json"

    async def send() -> None:
        async with Page(kept.url) as page:
            before, refusals = plan.read_bytes(), (await page.state())["refusals"]
            for count, (name, arguments) in enumerate(BAD, start=1):
                answer = await page.trigger(name, *arguments)
                assert answer.get("result", "missing") is None, (name, arguments, answer)
                for _ in range(600):  # slow actions answer before they are done
                    if (told := await page.state())["refusals"] > refusals + count - 1:
                        break
                    await asyncio.sleep(0.05)
                assert told["refusals"] == refusals + count, (name, arguments)
                assert len(told["message"]) > 20
            assert plan.read_bytes() == before
            assert (await page.trigger("notes", "left", "well typed"))["result"] is None
            assert b"well typed" in plan.read_bytes()

    run(send())


def test_a_text_that_is_too_long_is_told_for_what_it_is(state: PlannerState) -> None:
    with pytest.raises(UsageError, match=r"a text of 10001 characters is not taken; enter 10000 at most"):
        checked("notes", state.case.rename)("left", "x" * (LONGEST_TEXT + 1))


def test_every_action_declares_what_it_takes(state: PlannerState) -> None:
    actions = Actions(state, Pointer(state))
    every: dict[str, Callable[..., Any]] = {**actions.by_name(), "move": actions.move}
    for name, action in every.items():
        with pytest.raises(UsageError, match=f"asked for '{name}' wrongly"):
            checked(name, action)(*(object() for _ in range(9)))
