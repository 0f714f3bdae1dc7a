"""The tests have a network of their own where that can be had: what they start is reached from nowhere else."""

from __future__ import annotations

import gc
from collections.abc import Generator
from typing import Any

import pytest
from _pytest.doctest import DoctestModule
from hypothesis import given, settings, strategies

from tests import isolation, shared

settings.register_profile("the same each time", derandomize=True, deadline=None)
settings.load_profile("the same each time")

LONG = (
    *("test_orientation", "test_by_pose", "test_hand_eye_step", "test_readme", "test_prepare", "test_placement"),
    *("browser", "test_robot_tutorial", "test_robot_place", "test_portrait"),
    *("test_kernelcache", "test_start_page"),
)
"""Parts of the names of files that take longest."""

WAITING = ("/planner/test_browser", "/node/", "/cohort/")
"""Parts of the paths of files whose tests wait for a page or for other processes, for half of their time and more."""

TOGETHER = tuple(
    f"tests/planner/test_{name}.py"
    for name in ("browser", "browser_access", "browser_head", "browser_webgl", "gate")
)
"""Files that look at one running planner: one worker runs them all, for to make its head takes longer than most do."""


def pytest_configure(config: pytest.Config) -> None:
    """Leave this machine's network before anything listens."""
    isolation.isolate()
    shared.share(config)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each worker whole files, and one of them those that go together."""
    from xdist.scheduler import LoadFileScheduling  # type: ignore[import-untyped]

    class Scheduling(LoadFileScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            file: str = super()._split_scope(nodeid)
            return TOGETHER[0] if file in TOGETHER else file

    return Scheduling(config, log) if config.getoption("dist") == "loadfile" else None


@settings(max_examples=1)
@given(strategies.none())
def _draw(_: None) -> None:
    """Draw nothing in particular."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for no garbage among what is imported to collect the tests, then and later: all of it stays.

    Hypothesis draws once before: Python 3.14 hides who owns its random numbers once that is frozen, which it warns of.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        _draw()
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_collect_file() -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Look for no examples in what tests say of themselves."""
    return [one for one in (yield) if not isinstance(one, DoctestModule)]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest: so no core waits long for the other's last one.

    Those that wait are spread evenly among those that compute: so none waits as several of them run at a time.
    """
    files = list(dict.fromkeys(item.path for item in items))
    files.sort(key=lambda path: not any(part in path.name for part in LONG))
    waits = [any(part in path.as_posix() for part in WAITING) for path in files]
    place = {
        path: waits[:n].count(waits[n]) / waits.count(waits[n])  # among its like
        for n, path in enumerate(files)
    }
    items.sort(key=lambda item: place[item.path])
