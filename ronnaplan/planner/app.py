"""The planner in a browser: the page's events become calls on the state, and what changed is drawn again."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

from ronnaplan.errors import RonnaplanError, UsageError
from ronnaplan.planner import panels
from ronnaplan.planner.actions import Actions, key_actions
from ronnaplan.planner.arguments import Pixels, checked
from ronnaplan.planner.cuts import HEAD, PATH_VIEWS, STANDARD, WINDOWS_HU
from ronnaplan.planner.head_actions import HeadActions
from ronnaplan.planner.head_look import OPENINGS
from ronnaplan.planner.head_view import HeadView
from ronnaplan.planner.painter import CUTS, Painter
from ronnaplan.planner.pixels import Pixel
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import LAYOUTS
from ronnaplan.planner.worker import CancelledError
from ronnaplan.planner.working import Working
from ronnaplan.planning import INSTRUMENTS
from ronnaplan.planning.electrodes import ELECTRODES, NO_ELECTRODE
from ronnaplan.planning.sites import USUAL_DIAMETER_MM
from ronnaplan.scene.surfaces import SURFACES
from ronnaplan.scene.volume import PRESETS

PAGE = files("ronnaplan.planner") / "page"
SCENE_PAGE = files("ronnaplan.scene") / "page"
CHANGED = "another hand has changed the case; it is shown as it is now"

FIRST_LOOK_S = 0.5
"""The browser has this long to draw the cuts before the rest is loaded."""

LOOK_AGAIN_S = 0.5
"""How often the files are looked at for what another hand has written; shown within 2 s, drawing included."""

SENDING_S = 0.002
"""The web socket sends what was flushed while a handler pauses this long."""


def _template() -> str:
    """Return the page, with one view for every cut and one for the head."""
    page, view, cube = (
        (PAGE / name).read_text(encoding="utf-8") for name in ("planner.html", "view.html", "cube.html")
    )
    views = {name: view.replace("VIEW", name) for name in (*STANDARD, HEAD, *PATH_VIEWS)}
    views[HEAD] = views[HEAD].replace("<svg", "<canvas data-scene></canvas><svg", 1).replace("<!-- more -->", cube)
    return page.replace("<!-- views -->", "".join(views.values()))


def _in_print(key: str) -> str:
    """Return a key as it is printed on a keyboard."""
    names = {"pageup": "Page Up", "pagedown": "Page Down"}
    return " + ".join(names.get(part, part.title()) for part in key.split("+"))


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
        self.painter = Painter(state, server, self.pointer, self.head)
        self.working = Working(server, self._told, self.refresh)
        state.start = self.working.start
        self.actions = Actions(state, self.pointer, tracker)
        self._keys = key_actions(state, self.pointer)
        self._waking = False
        self._measuring: asyncio.Task[None] | None = None
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
                "serve": {"planner_page": folder, "scene_page": str(Path(str(SCENE_PAGE)))},
                "scripts": [
                    "scene_page/viewer.js",
                    "scene_page/volume.js",
                    *(f"planner_page/{name}.js" for name in ("planner", "head", "files")),
                ],
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
                "layouts": list(LAYOUTS),
                "instruments": list(INSTRUMENTS),
                "electrodes": [NO_ELECTRODE, *ELECTRODES],
                "tracker": "" if self.tracker is None else f"{self.tracker[0]}:{self.tracker[1]}",
                "patient": "" if self.patient is None else self.patient or "(no name)",
                "tab": "paths",
                "show_rejected": False,
                "diameter": found.marker.diameter_mm if found else USUAL_DIAMETER_MM,
                "marker_count": 6,
                "message": "",
                "news": "",
                "under": "",
                "things": [],
                "volume": {},
                "surfaces": list(SURFACES),
                "presets": list(PRESETS),
                "openings": list(OPENINGS),
                "picture_head": "",
                "refusals": 0,
            }
        )
        values.change("show_rejected")(lambda **_: self.refresh())
        config = {"theme": {"defaultTheme": "dark"}}
        with VAppLayout(self.server, vuetify_config=config):
            html.Div(_template(), classes="rp-page")
        self.refresh()

    def refresh(self) -> None:
        """Draw whatever is not as the page has it; what takes long to measure follows."""
        self.painter.refresh()
        if self._waking and self._measuring is None and not self.painter.measured:
            self._measuring = asyncio.get_running_loop().create_task(self._measure())

    def show_readings(self) -> None:
        """Show which readings lie in the case's folder now."""
        with self.server.state:
            self.server.state.news = (
                "readings were put into the case; register with them in the panel Registration"
            )
            self.refresh()

    async def _measure(self) -> None:
        """Measure all trajectories beside the page, for as long as what they are measured against changes."""
        while not self.painter.measured:
            around, plan = self.state.case.surroundings, self.state.case.plan
            await asyncio.get_running_loop().run_in_executor(None, around.judge_all, plan)
            self.painter.measured_against = around
        self._measuring = None
        with self.server.state:
            self.refresh()

    async def _wake(self, **_: Any) -> None:
        """Once the first picture is seen: load what measures and what draws in 3-D, which takes seconds."""
        if self._waking:
            return
        self._waking = True
        await asyncio.sleep(FIRST_LOOK_S)
        self.refresh()
        await asyncio.get_running_loop().run_in_executor(None, self.head.load)
        self.head.open()
        self.pointer.head = self.head.scene
        with self.server.state:
            self.refresh()

    async def _watch(self, **_: Any) -> None:
        """Show what another hand has written."""
        while True:
            await asyncio.sleep(LOOK_AGAIN_S)
            with self.server.state:
                try:
                    news = self.state.case.look_again()
                    if news:
                        self.server.state.news = CHANGED
                except RonnaplanError as error:
                    news = True
                    self._refuse(error)
                if news:
                    self.refresh()

    # --- events ----------------------------------------------------------------------------------------------

    def _listen_to_page(self) -> None:
        done: dict[str, Callable[..., Any]] = {
            **self.actions.by_name(),
            "key": self._press_key,
            "cancel": self.working.cancel,
            **HeadActions(self.state, self.painter, self.server).by_name(),
        }
        for name, action in done.items():
            answer = self._answering(
                checked(name, action),
                keep_message=name in ("release", "pictures", "volume_is_slow"),
                moves=name == "wheel",
            )
            self.server.trigger(name)(answer)
        self.server.trigger("dismiss")(self._answering(self._dismiss, keep_message=False, moves=False))
        self.server.trigger("sized")(self._telling(checked("sized", self._take_size)))
        self.server.trigger("hover")(self._telling(checked("hover", self._hover)))
        self._follow = checked("move", self.actions.move)
        self.server.trigger("move")(self._answer_move)

    def _press_key(self, key: str) -> None:
        if key not in self._keys:
            raise UsageError(f"there is no key '{key}' here; press ? for those there are")
        self._keys[key][1]()

    def _answering(self, action: Callable[..., Any], keep_message: bool, moves: bool) -> Callable[..., None]:
        def answer(*arguments: Any) -> None:
            if moves:
                self.painter.move()
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
        self.painter.take_size(view, width, height, ratio)

    def _hover(self, view: str, x: Pixels, y: Pixels, width: Pixels, height: Pixels) -> None:
        """Tell what is under the pointer."""
        cut_shown = view in CUTS and (view in STANDARD or self.state.look.chosen is not None)
        at = Pixel(x, y, width, height)
        self.server.state.under = panels.under_line(self.state, view, at) if cut_shown else ""

    async def _answer_move(self, *arguments: Any) -> None:
        """Show where things are now before the measures are taken, so that the hand is followed at once.

        A head that is turned is drawn with its names in one go, or they would run ahead of it.
        """
        self.painter.move()
        with self._told(keep_message=True):
            self._follow(*arguments)
        turned = arguments[:1] == (HEAD,) and not self.state.case.dragging
        if turned and not self.painter.pictures:
            self.painter.refresh_head()
            return
        if not turned:
            self.painter.refresh_views()
            self.server.state.flush()
            await asyncio.sleep(SENDING_S)
        self.refresh()

    @contextlib.contextmanager
    def _told(self, keep_message: bool = False) -> Iterator[None]:
        """Show what went wrong as a sentence; what goes well takes the last one away, but for a mere release."""
        values = self.server.state
        try:
            yield
        except CancelledError as error:
            values.news = str(error)
        except RonnaplanError as error:
            self._refuse(error)
            with contextlib.suppress(RonnaplanError):  # told by the next look; this was told first
                self.state.case.look_again()
        else:
            if not keep_message:
                self._dismiss()

    def _dismiss(self) -> None:
        """Take what was told away."""
        self.server.state.update({"message": "", "news": ""})

    def _refuse(self, error: RonnaplanError) -> None:
        self.server.state.message = str(error)
        self.server.state.refusals += 1
