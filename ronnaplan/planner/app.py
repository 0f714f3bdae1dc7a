"""The planner in a browser: the page's events become calls on the state, and what changed is drawn again."""

from __future__ import annotations

import asyncio
import base64
import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from ronnaplan.case.surroundings import Judgement
from ronnaplan.errors import RonnaplanError, UsageError
from ronnaplan.planner import drawing, panels
from ronnaplan.planner.actions import Actions, key_actions
from ronnaplan.planner.arguments import Pixels, checked
from ronnaplan.planner.cuts import PATH_VIEWS, STANDARD, WINDOWS_HU, jpeg, picture, png
from ronnaplan.planner.head_view import HeadView
from ronnaplan.planner.overlay import over_head
from ronnaplan.planner.panes import GREATEST_RATIO, MOST_MOVING_PIXELS, MOST_STILL_PIXELS, Pane
from ronnaplan.planner.pointer import HEAD, Pixel, Pointer
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import INSTRUMENTS
from ronnaplan.planning.sites import USUAL_DIAMETER_MM

CUTS = (*STANDARD, *PATH_VIEWS)
PAGE = files("ronnaplan.planner") / "page"
READY = "research software, not a medical device"
WORKING = "working ..."
CHANGED = "another hand has changed the case; it is shown as it is now"

FIRST_LOOK_S = 0.5
"""The browser has this long to draw the cuts before the rest is loaded."""

LOOK_AGAIN_S = 0.5
"""How often the files are looked at for what another hand has written; shown within 2 s, drawing included."""

REST_S = 0.2
"""When nothing has moved for so long, pictures are drawn with all pixels and without loss."""

SENDING_S = 0.002
"""The web socket sends what was flushed while a handler pauses this long."""


def _template() -> str:
    """Return the page, with one view for every cut and one for the head."""
    page = (PAGE / "planner.html").read_text(encoding="utf-8")
    view = (PAGE / "view.html").read_text(encoding="utf-8")
    return page.replace(
        "<!-- views -->", "".join(view.replace("VIEW", name) for name in (*STANDARD, HEAD, *PATH_VIEWS))
    )


def _in_print(key: str) -> str:
    """Return a key as it is printed on a keyboard."""
    names = {"pageup": "Page Up", "pagedown": "Page Down"}
    return " + ".join(names.get(part, part.title()) for part in key.split("+"))


@dataclass(frozen=True)
class _Drawn:
    """A picture that the page has: ``of`` what, and whether it is as it is ``still``."""

    of: tuple[Any, ...]
    still: bool
    url: str


class PlannerApp:
    """Binds one `PlannerState` to one trame server."""

    def __init__(
        self,
        state: PlannerState,
        server: Any,
        tracker: tuple[str, int] | None = None,
        patient: str | None = None,
    ) -> None:
        """Bind ``state``; ``patient`` is the name to show, None to show none."""
        self.state, self.server, self.tracker, self.patient = state, server, tracker, patient
        self.head = HeadView(state)
        self.pointer = Pointer(state)
        self.actions = Actions(state, self.pointer)
        self._keys = key_actions(state, self.pointer)
        self._waking = False
        self._drawn: dict[str, _Drawn] = {}
        self._panes = dict.fromkeys((*CUTS, HEAD), Pane())
        self._moving = False
        self._resting: asyncio.TimerHandle | None = None
        self._working: set[asyncio.Task[None]] = set()
        self._set_up_page()
        self._listen_to_page()
        server.controller.on_server_ready.add_task(self._watch)
        server.controller.on_client_connected.add_task(self._wake)

    # --- the page --------------------------------------------------------------------------------------------

    def _set_up_page(self) -> None:
        from trame.ui.vuetify3 import VAppLayout
        from trame.widgets import html

        folder = str(Path(str(PAGE)))
        self.server.enable_module(
            {
                "serve": {"planner_page": folder},
                "scripts": ["planner_page/planner.js"],
                "styles": ["planner_page/planner.css"],
            }
        )
        values, found = self.server.state, self.state.case.fiducials
        values.trame__title = "ronnaplan"
        values.update(
            {
                "windows": list(WINDOWS_HU),
                "keys": list(self._keys),
                "key_help": [(_in_print(key), words) for key, (words, _) in self._keys.items()],
                "instruments": list(INSTRUMENTS),
                "tracker": "" if self.tracker is None else f"{self.tracker[0]}:{self.tracker[1]}",
                "patient": "" if self.patient is None else self.patient or "(no name)",
                "tab": "paths",
                "show_rejected": False,
                "diameter": found.marker.diameter_mm if found else USUAL_DIAMETER_MM,
                "marker_count": 6,
                "ready": READY,
                "message": READY,
                "under": "",
                "refusals": 0,
            }
        )
        values.change("show_rejected")(lambda **_: self.refresh())
        config = {"theme": {"defaultTheme": "dark"}}
        with VAppLayout(self.server, vuetify_config=config):
            html.Div(_template(), style="height: 100vh")
        self.refresh()

    async def _wake(self, **_: Any) -> None:
        """Once the first picture is seen: load what measures and what draws in 3-D, which takes seconds."""
        if self._waking:
            return
        self._waking = True
        await asyncio.sleep(FIRST_LOOK_S)
        await asyncio.get_running_loop().run_in_executor(None, self._warm_up)
        self.head.open()
        self.pointer.head = self.head.scene
        with self.server.state:
            self.refresh()

    def _warm_up(self) -> None:
        for one in self.state.case.plan.trajectories:
            self.state.case.judge(one)
        self.head.load()

    async def _watch(self, **_: Any) -> None:
        """Show what another hand has written."""
        while True:
            await asyncio.sleep(LOOK_AGAIN_S)
            with self.server.state:
                try:
                    news = self.state.case.look_again()
                    if news:
                        self.server.state.message = CHANGED
                except RonnaplanError as error:
                    news = True
                    self._refuse(error)
                if news:
                    self.refresh()

    # --- drawing ---------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Draw whatever is not as the page has it; pictures only where their plane or window changed."""
        self._refresh_views()
        values, state = self.server.state, self.state
        judged = (
            state.case.judge(state.look.chosen)
            if state.look.chosen and self.head.scene
            else Judgement(problem="measuring ...")
        )
        values.markers, values.rejected = panels.marker_rows(state), panels.rejected_rows(state)
        values.paths, values.chosen = panels.path_rows(state), panels.chosen_path(state, judged)
        values.landmarks = panels.landmark_rows(state)
        values.registration, values.pointing = panels.registration_panel(state), panels.pointing_panel(state)
        values.proposals, values.placement = panels.proposal_rows(state), panels.placement_line(state)
        values.readings = state.storage.readings()
        values.look = {
            "window": state.look.window,
            "level": round(sum(state.look.window_hu) / 2, 1),
            "width": round(state.look.window_hu[1] - state.look.window_hu[0], 1),
            "adding": self._asks(),
            "can_undo": state.case.can_undo,
            "can_redo": state.case.can_redo,
            "surface": state.look.surface,
            "marker": state.look.marker or "",
            "sought": state.case.fiducials.marker.diameter_mm if state.case.fiducials else 0,
        }
        values.picture_head = self.head.picture(self._shape(HEAD))

    def _refresh_views(self) -> None:
        """Draw the cuts, and what lies over the 3-D picture."""
        values = self.server.state
        for view in CUTS:
            values[f"drawn_{view}"] = drawing.over_cut(self.state, view, values.show_rejected, self._panes[view])
            values[f"picture_{view}"] = self._picture(view)
        values.drawn_head = over_head(
            self.state,
            self.head.camera,
            values.show_rejected,
            self.head.region_places_mm,
            self._panes[HEAD],
            self.head.wanting,
        )

    def _asks(self) -> str:
        if not self.pointer.adding:
            return ""
        return "click the entry" if self.state.look.begun_mm is None else "click the target"

    def _picture(self, view: str) -> str:
        state = self.state
        if view in PATH_VIEWS and state.look.chosen is None:
            return ""
        cut, window, pane = state.look.cut(view), state.look.window_hu, self._panes[view]
        of = (tuple(cut.center_mm.round(6)), tuple(cut.right), tuple(cut.down), cut.field_mm, window, pane)
        last = self._drawn.get(view)
        if last is None or last.of != of or not (last.still or self._moving):
            shades = picture(state.look.scan, cut, window, self._shape(view))
            kind, drawn = ("jpeg", jpeg(shades)) if self._moving else ("png", png(shades))
            url = f"data:image/{kind};base64,{base64.b64encode(drawn).decode()}"
            last = self._drawn[view] = _Drawn(of, not self._moving, url)
        return last.url

    def _shape(self, view: str) -> tuple[int, int]:
        """Return rows and columns of a view's picture as it is drawn now."""
        if not self._moving:
            return self._panes[view].shape(MOST_STILL_PIXELS)
        # while an end is dragged all views are drawn, and the head takes longest
        held = view == HEAD and self.state.case.dragging
        return self._panes[view].shape(MOST_MOVING_PIXELS // 3 if held else MOST_MOVING_PIXELS)

    # --- events ----------------------------------------------------------------------------------------------

    def _listen_to_page(self) -> None:
        for name, action in {**self.actions.by_name(), "key": self._press_key}.items():
            moves = name == "wheel"
            answer = self._answering(checked(name, action), keep_message=name == "release", moves=moves)
            self.server.trigger(name)(answer)
        self.server.trigger("sized")(self._telling(checked("sized", self._take_size)))
        self.server.trigger("hover")(self._telling(checked("hover", self._hover)))
        self._follow = checked("move", self.actions.move)
        self.server.trigger("move")(self._answer_move)
        for name, slow in {**self.actions.later_by_name(), "listen": self._hear}.items():
            self.server.trigger(name)(self._answering_later(checked(name, slow)))

    def _press_key(self, key: str) -> None:
        if key not in self._keys:
            raise UsageError(f"there is no key '{key}' here; press ? for those there are")
        self._keys[key][1]()

    def _answering(self, action: Callable[..., Any], keep_message: bool, moves: bool) -> Callable[..., None]:
        def answer(*arguments: Any) -> None:
            if moves:
                self._move()
            with self._told(keep_message):
                action(*arguments)
            self.refresh()

        return answer

    def _telling(self, action: Callable[..., Any]) -> Callable[..., None]:
        """Answer what changes nothing of the case, without drawing all of it again."""

        def answer(*arguments: Any) -> None:
            with self._told(keep_message=True):
                action(*arguments)

        return answer

    def _take_size(self, view: str, width: Pixels, height: Pixels, ratio: float) -> None:
        """Take how large the page shows a view; it is drawn so large when all are known."""
        if view not in self._panes or not 0 < ratio <= GREATEST_RATIO:
            raise UsageError(f"there is no view {view} with {ratio:g} pixels to one; reload the page")
        self._panes[view] = Pane(max(width, 1.0), max(height, 1.0), ratio)
        self._rest_soon()

    def _hover(self, view: str, x: Pixels, y: Pixels, width: Pixels, height: Pixels) -> None:
        """Tell what is under the pointer."""
        cut_shown = view in CUTS and (view in STANDARD or self.state.look.chosen is not None)
        at = Pixel(x, y, width, height)
        self.server.state.under = panels.under_line(self.state, view, at) if cut_shown else ""

    def _move(self) -> None:
        """Draw coarsely from now on, until nothing has moved for a while."""
        self._moving = True
        self._rest_soon()

    def _rest_soon(self) -> None:
        if self._resting is not None:
            self._resting.cancel()
        self._resting = asyncio.get_running_loop().call_later(REST_S, self._rest)

    def _rest(self) -> None:
        self._moving, self._resting = False, None
        with self.server.state:
            self.refresh()

    async def _answer_move(self, *arguments: Any) -> None:
        """Show where things are now before the measures are taken, so that the hand is followed at once.

        A head that is turned is drawn with its names in one go, or they would run ahead of it.
        """
        self._move()
        with self._told(keep_message=True):
            self._follow(*arguments)
        if arguments[:1] != (HEAD,) or self.state.case.dragging:
            self._refresh_views()
            self.server.state.flush()
            await asyncio.sleep(SENDING_S)
        self.refresh()

    def _answering_later(self, action: Callable[..., Any]) -> Callable[..., Any]:
        """Let ``action`` work in a thread; what it returns is called here, where the state may be changed.

        The page is answered at once: it sends what is done next only then.
        """

        async def work(*arguments: Any) -> None:
            with self._told():
                finish = await asyncio.get_running_loop().run_in_executor(None, action, *arguments)
                finish()
            with self.server.state:
                self.refresh()

        def answer(*arguments: Any) -> None:
            self.server.state.message = WORKING
            task = asyncio.get_running_loop().create_task(work(*arguments))
            self._working.add(task)  # the loop itself would let it be collected
            task.add_done_callback(self._working.discard)

        return answer

    @contextlib.contextmanager
    def _told(self, keep_message: bool = False) -> Iterator[None]:
        """Show what went wrong as a sentence; what goes well takes the last one away, but for a mere release."""
        try:
            yield
        except RonnaplanError as error:
            self._refuse(error)
            with contextlib.suppress(RonnaplanError):  # told by the next look; this was told first
                self.state.case.look_again()
        else:
            if not keep_message:
                self.server.state.message = READY

    def _refuse(self, error: RonnaplanError) -> None:
        self.server.state.message = str(error)
        self.server.state.refusals += 1

    def _hear(self) -> Callable[[], None]:
        """Listen to the tracker."""
        from ronnaplan.tracking.openigtlink import record

        if self.tracker is None:
            raise UsageError("no tracker was named; start the planner with --tracker HOST:PORT")
        seen = self.state.registering.markers_of(record(*self.tracker))
        return lambda: self.state.registering.register(*seen)
