"""The open case that the tests of this room work on, and a scan that is looked at once for all of them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.planning import Head
from ronnaplan.planning.obstacles import metal
from ronnaplan.report import path_part
from tests import cases


@pytest.fixture
def one_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scan is read once, its surfaces are found once; pictures say nothing of what is tested."""
    volume = cases.volume()
    head = Head.of(volume)
    monkeypatch.setattr("ronnaplan.ct.read_ct", lambda *_, **__: volume)
    monkeypatch.setattr(Head, "of", lambda _: head)
    monkeypatch.setattr(path_part, "path_picture", lambda *_: b"")
    monkeypatch.setattr("ronnaplan.case.surroundings.metal", cache(metal))


@pytest.fixture
def state(tmp_path: Path) -> PlannerState:
    cases.write_case(tmp_path)
    (tmp_path / "registration.json").unlink()
    return PlannerState(cases.volume(), Storage.of(str(tmp_path / "plan.json"), None, None))
