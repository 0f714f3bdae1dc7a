"""The planner in a browser: every page is answered for itself, the case is the same for all."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from ronnaplan.case.surroundings import scan_doubts
from ronnaplan.errors import RonnaplanError, UsageError
from ronnaplan.planner.actions import key_actions
from ronnaplan.planner.cuts import WINDOWS_HU
from ronnaplan.planner.handing import EXPORTED
from ronnaplan.planner.head_look import OPENINGS
from ronnaplan.planner.judging import Judging
from ronnaplan.planner.page_files import MODULE, templates
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.shown import Send
from ronnaplan.planner.sockets import ASKING
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import LAYOUTS
from ronnaplan.planner.tab import Tab
from ronnaplan.planner.unwritten import write_again
from ronnaplan.planner.working import Working
from ronnaplan.planning import INSTRUMENTS
from ronnaplan.planning.electrodes import ELECTRODES, NO_ELECTRODE
from ronnaplan.planning.lengths import USUAL_DIAMETER_MM
from ronnaplan.scene.head import HeadParts, head_parts
from ronnaplan.scene.surfaces import SURFACES
from ronnaplan.scene.volume import PRESETS
from ronnaplan.scene.vtk import Workshop

CHANGED = "another hand has changed the case; it is shown as it is now"

LOOK_AGAIN_S = 0.5
"""How often the files are looked at for what another hand has written; shown within 2 s, drawing included."""

LEAVING_S = 0.1
"""The answer to who leaves goes out first."""

MOST_TRIANGLES = 40_000
"""Of a surface: as many as are drawn again and again while an end is dragged, without a graphics card."""


def _in_print(key: str) -> str:
    """Return a key as it is printed on a keyboard."""
    names = {"pageup": "Page Up", "pagedown": "Page Down"}
    return " + ".join(names.get(part, part.title()) for part in key.split("+"))


class PlannerApp:
    """Binds one open case to one trame server: each page is a `Tab` of its own."""

    def __init__(
        self,
        state: PlannerState,
        server: Any,
        tracker: tuple[str, int] | None = None,
        patient: str | None = None,
        leavable: bool = False,
        workshop: Workshop | None = None,
    ) -> None:
        """Bind ``state``; ``patient`` is the name to show, None to show none; ``leavable`` offers the start page."""
        self.state, self.server, self.tracker, self.patient = state, server, tracker, patient
        self.tabs: dict[str, Tab] = {}
        self._spare: Tab | None = None
        """What the first page will show."""
        self._ahead = ThreadPoolExecutor(1)
        """Draws it while the browser is already answered, and waits for the head then."""
        self.parts: HeadParts | None = None
        """What the head is drawn from, None until it is made."""
        self.left = False
        """Whether a page asked for the start page."""
        self.working = Working(self.tell_all, self._told, self.refresh)
        state.start = self.working.start
        self.judging = Judging(
            state.case, self.refresh, lambda: {tab.state.look.selected for tab in self.tabs.values()}
        )
        state.following.notify = self._tools_moved
        self._tools_due = False
        self._loop: asyncio.AbstractEventLoop | None = None
        self._latest = state
        self._workshop = workshop
        self._making: asyncio.Task[None] | None = None
        self._watching: asyncio.Task[None] | None = None
        self._set_up_page()
        for name in Tab(state).names:
            server.trigger(name)(partial(self._answer, name))
        server.state.leavable = leavable
        if leavable:
            server.trigger("leave")(self._leave)
        server.controller.on_server_ready.add_task(self._watch)
        server.controller.on_client_connected.add_task(self._wake)

    def _set_up_page(self) -> None:
        from trame.ui.html import DivLayout

        self.server.enable_module(MODULE)
        keys = key_actions(self.state, Pointer(self.state))
        self.server.state.trame__title = "ronnaplan"
        self.server.state.update(
            {
                "windows": list(WINDOWS_HU),
                "keys": list(keys),
                "key_help": [(_in_print(key), words) for key, (words, _) in keys.items()],
                "layouts": list(LAYOUTS),
                "exported": {name: document for name, (document, _) in EXPORTED.items()},
                "instruments": list(INSTRUMENTS),
                "electrodes": [NO_ELECTRODE, *ELECTRODES],
                "tracker": "" if self.tracker is None else f"{self.tracker[0]}:{self.tracker[1]}",
                "patient": "" if self.patient is None else self.patient or "(no name)",
                "surfaces": list(SURFACES),
                "presets": list(PRESETS),
                "openings": list(OPENINGS),
                "scan": self.state.case.volume.voxel_sha256,
                "scan_doubts": list(scan_doubts(self.state.case.volume)),
            }
        )
        for name, text in templates().items():
            with DivLayout(self.server, name, classes=f"rp-{name}") as part:
                part.root.add_child(text)

    # --- pages -----------------------------------------------------------------------------------------------

    def opened(self, page: str, send: Send) -> None:
        """Show the case on a page: it looks where the page looked that did something last."""
        tab, self._spare = self._spare or self._tab(), None
        tab.shown.send = send
        tab.shown["work"] = self.working.told
        self._open_head(tab)
        tab.painter.refresh()
        self.tabs[page], self._latest = tab, tab.state

    def _tab(self) -> Tab:
        tab = Tab(
            self._latest.beside(),
            tracker=self.tracker,
            measured=self.judging.is_done,
            cancel=self.working.cancel,
            idle=self.working.is_idle,
            others=self._draw_others,
        )
        found = self.state.case.fiducials
        tab.shown["diameter"] = found.marker.diameter_mm if found else USUAL_DIAMETER_MM
        return tab

    async def _draw_ahead(self) -> None:
        """Draw what the first page will show, while its browser still loads the page's own files."""
        if not self.tabs:
            spare = self._tab()
            await asyncio.get_running_loop().run_in_executor(self._ahead, spare.painter.refresh)
            if self.tabs:  # one has begun without it
                spare.close()
            else:
                self._spare = spare

    def closed(self, page: str) -> None:
        """Forget a page; what it dragged is let go, and shown so on the others."""
        tab = self.tabs.pop(page, None)
        if tab is not None:
            dragging = self.state.case.dragging
            tab.close()
            if dragging:
                self.refresh()

    def whole(self, page: str) -> dict[str, Any]:
        """Return all that a page shows of its own."""
        return self.tabs[page].shown.whole()

    def changed(self, page: str, changes: list[dict[str, Any]]) -> None:
        """Take over what a page set itself."""
        self.tabs[page].take(changes)

    async def _answer(self, name: str, *arguments: Any) -> None:
        tab = self.tabs[ASKING.get()]
        self._latest = tab.state
        await tab.answer(name, arguments)
        self.judging.soon()

    async def _leave(self) -> None:
        """Close the case, all of which is kept: the start page takes the place of the planner."""
        tab = self.tabs[ASKING.get()]
        with tab.told():
            self.working.require_idle()
            if self.state.case.unwritten:
                raise UsageError("the last change is not written yet; let it be written, or give it up first")
            asyncio.get_running_loop().call_later(LEAVING_S, self.leave)
        tab.shown.flush()

    def leave(self) -> None:
        """Stop the server for the start page."""
        self.left = True
        for task in (self._watching, self._making):
            if task is not None:
                task.cancel()
        asyncio.ensure_future(self.server.stop())  # noqa: RUF006  # ends with the loop

    def forget(self) -> None:
        """Let the case go: trame keeps its server, and with that this, for as long as the process lasts."""
        if self._workshop is not None:
            self._workshop.end()  # which holds the scan, and may not be done
        self.working.cancel()  # the program would wait for it
        self._ahead.shutdown()
        self.state.following.stop()
        self.tabs.clear()
        self.parts = self._spare = None
        self._watching = self._making = None  # the frames of a canceled one hold the case
        del self.state, self._latest, self.working, self.judging

    def refresh(self) -> None:
        """Draw whatever is not as the pages have it; what takes long to measure follows."""
        self.judging.soon()  # first: what one page measures as it is drawn is to be shown on those before it, too
        for tab in self.tabs.values():
            tab.refresh()

    def tell_all(self, values: Mapping[str, Any]) -> None:
        """Show something on every page."""
        for tab in self.tabs.values():
            tab.shown.update(values)
            tab.shown.flush()

    def show_readings(self) -> None:
        """Show which readings lie in the case's folder now."""
        self.tell_all({"news": "readings were put into the case; register with them in the panel Registration"})
        self.refresh()

    def _tools_moved(self) -> None:
        """Have the pages drawn once the last drawing is done: called by the thread that follows tools."""
        if self._loop is not None and not self._tools_due:
            self._tools_due = True
            with contextlib.suppress(RuntimeError):  # the planner is ending
                self._loop.call_soon_threadsafe(self._show_tools)

    def _show_tools(self) -> None:
        self._tools_due = False
        following = self.state.following
        ended, following.ended = following.ended, None
        with self._told():
            if ended is not None:
                raise ended
        self.refresh()

    def _draw_others(self, but: Tab) -> None:
        for tab in self.tabs.values():
            if tab is not but:
                tab.painter.rest_soon()

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Show on every page what went wrong with what takes long."""
        try:
            yield
        except RonnaplanError as error:
            for tab in self.tabs.values():
                tab.tell(error)

    # --- what takes long -------------------------------------------------------------------------------------

    async def _wake(self, **_: Any) -> None:
        await self.judging.begin()

    async def _make_head(self) -> None:
        """Have what is drawn in 3-D made by a process that gives way to whatever is waited for."""
        self._workshop = self._workshop or Workshop()
        self.parts = await asyncio.get_running_loop().run_in_executor(
            self._ahead, head_parts, self._workshop, self.state.case.volume, self.state.masks, MOST_TRIANGLES
        )
        for tab in self.tabs.values():
            self._open_head(tab)
        self.refresh()

    def _open_head(self, tab: Tab) -> None:
        if self.parts is not None:
            tab.head.open(self.parts)
            tab.pointer.head = tab.head.scene

    async def _watch(self, **_: Any) -> None:
        """Draw what the first page will show, have the head made, and show what another hand writes from then on."""
        self._watching, self._loop = asyncio.current_task(), asyncio.get_running_loop()
        await self._draw_ahead()
        self._making = self._loop.create_task(self._make_head())
        while True:
            await asyncio.sleep(LOOK_AGAIN_S)
            if write_again(self.state.case, self.tabs.values()):
                self.refresh()
            try:
                news = self.state.case.look_again()
                if news:
                    self.tell_all({"news": CHANGED})
            except RonnaplanError as error:
                news = True
                for tab in self.tabs.values():
                    tab.refuse(error)
            if news:
                self.refresh()
