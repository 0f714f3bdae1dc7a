"""One job at a time beside the page: what it is and how far, in the page's words, and its answer when it is done."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any, Final

from ronnaplan.errors import UnwrittenError, UsageError
from ronnaplan.planner.worker import CancelledError, Job, Worker

TELL_S: Final = 0.5
"""How often the page is told how far a job is."""

AGAIN_S: Final = 1.0
"""How often an answer that cannot be written is written again."""

IDLE: Final = {"what": "", "done": "", "share": 0.0, "seconds": 0}


class BusyError(UsageError):
    """What was asked for has to wait for a job, with which this goes away."""


class Working:
    """Has jobs done by a `Worker` while the page goes on.

    ``tell`` shows it on every page. ``answering`` is entered while an answer is taken, and shows what goes wrong;
    ``shown`` draws the pages then.
    """

    def __init__(
        self,
        tell: Callable[[Mapping[str, Any]], None],
        answering: Callable[[], AbstractContextManager[None]],
        shown: Callable[[], None],
    ) -> None:
        self.tell, self.answering, self.shown = tell, answering, shown
        self.told: dict[str, Any] = IDLE
        self._worker = Worker()
        self._task: asyncio.Task[None] | None = None
        self._share = 0.0
        self._given_up = asyncio.Event()
        """Whether an answer is not to be written any more."""

    def start(self, job: Job) -> None:
        """Set a job going; raises `BusyError` while another one is under way."""
        self.require_idle()
        self._worker, self._share = Worker(), 0.0
        self._tell({**IDLE, "what": job.what})
        self._task = asyncio.get_running_loop().create_task(self._work(job))

    def is_idle(self) -> bool:
        """Return whether no job is under way."""
        return self._task is None

    def require_idle(self) -> None:
        """Raise `BusyError` while a job is under way."""
        if not self.is_idle():
            raise BusyError(f"the planner is {self.told['what']}; wait for that, or cancel it first")

    def cancel(self) -> None:
        """End the job that is under way."""
        self._given_up.set()
        self._worker.cancel()

    async def _work(self, job: Job) -> None:
        began, done = time.monotonic(), ""
        answer = asyncio.get_running_loop().run_in_executor(None, self._worker.answer, job, self._take_share)
        while not (await asyncio.wait({answer}, timeout=TELL_S))[0]:
            seconds = round(time.monotonic() - began)
            self._tell({**IDLE, "what": job.what, "share": self._share, "seconds": seconds})
        try:
            with self.answering():
                await self._keep(job, answer.result())
                done = job.what
        finally:  # after a fault of the program, too: a page that shows a job lets nothing else be begun
            self._task = None
            self._tell({**IDLE, "done": done})
            self.shown()

    async def _keep(self, job: Job, answer: Any) -> None:
        """Take an answer; one that cannot be written waits until it can be, or is given up."""
        self._given_up.clear()
        while not self._given_up.is_set():
            try:
                return job.keep(answer)
            except UnwrittenError as error:
                self._tell({**IDLE, "what": f"{job.what} is done, but {error}; writing it again"})
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._given_up.wait(), AGAIN_S)
        raise CancelledError(f"cancelled: {job.what}")

    def _tell(self, work: dict[str, Any]) -> None:
        self.told = work
        self.tell({"work": work})

    def _take_share(self, share: float) -> None:
        self._share = round(share, 2)
