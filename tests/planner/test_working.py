"""The answer of what took long is not lost where it cannot be written: it waits until it can be, or is given up."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import operator
import time
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import pytest

from ronnaplan.errors import RonnaplanError, UnwrittenError, UsageError
from ronnaplan.planner import working
from ronnaplan.planner.worker import CancelledError, Job
from tests.loops import run

FULL = "cannot write plan.json: No space left on device; make room on its disk"


class Disk:
    """Refuses to be written a number of times; remembers what was kept and what the page was told."""

    def __init__(self, refusals: int) -> None:
        self.refusals, self.kept, self.told, self.errors = refusals, [], [], []  # type: ignore[var-annotated]

    def keep(self, answer: int) -> None:
        if self.refusals:
            self.refusals -= 1
            raise UnwrittenError(FULL)
        self.kept.append(answer)

    def tell(self, values: Mapping[str, Any]) -> None:
        self.told.append(values["work"]["what"])
        self.done = values["work"]["done"]

    @contextlib.contextmanager
    def answering(self) -> Iterator[None]:
        try:
            yield
        except RonnaplanError as error:
            self.errors.append(error)

    async def work(self, *, give_up: bool = False) -> None:
        """Have a job done whose answer is 42."""
        does = working.Working(self.tell, self.answering, lambda: None)
        does.start(Job("counting", partial(operator.mul, 6, 7), self.keep))
        while self.told[-1]:
            await asyncio.sleep(0.05)
            if "is done" in self.told[-1]:
                with pytest.raises(UsageError, match="counting is done, but"):
                    does.require_idle()
                if give_up:
                    does.cancel()
        does.require_idle()


def test_an_answer_that_cannot_be_written_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(working, "AGAIN_S", 0.3)
    disk = Disk(3)
    run(disk.work())
    assert (disk.kept, disk.errors, disk.done) == ([42], [], "counting")
    assert f"counting is done, but {FULL}; writing it again" in disk.told


def test_an_answer_that_waits_is_given_up_by_cancel() -> None:
    disk = Disk(10**6)
    run(disk.work(give_up=True))
    assert [type(one) for one in disk.errors] == [CancelledError]
    assert (disk.kept, disk.done) == ([], "")


def test_a_fault_of_the_program_leaves_no_page_busy() -> None:
    disk = Disk(0)
    unheard: list[Any] = []

    def fail(answer: int) -> None:
        raise ZeroDivisionError(answer)

    async def work() -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, context: unheard.append(context["exception"]))
        does = working.Working(disk.tell, disk.answering, lambda: None)
        does.start(Job("counting", partial(operator.mul, 6, 7), fail))
        while not does.is_idle():
            await asyncio.sleep(0.05)

    run(work())
    gc.collect()
    assert disk.told[-1] == disk.done == ""
    assert [type(one) for one in unheard] == [ZeroDivisionError]


def test_a_job_that_is_cancelled_at_once_is_ended_and_the_next_one_is_done() -> None:
    disk = Disk(0)

    async def work() -> None:
        does = working.Working(disk.tell, disk.answering, lambda: None)
        for seconds in (60, 0):
            does.start(Job("waiting", partial(time.sleep, seconds), disk.keep))
            if seconds:
                does.cancel()
            while not does.is_idle():
                await asyncio.sleep(0.05)

    run(work())
    assert [type(one) for one in disk.errors] == [CancelledError]
    assert disk.kept == [None]
