"""What goes out of the page is made of the case that it shows, or refused."""

from __future__ import annotations

import asyncio
import errno
import itertools
import json
import sys
import time
from asyncio.subprocess import Process, create_subprocess_exec
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer

from ronnaplan.cli import main
from ronnaplan.documents.export import export
from ronnaplan.documents.plan import change_plan, read_plan
from ronnaplan.documents.plan_exchange import contacts_table, line_markups
from ronnaplan.planner import handing
from ronnaplan.planner.handing import Handing, Origin
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.planning.electrodes import electrode_named
from tests import cases
from tests.loops import run


@pytest.mark.parametrize("name", ["plan", "fiducials", "limits"])
def test_nothing_is_made_without_a_document_that_still_counts(
    storage: Storage, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Of files that were removed a report would say other errors, and other limits, than the page."""
    storage.limits.write_text(json.dumps({"format": "ronnaplan.limits", "version": 1, "longest_path_mm": 20.0}))
    state, made = PlannerState(cases.volume(), storage), []

    async def make(verb: str, *options: str) -> None:
        made.append(verb)
        Path(options[-1]).write_text("made")

    async def asked() -> None:
        application = web.Application()
        application.add_routes(Handing(storage, Origin(cases.CT), lambda: None, state.case.require_files).routes())
        async with TestClient(TestServer(application)) as client:
            assert (await client.get("/download/report.html")).status == HTTPStatus.OK
            getattr(storage, name).unlink()
            for file in ("report.html", "scene.glb"):
                refused = await client.get(f"/download/{file}")
                assert refused.status == HTTPStatus.UNPROCESSABLE_ENTITY
                assert f"{name}.json was removed, and what it held still counts" in await refused.text()

    monkeypatch.setattr(handing, "_run", make)
    run(asked())
    assert made == ["report"]


def test_a_report_is_called_as_the_case_and_made_as_it_was_stated(
    storage: Storage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The files that it is made of are copies in a folder of another name."""
    asked_for: list[str] = []
    called: list[str] = []

    async def make(*options: str) -> None:
        asked_for.extend(options)
        Path(options[-1]).write_text("made")

    async def asked() -> None:
        application = web.Application()
        origin = Origin(cases.CT, paper="Letter")
        application.add_routes(Handing(storage, origin, lambda: None, lambda: None).routes())
        async with TestClient(TestServer(application)) as client:
            names = ("report.pdf", "measures.csv", "plan.csv", "plan.json")
            answers = [await client.get(f"/download/{name}") for name in names]
            assert {answer.status for answer in answers} == {HTTPStatus.OK}
            called.extend(unquote(answer.headers["Content-Disposition"]).partition("''")[2] for answer in answers)

    monkeypatch.setattr(handing, "_run", make)
    run(asked())
    values = dict(itertools.pairwise(asked_for))
    assert f"--name={storage.plan.parent.name}" in asked_for
    assert values["--paper"] == "Letter"
    assert asked_for.count("--paper") == 1, "a table is on no paper"
    case = storage.plan.parent.name
    assert called == [
        f"{case} report.pdf",
        f"{case} measures.csv",
        f"{case} plan.csv",
        "plan.json",
    ]  # a document is refused with another scan


def test_what_a_case_without_documents_lacks_is_told_by_no_folder_of_passing_files(tmp_path: Path) -> None:
    storage = Storage.of(str(tmp_path / "plan.json"), None, None)

    async def asked() -> None:
        application = web.Application()
        application.add_routes(Handing(storage, Origin(cases.CT), lambda: None, lambda: None).routes())
        async with TestClient(TestServer(application)) as client:
            refused = await client.get("/download/report.html")
            assert refused.status == HTTPStatus.UNPROCESSABLE_ENTITY
            assert (await refused.text()).startswith("the case holds nothing yet that report.html could show")

    run(asked())


def test_why_a_file_cannot_be_made_is_told_without_the_command_s_name(storage: Storage, tmp_path: Path) -> None:
    async def asked() -> None:
        application = web.Application()
        origin = Origin(tmp_path / "gone")
        application.add_routes(Handing(storage, origin, lambda: None, lambda: None).routes())
        async with TestClient(TestServer(application)) as client:
            refused = await client.get("/download/scene.glb")
            assert refused.status == HTTPStatus.UNPROCESSABLE_ENTITY
            assert (await refused.text()).startswith(f"there is no file or folder {origin.ct}")

    run(asked())


def test_what_a_page_no_longer_waits_for_is_given_up(storage: Storage, monkeypatch: pytest.MonkeyPatch) -> None:
    """One file is made at a time: a report of minutes that nobody waits for held up all others."""
    given_up = asyncio.Event()

    async def make(*_: str) -> None:
        try:
            await asyncio.sleep(60.0)
        finally:
            given_up.set()

    async def asked() -> None:
        application = web.Application()
        application.add_routes(Handing(storage, Origin(cases.CT), lambda: None, lambda: None).routes())
        async with TestClient(TestServer(application)) as client:
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(client.get("/download/report.html"), 0.3)
            await asyncio.wait_for(given_up.wait(), 30.0)

    monkeypatch.setattr(handing, "LOOK_S", 0.01)
    monkeypatch.setattr(handing, "_run", make)
    run(asked())


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell what a process began")
def test_a_browser_that_prints_what_nobody_waits_for_ends_too_and_its_files_go(
    storage: Storage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It went on, and left the report, which tells of a patient, in the system's folder for temporary files."""
    verb, began, known, create = tmp_path / "verb", tmp_path / "began", tmp_path / "known", create_subprocess_exec
    verb.write_text(
        f"#!/bin/sh\nuntil test -e '{known}'; do sleep 0.01; done\n"
        f'sleep 600 &\necho $! "$TMPDIR" > "{began}.part"; mv "{began}.part" "{began}"; wait\n'
    )
    verb.chmod(0o755)

    async def created(*arguments: str, **options: Any) -> Process:
        process = await create(*arguments, **options)
        known.touch()
        return process

    monkeypatch.setattr("ronnaplan.planner.handing.asyncio.create_subprocess_exec", created)
    monkeypatch.setattr("ronnaplan.planner.handing.sys.executable", str(verb))

    async def given_up() -> None:
        made = Handing(storage, Origin(cases.CT), lambda: None, lambda: None)._run_on_copies(
            "report.pdf", ("report",)
        )
        making = asyncio.ensure_future(made)
        while not began.exists():
            await asyncio.sleep(0.01)
        making.cancel()
        with pytest.raises(asyncio.CancelledError):
            await making

    run(given_up())
    number, beside = began.read_text().split()
    assert not Path(beside).exists()
    status = Path("/proc") / number / "stat"
    for _ in range(3000):
        if not status.exists() or status.read_text().rpartition(")")[2].split()[0] in "ZX":
            return
        time.sleep(0.01)
    pytest.fail("what was begun goes on")


@pytest.mark.parametrize(
    ("error", "remedy"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "make room on the planner's disk"),
        (OSError(errno.ENOENT, "No usable temporary directory found"), "make room on the planner's disk"),
        (OSError(errno.ENOENT, "No such file or directory", "plan.json"), "try again once that is mended"),
        (OSError(errno.EMFILE, "Too many open files"), "try again once that is mended"),
    ],
)
def test_what_the_system_refuses_is_told_and_the_server_does_not_fail(
    storage: Storage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: OSError, remedy: str
) -> None:
    def refusing(*_: object) -> None:
        raise error

    async def asked() -> None:
        application = web.Application()
        application.add_routes(Handing(storage, Origin(tmp_path), lambda: None, lambda: None).routes())
        async with TestClient(TestServer(application)) as client:
            refused = await client.get("/download/report.html")
            assert refused.status == HTTPStatus.INSUFFICIENT_STORAGE
            assert await refused.text() == f"report.html cannot be made ({error.strerror}); {remedy}"

    monkeypatch.setattr("shutil.copyfile", refusing)
    run(asked())


def test_a_document_that_cannot_be_read_is_told_and_the_server_does_not_fail(
    storage: Storage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a disk that fails, or where another program took it away just now."""

    def refusing(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    async def asked() -> None:
        application = web.Application()
        application.add_routes(Handing(storage, None, lambda: None, lambda: None).routes())
        async with TestClient(TestServer(application)) as client:
            monkeypatch.setattr(Path, "open", refusing)
            refused = await client.get("/download/plan.json")
            assert refused.status == HTTPStatus.UNPROCESSABLE_ENTITY
            assert "plan.json cannot be read: Input/output error" in await refused.text()

    run(asked())


def test_what_other_programs_take_is_what_the_command_line_writes_of_each_document(tmp_path: Path) -> None:
    """Every file that is offered is made, by the verb's own run, and none of a document that there is not."""
    cases.write_case(tmp_path)
    storage = Storage.of(str(tmp_path / "plan.json"), None, None)
    change_plan(storage.plan, lambda plan: plan.edit("left", electrode=electrode_named("Medtronic 3387")))
    written: dict[str, bytes] = {}

    async def run_here(*options: str) -> None:
        assert main(list(options)) == 0

    async def asked() -> None:
        application = web.Application()
        application.add_routes(Handing(storage, None, lambda: None, lambda: None).routes())
        async with TestClient(TestServer(application)) as client:
            for name in handing.EXPORTED:
                answer = await client.get(f"/download/{name}")
                assert answer.status == HTTPStatus.OK, await answer.text()
                written[name] = await answer.read()
            storage.registration.unlink()
            assert (await client.get("/download/registration.tfm")).status == HTTPStatus.NOT_FOUND

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(handing, "_run", run_here)
        run(asked())
    assert len(written) == 10
    assert written["fiducials.csv"].decode() == export(storage.fiducials, "csv")
    assert written["plan.mrk.json"].decode() == line_markups(read_plan(storage.plan))
    assert written["plan.contacts.csv"].decode() == contacts_table(read_plan(storage.plan))
    assert written["registration.dcm"][128:132] == b"DICM"
