"""The start page: a scan is dropped or looked for below a root and opened as a case; the planner takes its place."""

from __future__ import annotations

import asyncio
import json
import logging
import re
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
from aiohttp import web
from numpy.typing import NDArray

from ronnaplan.case.folder import PLAN
from ronnaplan.errors import InputError, RonnaplanError, UsageError
from ronnaplan.planner.address import Address, needed_place
from ronnaplan.planner.dropped import Dropped
from ronnaplan.planner.gate import gate, is_worth_telling
from ronnaplan.planner.page_files import PAGE
from ronnaplan.planner.places import Found, Places, rows, series_at
from ronnaplan.planner.shelves import Shelf, Shelves, keyed
from ronnaplan.planner.state import PlannerState
from ronnaplan.text import printable

SERVED = {"index.html": "start.html", "start.js": "start.js", "start.css": "start.css"}
KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}

CASE_NAME = re.compile(r"[\w-]([\w. -]{0,58}[\w-])?", re.ASCII)

Open = Callable[[Path, str | None, Path], PlannerState]
"""Reads the scan at a path, the series of that key, and opens its case with the plan at another path."""


class StartPage:
    """Serves the page until a case is open; `state` is that case then."""

    def __init__(self, home: Path, root: Path, open_case: Open, shelf: Shelf | None = None) -> None:
        """New cases are made in ``home``; what lies below ``root``, or on the ``shelf``, can be looked through."""
        self.home, self.places, self.open_case, self.shelves = home, Places(root), open_case, Shelves(shelf)
        self.dropped = Dropped(home)
        self.found: dict[str, Found] = {}
        self.state: PlannerState | None = None
        self._from_drop = False
        self._opened = asyncio.Event()
        self._busy = ""

    def routes(self) -> list[web.RouteDef]:
        """Return what is answered."""
        return [
            *(web.get(f"/{name}", _page(file)) for name, file in SERVED.items()),
            web.get("/folders", _told(self._folders)),
            web.get("/series", _told(self._series)),
            web.get("/thumbnail/{key}", self._thumbnail),
            web.post("/drop", _told(self._drop)),
            web.put("/dropped", _told(self._keep)),
            web.post("/open", _told(self._open)),
            web.get("/archive", _told(self.shelves.look)),
            web.get("/archive/{key}", self._shelved),
            web.post("/fetch", _told(self._fetch)),
        ]

    async def opened(self) -> None:
        """Wait until a case is open."""
        await self._opened.wait()

    async def _folders(self, request: web.Request) -> Any:
        return self.places.listed(request.query.get("at", ""))

    async def _series(self, request: web.Request) -> Any:
        """Look for series in what was dropped, or at a place below the root."""
        at = request.query.get("at")
        if at is None:
            self.dropped.require(request.query.get("drop", ""))
        path = self.dropped.scan if at is None else self.places.at(at)
        called = "what was dropped" if at is None else printable(at) or "the root"
        found = await self._work("looking for series", lambda: series_at(path, self.places.root, called))
        self.found, series = keyed(found, rows(found))
        self._from_drop = at is None
        return {"series": series, "name": self._free_name() if self._from_drop else ""}

    async def _thumbnail(self, request: web.Request) -> web.Response:
        one = self.found.get(request.match_info["key"])
        return _picture(None if one is None else one.picture)

    async def _shelved(self, request: web.Request) -> web.Response:
        return _picture(await self.shelves.picture(request))

    async def _drop(self, _: web.Request) -> Any:
        self._begin_drop()
        return {"drop": self.dropped.key}

    async def _fetch(self, request: web.Request) -> Any:
        """Bring a series from the archive; it is taken as if it had been dropped."""
        folder = self._begin_drop()
        await self.shelves.fetch(request, folder)
        return {"drop": folder.name}

    def _begin_drop(self) -> Path:
        """Forget what was dropped before, and what was listed of it; return the folder for what comes.

        Raises `UsageError` while another tab looks through what was dropped, or opens it.
        """
        self._require_idle()
        self.found = {}
        return self.dropped.begin()

    async def _keep(self, request: web.Request) -> Any:
        self.dropped.require(request.query.get("drop", ""))
        await self.dropped.add(request.query.get("name", ""), request.content.iter_any())
        return {}

    async def _open(self, request: web.Request) -> Any:
        """Open a series that was listed, in a case that is new or lies about it."""
        one, name = self.found.get(request.query.get("key", "")), request.query.get("name", "")
        if one is None:
            raise UsageError("that series is no longer listed; look for it again")
        if not one.summary.is_usable:
            raise UsageError(f"it cannot be used: {'; '.join(one.summary.problems)}")
        if self._from_drop and not CASE_NAME.fullmatch(name):
            raise UsageError(
                "name the case with letters, digits, blanks, points and dashes, 60 at most, no blank or point first or "
                "last"
            )
        self.state = await self._work("reading the scan", lambda: self._opened_case(one, name))
        asyncio.get_running_loop().call_later(0.5, self._opened.set)  # this answer goes out first
        return {}

    def _opened_case(self, one: Found, name: str) -> PlannerState:
        if not self._from_drop:
            return self.open_case(one.path, one.series, one.case / PLAN)
        case = self.home / name
        if case.exists():
            raise InputError(f"{name} is there already; give the case another name")
        scan = self.dropped.take(case)
        self.found, self._from_drop = {}, False
        return self.open_case(scan, one.series if scan.is_dir() or scan.suffix == ".zip" else None, case / PLAN)

    async def _work(self, what: str, work: Callable[[], Any]) -> Any:
        """Do beside the page what takes long, one thing at a time."""
        self._require_idle()
        self._busy = what
        try:
            return await asyncio.get_running_loop().run_in_executor(None, work)
        finally:
            self._busy = ""

    def _require_idle(self) -> None:
        if self._busy:
            raise UsageError(f"the planner is {self._busy}; wait for that")

    def _free_name(self) -> str:
        return next(name for n in range(1, 10_000) if not (self.home / (name := f"case-{n}")).exists())


def choose(
    page: StartPage, host: str, hosts: frozenset[str], address: Address, announce: Callable[[Address], None]
) -> tuple[PlannerState, Address]:
    """Serve the start page until a case is open; return it, and the address at which the planner goes on."""
    logging.getLogger("aiohttp.server").addFilter(is_worth_telling)

    async def serve() -> Address:
        application = web.Application(middlewares=[gate(address.token, hosts)])
        application.add_routes(page.routes())
        runner = web.AppRunner(application, access_log=None, shutdown_timeout=1.0)
        await runner.setup()
        try:
            site = web.TCPSite(runner, host, address.port)
            await site.start()
            known = Address(runner.addresses[0][1], address.token, address.lasting)
            announce(known)
            await page.opened()
        finally:
            page.dropped.close()
            await runner.cleanup()
        return known

    with needed_place(host, address.port):
        known = asyncio.run(serve())
    assert page.state is not None
    return page.state, known


def _picture(picture: NDArray[np.uint8] | None) -> web.Response:
    import cv2

    if picture is None:
        raise web.HTTPNotFound(text="there is no picture of it")
    return web.Response(body=bytes(cv2.imencode(".png", picture)[1]), content_type="image/png")


def _page(file: str) -> Callable[[web.Request], Awaitable[web.Response]]:
    async def answer(_: web.Request) -> web.Response:
        return web.Response(
            text=(PAGE / file).read_text(encoding="utf-8"), content_type=KINDS[file.rpartition(".")[2]]
        )

    return answer


def _told(answer: Callable[[web.Request], Awaitable[Any]]) -> Callable[[web.Request], Awaitable[web.Response]]:
    """Answer in JSON; what goes wrong is one sentence."""

    async def tell(request: web.Request) -> web.Response:
        try:
            return web.json_response(await answer(request))
        except RonnaplanError as error:
            text = json.dumps({"error": str(error)})
            return web.Response(status=422, text=text, content_type="application/json")

    return tell
