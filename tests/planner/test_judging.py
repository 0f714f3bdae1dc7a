"""All trajectories are measured beside the pages, again when what they are measured against has changed meanwhile."""

from __future__ import annotations

import asyncio
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from ronnaplan.planner import judging
from ronnaplan.planner.judging import Judging
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.planning import Head
from tests import cases
from tests.loops import run


def test_nothing_is_measured_before_the_first_look_and_all_again_after_a_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(judging, "FIRST_LOOK_S", 0.0)
    measured: list[str] = []

    def against(name: str, then: Any = None) -> Any:
        def measure(path: Any, _: Any) -> None:
            known.append(path)
            measured.append(f"{path.name} against {name}")
            case.surroundings = then or case.surroundings

        known: list[Any] = []
        prepare = partial(measured.append, f"prepared {name}")
        return SimpleNamespace(measures=measure, prepare=prepare, knows=lambda path, _: path in known)

    plan = SimpleNamespace(trajectories=(SimpleNamespace(name="plan"),))
    around = against("head", then=against("head and markers"))
    case: Any = SimpleNamespace(plan=plan, dragging=False, surroundings=around)

    async def look() -> None:
        done = asyncio.Event()
        own = Judging(case, done.set, tuple)
        own.soon()
        assert not measured
        await own.begin()
        own.soon()  # it is under way
        await done.wait()
        assert own.is_done()
        own.soon()
        await own.begin()
        assert measured == [
            "prepared head",
            "plan against head",
            "prepared head and markers",
            "plan against head and markers",
        ]
        case.surroundings = against("another")
        assert not own.is_done()
        done.clear()
        own.soon()
        await done.wait()
        assert measured[4:] == ["prepared another", "plan against another"]
        case.plan = SimpleNamespace(trajectories=(*plan.trajectories, SimpleNamespace(name="another hand's")))
        case.dragging = True
        own.soon()
        await asyncio.sleep(0.01)
        assert len(measured) == 6  # what is dragged is followed instead
        case.dragging = False
        done.clear()
        own.soon()
        await done.wait()
        assert measured[-1] == "another hand's against another"

    run(look())


def test_what_is_looked_at_is_measured_and_told_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where another one is looked at only while others are being measured."""
    monkeypatch.setattr(judging, "FIRST_LOOK_S", 0.0)
    happened: list[str] = []

    def measure(path: Any, _: Any) -> None:
        known.append(path)
        happened.append(path.name)
        if path.name == "A":
            looked_at.add("D")

    known: list[Any] = []
    looked_at = {"C", None}
    plan = SimpleNamespace(trajectories=tuple(SimpleNamespace(name=name) for name in "ABCDE"))
    around = SimpleNamespace(measures=measure, prepare=lambda: None, knows=lambda path, _: path in known)
    case: Any = SimpleNamespace(plan=plan, dragging=False, surroundings=around)

    async def look() -> None:
        own = Judging(case, lambda: happened.append("told"), lambda: set(looked_at))
        await own.begin()
        while not own.is_done():
            await asyncio.sleep(0.01)

    run(look())
    assert happened[:8] == ["C", "told", "A", "D", "told", "B", "E", "told"]


def test_the_head_is_found_before_the_first_target_is_clicked(
    storage: Storage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(judging, "FIRST_LOOK_S", 0.0)
    storage.plan.unlink()
    state = PlannerState(cases.volume(), storage)

    async def look() -> None:
        done = asyncio.Event()
        await Judging(state.case, done.set, tuple).begin()
        await done.wait()

    run(look())
    monkeypatch.setattr(Head, "of", None)
    state.add_trajectory(cases.ENTRY_MM, cases.TARGET_MM)
