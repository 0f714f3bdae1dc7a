"""Measures all trajectories beside the pages, so that what is asked of one of them later takes no long time.

Of a plan without any the head is found, and what is to be kept away from: the first click of a target needs them.
Those that are looked at come first: of a plan of two hundred the others take half a minute on a busy machine.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection

from ronnaplan.case.edits import OpenCase
from ronnaplan.case.surroundings import Surroundings

FIRST_LOOK_S = 0.3
"""The browser has this long to draw the cuts before what measures is loaded."""


class Judging:
    """Begins once the first picture is seen, and again whenever what is measured against has changed."""

    def __init__(
        self, case: OpenCase, done: Callable[[], None], looked_at: Callable[[], Collection[str | None]]
    ) -> None:
        """Measure the trajectories of ``case``, those whose names are ``looked_at`` first.

        ``done`` is called after each of those, and when all are measured.
        """
        self.case, self.done, self.looked_at = case, done, looked_at
        self._begun = False
        self._task: asyncio.Task[None] | None = None
        self._against: Surroundings | None = None

    def is_done(self) -> bool:
        """Tell whether to measure a trajectory takes no long time by now."""
        return self._against is self.case.surroundings

    async def begin(self) -> None:
        """Load what measures, which takes seconds, for the first time."""
        if not self._begun:
            self._begun = True
            await asyncio.sleep(FIRST_LOOK_S)
            self.soon()

    def soon(self) -> None:
        """Measure anew what is to be measured, if it has begun and is not under way; what is dragged is followed."""
        if self._begun and self._task is None and self._is_left() and not self.case.dragging:
            self._task = asyncio.get_running_loop().create_task(self._measure())

    def _is_left(self) -> bool:
        """Whether a trajectory is not measured yet: one that came back by undo, say, or is another hand's."""
        around, plan = self.case.surroundings, self.case.plan
        return not (self.is_done() and all(around.knows(one, plan) for one in plan.trajectories))

    async def _measure(self) -> None:
        while self._is_left() and not self.case.dragging:
            around = self.case.surroundings
            if await self._measured_all(around):
                self._against = around
        self._task = None
        self.done()

    async def _measured_all(self, around: Surroundings) -> bool:
        """Measure every trajectory against its surroundings; return whether they are still those."""
        await asyncio.get_running_loop().run_in_executor(None, around.prepare)
        plan = self.case.plan
        left = list(plan.trajectories)
        while left and self.case.surroundings is around:
            names = self.looked_at()
            one = next((path for path in left if path.name in names), left[0])
            left.remove(one)
            await asyncio.get_running_loop().run_in_executor(None, around.measures, one, plan)
            if one.name in names:
                self.done()
        return not left
