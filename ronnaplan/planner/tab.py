"""One open page: where it looks, what it points at, and what it was sent."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from ronnaplan.errors import RonnaplanError, UsageError
from ronnaplan.planner.actions import Actions, key_actions
from ronnaplan.planner.arguments import Pixels, checked
from ronnaplan.planner.cuts import HEAD
from ronnaplan.planner.head_actions import HeadActions
from ronnaplan.planner.head_view import HeadView
from ronnaplan.planner.painter import Painter
from ronnaplan.planner.pixels import Pixel
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.shown import OWN, Send, Shown
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.worker import CancelledError
from ronnaplan.planner.working import BusyError

FOLLOW_S = 0.15
"""While an end is dragged, measures and 3-D view follow after so long: the hand is followed at once."""

KEEP_S = 0.5
"""Where one looks is written once it has stayed the same for so long."""

KEEP_MESSAGE = ("release", "pictures", "volume_is_slow")
"""What a page asks for by itself, or at the end of something else: what was told before it stays."""

EMPTY: Mapping[str, Any] = {
    **OWN,
    **{"news": "", "under": "", "spoken": "", "refusals": 0, "unsaved": {}},
    **{"things": [], "volume": {}, "picture_head": None},
}
"""What a page shows before anything is drawn."""


def _send_nowhere(_: dict[str, Any]) -> None:
    """Send nothing: no page shows the tab yet."""


def _nothing() -> None:
    """Do nothing but answer: what was told before goes away with whatever goes well."""


class Tab:
    """Answers one page. ``others`` draws what changed on all other pages."""

    def __init__(
        self,
        state: PlannerState,
        send: Send = _send_nowhere,
        *,
        tracker: tuple[str, int] | None = None,
        measured: Callable[[], bool] = lambda: True,
        cancel: Callable[[], None] = lambda: None,
        idle: Callable[[], bool] = lambda: True,
        others: Callable[[Tab], None] = lambda _: None,
    ) -> None:
        self.state, self.shown, self.head = state, Shown(send), HeadView(state)
        self.pointer = Pointer(state)
        self.painter = Painter(state, self.shown, self.pointer, self.head, measured)
        self._others = others
        self._following: asyncio.Task[None] | None = None
        self._keeping: asyncio.TimerHandle | None = None
        self._idle, self._waits = idle, False
        """Whether no job is under way, and whether what was told last is that one is."""
        self.unkept: RonnaplanError | None = None
        """Why where one looks could not be kept, None where it was."""
        self._keys = key_actions(state, self.pointer)
        self._actions = Actions(state, self.pointer, tracker)
        self._answers = self._answered(cancel)
        self.shown.update(EMPTY)

    def _answered(self, cancel: Callable[[], None]) -> dict[str, Callable[..., Any]]:
        """Return what the page may ask for."""
        changing: dict[str, Callable[..., Any]] = {
            **self._actions.by_name(),
            **HeadActions(self.state, self.painter).by_name(),
            "key": self._press_key,
            "cancel": cancel,
            "dismiss": _nothing,
            "give_up": self._give_up,
        }
        return {
            **{name: self._answering(name, checked(name, action)) for name, action in changing.items()},
            "there": self._telling(_nothing),
            "sized": self._telling(checked("sized", self.painter.take_size)),
            "hover": self._telling(checked("hover", self._hover)),
            "at_crosshair": self._telling(checked("at_crosshair", self._point_at_crosshair)),
            "move": self._answer_move(checked("move", self._actions.move)),
        }

    @property
    def names(self) -> list[str]:
        """What a page may ask for."""
        return list(self._answers)

    async def answer(self, name: str, arguments: tuple[Any, ...]) -> None:
        """Do what the page asks for; what went wrong is told on it."""
        await self._answers[name](*arguments)
        self.shown.flush()

    def take(self, changes: Iterable[Mapping[str, Any]]) -> None:
        """Take over what the page set itself."""
        self.shown.take(changes)
        self.refresh()

    def refresh(self) -> None:
        """Draw whatever is not as the page has it; what had to wait for a job need not once that has ended."""
        if self._waits and self._idle():
            self.shown["message"], self._waits = "", False
        self.painter.refresh()
        self.shown.flush()

    def close(self) -> None:
        """The page is gone: what it held is let go, and where it looked is kept."""
        self.painter.close()
        if self._following is not None:
            self._following.cancel()
        if self._keeping is not None:
            self._keeping.cancel()
            with contextlib.suppress(RonnaplanError):
                self.state.look.keep()
        with contextlib.suppress(RonnaplanError):  # an end in air goes back; nobody is there to be told
            self.pointer.release(whole=False)
        self.state.look.leave()

    # --- what the page asks for ------------------------------------------------------------------------------

    def _answering(self, name: str, action: Callable[..., Any]) -> Callable[..., Any]:
        """Do what may change the case, tell what went wrong, and draw what changed."""
        keep_message, scrolls = name in KEEP_MESSAGE, name == "wheel"

        async def answer(*arguments: Any) -> None:
            before = self.state.case.plan
            if scrolls:
                self.painter.move()
            elif not (name == "release" and self.pointer.holding):
                self._let_go()
            with self.told(keep_message):
                action(*arguments)
            self._keep_soon()
            if scrolls and self.state.case.plan is before:
                self.painter.refresh_views()  # the panels follow when it rests
                return
            self.painter.refresh()
            self._others(self)

        return answer

    def _telling(self, action: Callable[..., Any]) -> Callable[..., Any]:
        """Do what changes nothing of the case, without drawing all of it again."""

        async def answer(*arguments: Any) -> None:
            with self.told(keep_message=True):
                action(*arguments)

        return answer

    def _answer_move(self, action: Callable[..., Any]) -> Callable[..., Any]:
        """Show where things are now; what takes longer follows, so that the hand is not held up."""

        async def answer(*arguments: Any) -> None:
            self.painter.move()
            with self.told(keep_message=True):
                action(*arguments)
                self._hover(*arguments)
            dragging = self.state.case.dragging
            if arguments[:1] == (HEAD,) and not dragging:
                self.painter.refresh_head()
                if self.painter.pictures:  # with its names, or they would run ahead of it
                    self.painter.refresh_measures(self.state.case.plan)
                return
            self.painter.refresh_views()
            if dragging and self._following is None:
                self._following = asyncio.get_running_loop().create_task(self._follow())

        return answer

    async def _follow(self) -> None:
        """Measure what is dragged beside the page, and show it."""
        try:
            await asyncio.sleep(FOLLOW_S)
            case, path = self.state.case, self.state.look.chosen
            if not case.dragging or path is None:
                return
            plan, judge = case.plan, partial(case.surroundings.judge, path, case.plan, rough=True)
            await asyncio.get_running_loop().run_in_executor(None, judge)
            if case.dragging:
                self.painter.refresh_measures(plan)
                self.shown.flush()
        finally:
            self._following = None

    def _keep_soon(self) -> None:
        """Keep where one looks, once that has stayed the same for a while: the wheel turns faster than a disk."""
        if self._keeping is not None:
            self._keeping.cancel()
        self._keeping = asyncio.get_running_loop().call_later(KEEP_S, self.keep)

    def keep(self) -> None:
        """Keep where one looks; what cannot be written is no reason to refuse anything, and is tried again."""
        self._keeping = None
        try:
            self.state.look.keep()
            self.unkept = None
        except RonnaplanError as error:
            self.unkept = error

    def _give_up(self) -> None:
        """Try no longer to make a change that could not be written."""
        self.state.case.unwritten.give_up()

    def _let_go(self) -> None:
        """End what is dragged before something is changed: here for good, on another page until its next move."""
        if self.state.case.dragging:
            with contextlib.suppress(RonnaplanError):  # an end in air goes back, which is seen
                if self.pointer.holding:
                    self.pointer.release(whole=False)
                else:
                    self.state.case.end_drag()

    def _hover(self, view: str, x: Pixels, y: Pixels, width: Pixels, height: Pixels) -> None:
        """Tell what is under the pointer."""
        self.painter.point(view, Pixel(x, y, width, height))

    def _point_at_crosshair(self, view: str) -> None:
        """Tell from now on, and aloud, what lies at the crosshair: somebody works by keyboard."""
        self.painter.point(view, None)

    def _press_key(self, key: str) -> None:
        if key not in self._keys:
            raise UsageError(f"there is no key '{key}' here; press ? for those there are")
        self._keys[key][1]()

    @contextlib.contextmanager
    def told(self, keep_message: bool = False) -> Iterator[None]:
        """Show what went wrong as a sentence; what goes well takes the last one away, unless it is kept."""
        try:
            yield
        except RonnaplanError as error:
            self.tell(error)
        else:
            if not keep_message:
                self.shown.update({"message": "", "news": ""})

    def tell(self, error: RonnaplanError) -> None:
        """Tell what ended what was asked for, and look whether another hand was the reason."""
        if isinstance(error, CancelledError):
            self.shown["news"] = str(error)
            return
        self.refuse(error)
        with contextlib.suppress(RonnaplanError):  # told by the next look; this was told first
            self.state.case.look_again()

    def refuse(self, error: RonnaplanError) -> None:
        """Tell what went wrong."""
        self._waits = isinstance(error, BusyError)
        self.shown["message"] = str(error)
        self.shown["refusals"] += 1
