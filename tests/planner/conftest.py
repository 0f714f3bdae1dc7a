"""The opened case that most tests of the planner use, and the running planner of those in a browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from tests import cases
from tests.planner.browser import Planner, chromium, is_left, kept_open, leave, planner


@pytest.fixture
def storage(tmp_path: Path) -> Storage:
    cases.write_case(tmp_path)
    (tmp_path / "registration.json").unlink()
    return Storage.of(str(tmp_path / "plan.json"), None, None)


@pytest.fixture
def state(storage: Storage) -> PlannerState:
    return PlannerState(cases.volume(), storage)


@pytest.fixture(scope="session")
def running_browser() -> Iterator[Any]:
    """A browser that draws nothing in 3-D: the server sends it pictures, however quick this machine is."""
    with chromium("--disable-3d-apis") as running:
        yield running


@pytest.fixture
def browser(running_browser: Any) -> Iterator[Any]:
    """A browser whose tabs are closed, or emptied, after the test, but for a page of the whole module."""
    used = [context for context in running_browser.contexts if not is_left(context)]
    yield running_browser
    for context in running_browser.contexts:
        if context not in used:
            leave(context)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return cases.write_case(tmp_path)


@pytest.fixture
def running(folder: Path) -> Iterator[Planner]:
    """A planner of a test's own."""
    with planner(folder) as one:
        yield one


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Planner]:
    """A planner for the tests of one module that leave each other's things alone."""
    with planner(cases.write_case(tmp_path_factory.mktemp("kept"))) as one:
        yield one


@pytest.fixture(scope="module")
def page(running_browser: Any, kept: Planner) -> Iterator[Any]:
    """One page for the tests of one module that leave each other's things alone: to load it takes most of a test."""
    with kept_open(running_browser, kept.url) as page:
        yield page


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Planner]:
    """A planner for the tests that plan nothing; its head has skin and skull."""
    folder = cases.write_case(tmp_path_factory.mktemp("shared"))
    cases.write_readings(folder / "readings.csv")
    with planner(folder, surfaces=True) as one:
        yield one


def reopened(state: PlannerState) -> PlannerState:
    """The same case as a new process finds it, without any farewell of the old one."""
    return PlannerState(cases.volume(), state.storage)
