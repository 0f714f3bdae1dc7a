"""The planner in a browser: the page's events become calls on the state, and what changed is drawn again."""

from __future__ import annotations

import asyncio
import base64
import contextlib
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

from ronnaplan.errors import RonnaplanError
from ronnaplan.planner import drawing
from ronnaplan.planner.cuts import PATH_VIEWS, STANDARD, WINDOWS_HU, jpeg
from ronnaplan.planner.judgement import Judgement
from ronnaplan.planner.pointer import ZOOM_STEP, Pixel, Pointer
from ronnaplan.planner.scene import Scene
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.surfaces import SURFACES_HU, region, surface
from ronnaplan.planning import INSTRUMENTS, Proposals
from ronnaplan.planning.trajectory import instrument_named

CUTS = (*STANDARD, *PATH_VIEWS)
PAGE = files("ronnaplan.planner") / "page"
READY = "research software, not a medical device"

FIRST_LOOK_S = 0.5
"""The browser has this long to draw the cuts before the rest is loaded."""


SENDING_S = 0.002
"""The web socket sends what was flushed while a handler pauses this long."""


def _template() -> str:
    """Return the page, with one view for every cut."""
    page = (PAGE / "planner.html").read_text(encoding="utf-8")
    view = (PAGE / "view.html").read_text(encoding="utf-8")
    return page.replace("<!-- views -->", "".join(view.replace("VIEW", name) for name in CUTS))


class PlannerApp:
    """Binds one `PlannerState` to one trame server."""

    def __init__(self, state: PlannerState, server: Any, tracker: tuple[str, int] | None = None) -> None:
        self.state, self.server, self.tracker = state, server, tracker
        self.pointer = Pointer(state)
        self.scene: Scene | None = None
        self.proposals: Proposals | None = None
        self.surface = "skin"
        self._turning: tuple[float, float] | None = None
        self._waking = False
        self._drawn: dict[str, Any] = {}
        self._keys: dict[str, Callable[[], None]] = {
            "a": self.pointer.add,
            "escape": self._escape,
            "f": state.fit,
            "s": self._other_surface,
            "ctrl+z": state.undo,
            "ctrl+y": state.redo,
            "1": lambda: state.choose_window("bone"),
            "2": lambda: state.choose_window("brain"),
            "3": lambda: state.choose_window("wide"),
            "pageup": lambda: state.scroll("axial", -1),
            "pagedown": lambda: state.scroll("axial", 1),
            "delete": lambda: state.remove(state.selected) if state.selected else None,
        }
        self._set_up_page()
        self._listen_to_page()
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
        values = self.server.state
        values.trame__title = "ronnaplan"
        values.update(
            {
                "windows": list(WINDOWS_HU),
                "keys": list(self._keys),
                "instruments": list(INSTRUMENTS),
                "tracker": "" if self.tracker is None else f"{self.tracker[0]}:{self.tracker[1]}",
                "tab": "paths",
                "show_rejected": False,
                "diameter": 11.5,
                "pointed": "",
                "pointed_reading": "",
                "message": READY,
                "placement": "",
                "proposals": [],
                "picture_head": "",
            }
        )
        values.change("show_rejected")(lambda **_: self.refresh())
        config = {"theme": {"defaultTheme": "dark"}}
        with VAppLayout(self.server, vuetify_config=config):
            html.Div(_template(), style="height: 100vh")
        self.refresh()

    async def _wake(self, **_: Any) -> None:
        """Once the first picture is seen: load what measures and what draws in 3-D, which takes seconds."""
        if self.scene is not None or self._waking:
            return
        self._waking = True
        await asyncio.sleep(FIRST_LOOK_S)
        await asyncio.get_running_loop().run_in_executor(None, self._warm_up)
        self.scene = Scene(self.state)
        self._show_surface()
        for name, mask in self.state.no_go.items():
            self.scene.show_region(name, *region(self.state.volume, mask))
        with self.server.state:
            self.refresh()

    def _warm_up(self) -> None:
        for one in self.state.plan.trajectories:
            self.state.judge(one)

    def refresh(self) -> None:
        """Draw whatever is not as the page has it; pictures only where their plane or window changed."""
        self._refresh_cuts()
        values, state = self.server.state, self.state
        judged = state.judge(state.chosen) if state.chosen and self.scene else Judgement(problem="measuring ...")
        values.markers, values.rejected = drawing.marker_rows(state), drawing.rejected_rows(state)
        values.paths, values.chosen = drawing.path_rows(state), drawing.chosen_path(state, judged)
        values.registration = drawing.registration_panel(state)
        values.readings = state.storage.readings()
        values.reading_labels = list(state.readings_mm.labels) if state.readings_mm else []
        values.look = {
            "window": state.window,
            "adding": self._asks(),
            "can_undo": bool(state.plan.history),
            "can_redo": bool(state.plan.undone),
            "surface": self.surface,
        }
        if self.scene is not None:
            values.picture_head = self._head_picture(self.scene)

    def _refresh_cuts(self) -> None:
        values = self.server.state
        for view in CUTS:
            values[f"drawn_{view}"] = drawing.over_cut(self.state, view, values.show_rejected)
            values[f"picture_{view}"] = self._picture(view)

    def _asks(self) -> str:
        if not self.pointer.adding:
            return ""
        return "click the entry" if self.pointer.entry_mm is None else "click the target"

    def _picture(self, view: str) -> str:
        state = self.state
        if view in PATH_VIEWS and state.chosen is None:
            return ""
        cut, window = state.cut(view), WINDOWS_HU[state.window]
        plane = (tuple(cut.centre_mm.round(6)), tuple(cut.right), tuple(cut.down), cut.field_mm, window)
        return self._kept(view, plane, lambda: jpeg(state.scan, cut, window))

    def _kept(self, view: str, key: Any, draw: Callable[[], bytes]) -> str:
        """Return the picture of a view, drawn anew only if ``key`` differs from the last time."""
        last = self._drawn.get(view)
        if last is None or last[0] != key:
            last = (key, f"data:image/jpeg;base64,{base64.b64encode(draw()).decode()}")
            self._drawn[view] = last
        picture: str = last[1]
        return picture

    # --- the head in 3-D ---------------------------------------------------------------------------------------

    def _head_key(self, scene: Scene) -> Any:
        paths = tuple(
            (one.name, *one.entry_mm, *one.target_mm, one.colour) for one in self.state.plan.trajectories
        )
        return (
            tuple(scene.camera.position_mm),
            self.surface,
            paths,
            id(self.state.fiducials),
            id(self.proposals),
            self.server.state.placement,
        )

    def _head_picture(self, scene: Scene) -> str:
        return self._kept("head", self._head_key(scene), lambda: self._draw_head(scene))

    def _draw_head(self, scene: Scene) -> bytes:
        scene.hide_paths()
        for one in self.state.plan.trajectories:
            scene.show_path(one, self.state.judge(one).measures)
        scene.show_markers()
        scene.show_proposals(self.proposals)
        return scene.draw()

    def _show_surface(self) -> None:
        if self.scene is not None:
            self.scene.show_surface(self.surface, *surface(self.state.volume, SURFACES_HU[self.surface]))

    def _other_surface(self) -> None:
        self.surface = "skull" if self.surface == "skin" else "skin"
        self._show_surface()

    def _escape(self) -> None:
        if self.pointer.adding:
            self.pointer.add()

    # --- events ------------------------------------------------------------------------------------------------

    def _listen_to_page(self) -> None:
        state = self.state
        actions: dict[str, Callable[..., Any]] = {
            "press": self._press,
            "release": self._release,
            "wheel": self._wheel,
            "key": lambda key: self._keys[key](),
            "window": state.choose_window,
            "select": state.select,
            "lock": state.lock,
            "remove": state.remove,
            "place": self._place,
            "colour": lambda name, colour: state.edit(name, colour=colour.lower()),
            "instrument": lambda name, kind: state.edit(name, instrument=instrument_named(kind)),
            "jump": state.jump_to_marker,
            "jump_rejected": self._jump_rejected,
            "reject": state.reject_marker,
            "accept": lambda index: state.accept_marker(int(index)),
            "rename": state.rename_marker,
            "readings": state.load_readings,
            "point": state.point_at,
            "take": self._take,
        }
        for name, action in actions.items():
            self.server.trigger(name)(self._answering(action))
        self.server.trigger("move")(self._answer_move)
        slow: dict[str, Callable[..., Callable[[], None]]] = {
            "localize": self._localize,
            "propose": self._propose,
            "placement": self._placement,
            "listen": self._hear,
        }
        for name, action in slow.items():
            self.server.trigger(name)(self._answering_later(action))

    def _answering(self, action: Callable[..., Any]) -> Callable[..., None]:
        def answer(*arguments: Any) -> None:
            with self._told():
                action(*arguments)
            self.refresh()

        return answer

    async def _answer_move(self, *arguments: Any) -> None:
        """Show where things are now before the measures are taken, so that the hand is followed at once."""
        with self._told():
            self._move(*arguments)
        self._refresh_cuts()
        self.server.state.flush()
        await asyncio.sleep(SENDING_S)
        self.refresh()

    def _answering_later(self, action: Callable[..., Any]) -> Callable[..., Any]:
        """Let ``action`` work in a thread; what it returns is called here, where the state may be changed."""

        async def answer(*arguments: Any) -> None:
            self.server.state.message = "working ..."
            self.server.state.flush()
            with self._told():
                finish = await asyncio.get_running_loop().run_in_executor(None, action, *arguments)
                finish()
            with self.server.state:
                self.refresh()

        return answer

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Show what went wrong as a sentence."""
        try:
            yield
            self.server.state.message = READY
        except RonnaplanError as error:
            self.server.state.message = str(error)

    def _press(self, view: str, x: float, y: float, width: float, height: float, button: int, shift: bool) -> None:
        if view == "head":
            self._turning = (x, y)
        else:
            self.pointer.press(view, Pixel(x, y, width, height), pan=bool(button) or shift)

    def _move(self, view: str, x: float, y: float, width: float, height: float) -> None:
        if view != "head":
            self.pointer.move(view, Pixel(x, y, width, height))
        elif self._turning is not None and self.scene is not None:
            self.scene.turn(x - self._turning[0], y - self._turning[1])
            self._turning = (x, y)

    def _release(self, view: str) -> None:
        self._turning = None
        if view != "head":
            self.pointer.release()

    def _wheel(self, view: str, steps: float, zoom: bool, x: float, y: float, width: float, height: float) -> None:
        if view != "head":
            self.pointer.wheel(view, steps, Pixel(x, y, width, height), zoom=zoom)
        elif self.scene is not None:
            self.scene.zoom(ZOOM_STEP**-steps)

    def _place(self, name: str, end: str, axis: int, value: str) -> None:
        """Take a coordinate from its field."""
        from ronnaplan.errors import UsageError

        try:
            number = float(value)
        except ValueError as error:
            raise UsageError(f"'{value}' is no coordinate; give mm in LPS") from error
        place = getattr(self.state.plan.trajectory(name), f"{end}_mm").copy()
        place[int(axis)] = number
        self.state.edit(name, **{f"{end}_mm": place})

    def _jump_rejected(self, index: int) -> None:
        if self.state.fiducials is not None:
            self.state.jump(self.state.fiducials.rejected[int(index)].center)

    def _take(self, index: int) -> None:
        """Use a proposed entry for the selected trajectory."""
        if self.proposals is not None and self.state.selected is not None:
            proposed = self.proposals.best[int(index)].trajectory
            self.state.edit(self.state.selected, entry_mm=proposed.entry_mm)

    # --- what takes longer: a thread computes, the returned function changes the state --------------------------

    def _localize(self, diameter: Any) -> Callable[[], None]:
        found = self.state.find_markers(float(diameter or 0))
        return lambda: self.state.replace_markers(found)

    def _propose(self, name: str) -> Callable[[], None]:
        found = self.state.propose(name)

        def show() -> None:
            self.proposals = found
            self.server.state.proposals = [(f"{one.score:.2f}", "; ".join(one.reasons)) for one in found.best]

        return show

    def _placement(self, count: int) -> Callable[[], None]:
        placed = self.state.propose_markers(int(count))

        def show() -> None:
            if self.scene is not None:
                self.scene.show_placement(placed.centres_mm)
            self.server.state.placement = (
                f"{len(placed.centres_mm)} places, largest expected error {placed.largest_tre_mm:.2f} mm "
                f"({placed.even_tre_mm:.2f} mm when spread evenly)"
            )

        return show

    def _hear(self) -> Callable[[], None]:
        from ronnaplan.errors import UsageError
        from ronnaplan.tracking import find_markers
        from ronnaplan.tracking.openigtlink import record

        if self.tracker is None:
            raise UsageError("no tracker was named; start the planner with --tracker HOST:PORT")
        seen = find_markers(record(*self.tracker)).points
        return lambda: self.state.register(seen)
