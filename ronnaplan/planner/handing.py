"""Files that go out of the page and come in: documents, report and scene are downloaded, readings are dropped."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import sys
import tempfile
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from aiohttp import web

from ronnaplan.case.folder import FIDUCIALS, PLAN, REGISTRATION
from ronnaplan.documents.files import MAX_DOCUMENT_BYTES, write_atomically
from ronnaplan.errors import RonnaplanError, UsageError, wants_room
from ronnaplan.pipes import environment
from ronnaplan.planner.storage import Storage
from ronnaplan.portable import kill_all
from ronnaplan.text import printable
from ronnaplan.untrusted import read_whole

MOST_READINGS_BYTES: Final = 16 * 2**20
"""A recording of minutes has less."""

LOOK_S: Final = 1.0
"""How often it is looked whether a page still waits for what is made."""

GONE_S: Final = 5.0
"""How long is waited for what was ended: where something it began goes on, that holds what it wrote to."""

MADE: Final = {
    "report.html": ("report", "{case}"),
    "report.pdf": ("report", "{case}"),
    "measures.csv": ("report", "{case}"),
    "scene.html": ("export", "{case}", "--to", "html"),
    "scene.glb": ("export", "{case}", "--to", "gltf"),
}
"""What is made of the whole case when it is asked for, and by which verb."""

EXPORTED: Final = {
    f"{Path(document).stem}{ending}": (document, (*verb, "{case}/" + document, "--to", to))
    for document, verb, formats in (
        (PLAN, ("plan", "export"), {"markups": ".mrk.json", "csv": ".csv", "contacts": ".contacts.csv"}),
        (FIDUCIALS, ("export",), {"markups": ".mrk.json", "csv": ".csv", "dicom": ".dcm"}),
        (REGISTRATION, ("export",), {"itk": ".tfm", "markups": ".mrk.json", "csv": ".csv", "dicom": ".dcm"}),
    )
    for to, ending in formats.items()
}
"""What is made of one document for other programs: of which, and by which verb. DICOM names no patient."""


@dataclass(frozen=True)
class Origin:
    """Where the scan was read, and what else was stated, as options of ``ronnaplan report`` and ``export``.

    ``paper`` is what a report is printed on, None for the usual one.
    """

    ct: Path
    series: str | None = None
    stated: tuple[str, ...] = ()
    regions: tuple[str, ...] = ()
    paper: str | None = None


class Handing:
    """Answers downloads of a case's files, and takes readings into its folder."""

    def __init__(
        self,
        storage: Storage,
        origin: Origin | None,
        shown: Callable[[], None],
        require_files: Callable[[], None],
    ) -> None:
        """``shown`` draws the page again when the case's folder holds new readings.

        ``require_files`` raises `RonnaplanError` where the case's files are no longer what is worked on.
        """
        self._storage, self._origin, self._shown, self._require_files = storage, origin, shown, require_files
        self._making = asyncio.Lock()

    def routes(self) -> list[web.RouteDef]:
        """Return what is answered."""
        return [web.get("/download/{name}", self._download), web.put("/readings", self._take)]

    async def _download(self, request: web.Request) -> web.StreamResponse:
        name = request.match_info["name"]
        files = self._storage.found
        try:
            if name in MADE and self._origin is not None:
                content = await _while_awaited(request, self._made(name, self._origin))
            elif name in EXPORTED and EXPORTED[name][0] in files:
                content = await _while_awaited(request, self._run_on_copies(name, EXPORTED[name][1]))
            elif name in files:
                content = read_whole(files[name], MAX_DOCUMENT_BYTES, expected="a document of the case")
            else:
                raise web.HTTPNotFound(text=f"the case holds no {printable(name, 40)} yet")
        except RonnaplanError as error:
            raise web.HTTPUnprocessableEntity(text=str(error)) from error
        kind = {"html": "text/html", "json": "application/json", "pdf": "application/pdf"}
        return web.Response(
            body=content,
            content_type=kind.get(name.rpartition(".")[2], "application/octet-stream"),
            headers={"Content-Disposition": f"attachment; filename*=UTF-8''{self._called(name)}"},
        )

    def _called(self, name: str) -> str:
        """Return what a file is called outside of the case, as RFC 8187 writes it.

        What is no document begins with the case's name: of a document of another scan all here is refused, but other
        programs take a plan's table for any patient's.
        """
        called = name if name in self._storage.found else f"{self._case} {name}"
        return quote(called, safe="", errors="replace")

    @property
    def _case(self) -> str:
        return self._storage.plan.resolve().parent.name

    async def _made(self, name: str, origin: Origin) -> bytes:
        """Have a file made of the case as it is now, by a process of its own; one at a time."""
        if not self._storage.found.keys() & {PLAN, FIDUCIALS, REGISTRATION}:
            raise web.HTTPUnprocessableEntity(
                text=f"the case holds nothing yet that {name} could show; add a trajectory, or localize the markers"
            )
        options = ["--ct", str(origin.ct), *(("--series", origin.series) if origin.series else ())]
        name_of_case = f"--name={self._case}"  # which that of the copies' folder is not
        options += (name_of_case, *origin.stated) if MADE[name][0] == "report" else origin.regions
        options += ["--paper", origin.paper] if origin.paper and name.startswith("report.") else []
        return await self._run_on_copies(name, (*MADE[name], *options))

    async def _run_on_copies(self, name: str, command: tuple[str, ...]) -> bytes:
        """Return what a command makes of the case's documents: of copies, which do not change meanwhile."""
        self._require_files()
        try:
            async with self._making:
                with tempfile.TemporaryDirectory() as folder:
                    for document, path in self._storage.found.items():
                        shutil.copyfile(path, Path(folder) / document)
                    target = Path(folder) / f"made-{name}"
                    await _run(*(part.replace("{case}", folder) for part in command), "-o", str(target))
                    return target.read_bytes()
        except OSError as error:
            remedy = "make room on the planner's disk" if wants_room(error) else "try again once that is mended"
            raise web.HTTPInsufficientStorage(
                text=f"{name} cannot be made ({printable(error.strerror or error)}); {remedy}"
            ) from error

    async def _take(self, request: web.Request) -> web.Response:
        """Take a file of readings into the case's folder."""
        try:
            name = self._new_name(request.query.get("name", ""))
            beyond = UsageError(
                f"{name} is larger than {MOST_READINGS_BYTES >> 20} MiB; that is no file of readings"
            )
            if (request.content_length or 0) > MOST_READINGS_BYTES:
                raise beyond
            content = bytearray()
            async for piece in request.content.iter_any():
                content += piece
                if len(content) > MOST_READINGS_BYTES:
                    raise beyond
            _require_readings(name, content)
            write_atomically(self._storage.plan.with_name(name), bytes(content))
        except RonnaplanError as error:
            return web.json_response({"error": str(error)}, status=422)
        self._shown()
        return web.json_response({"name": name})

    def _new_name(self, given: str) -> str:
        """Return the name of a dropped file, which is that of readings and of no file there is."""
        from ronnaplan.tracking.readers import READERS

        name = Path(given.replace("\\", "/")).name
        plain = name.isprintable() and not name.startswith(".") and 0 < len(name.encode()) <= 200
        if not plain or Path(name).suffix.lower() not in READERS:
            known = ", ".join(sorted(READERS))
            raise UsageError(f"'{printable(given, 60)}' is no file of readings; drop one of {known}")
        if self._storage.plan.with_name(name).exists() or not self._storage.may_be_readings(name):
            raise UsageError(f"{printable(name)} is in the case already; give the new file another name")
        return name


def _require_readings(name: str, content: bytes | bytearray) -> None:
    from ronnaplan.tracking.readers import BEGINNING_BYTES, may_hold_readings

    if not may_hold_readings(name, bytes(content[:BEGINNING_BYTES])):
        raise UsageError(
            f"{printable(name)} holds no readings; drop a table whose first row names x, y and z, Slicer markups, or a "
            "tracker sequence"
        )


async def _while_awaited(request: web.Request, making: Coroutine[Any, Any, bytes]) -> bytes:
    """Return what is being made; it is given up where the page that asked for it is gone, and would hold up others."""
    task = asyncio.ensure_future(making)
    try:
        while not task.done():
            await asyncio.wait([task], timeout=LOOK_S)
            if request.transport is None or request.transport.is_closing():
                break
    finally:
        task.cancel()  # nothing to one that is done
    return await task


async def _run(*arguments: str) -> None:
    """Run a verb in a process of its own; raises `HTTPUnprocessableEntity` with what it says went wrong.

    The last of ``arguments`` is the file to make. What lies about while it is made, as a report before it is printed,
    lies beside it, to go with it where that is given up: it tells of a patient.
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "ronnaplan", *arguments),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
        env={**environment(), "TMPDIR": str(Path(arguments[-1]).parent)},
    )
    try:
        _, told = await process.communicate()
    finally:
        if process.returncode is None:  # given up
            kill_all(process)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(process.wait(), GONE_S)
    if process.returncode:
        last = told.decode(errors="replace").strip().rpartition("\n")[2].removeprefix("ronnaplan: ")
        raise web.HTTPUnprocessableEntity(
            text=printable(last) or f"{arguments[0]} ended with {process.returncode}"
        )
