"""All trajectories are measured beside the pages, again when what they are measured against has changed meanwhile."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from ronnaplan.planner import judging
from ronnaplan.planner.judging import Judging
from tests.loops import run


def test_nothing_is_measured_before_the_first_look_and_all_again_after_a_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(judging, "FIRST_LOOK_S", 0.0)
    measured: list[str] = []

    def against(name: str, then: Any = None) -> Any:
        def judge_all(plan: str) -> None:
            measured.append(f"{plan} against {name}")
            case.surroundings = then or case.surroundings

        return SimpleNamespace(judge_all=judge_all)

    case: Any = SimpleNamespace(plan="plan", surroundings=against("head", then=against("head and markers")))

    async def look() -> None:
        done = asyncio.Event()
        own = Judging(case, done.set)
        own.soon()
        assert not measured
        await own.begin()
        own.soon()  # it is under way
        await done.wait()
        assert own.is_done()
        own.soon()
        await own.begin()
        assert measured == ["plan against head", "plan against head and markers"]
        case.surroundings = against("another")
        assert not own.is_done()
        done.clear()
        own.soon()
        await done.wait()
        assert measured[2:] == ["plan against another"]

    run(look())
