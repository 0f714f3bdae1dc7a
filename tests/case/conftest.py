"""The open case that the tests of this room work on."""

from __future__ import annotations

from pathlib import Path

import pytest

from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from tests import cases


@pytest.fixture
def state(tmp_path: Path) -> PlannerState:
    cases.write_case(tmp_path)
    (tmp_path / "registration.json").unlink()
    return PlannerState(cases.volume(), Storage.of(str(tmp_path / "plan.json"), None, None))
