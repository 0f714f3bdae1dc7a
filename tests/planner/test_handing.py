"""What goes out of the page is made of the case that it shows, or refused."""

from __future__ import annotations

import itertools
import json
from http import HTTPStatus
from pathlib import Path

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer

from ronnaplan.planner import handing
from ronnaplan.planner.handing import Handing, Origin
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
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

    async def make(*options: str) -> None:
        asked_for.extend(options)
        Path(options[-1]).write_text("made")

    async def asked() -> None:
        application = web.Application()
        origin = Origin(cases.CT, stated=("--paper", "Letter"))
        application.add_routes(Handing(storage, origin, lambda: None, lambda: None).routes())
        async with TestClient(TestServer(application)) as client:
            assert (await client.get("/download/report.pdf")).status == HTTPStatus.OK

    monkeypatch.setattr(handing, "_run", make)
    run(asked())
    values = dict(itertools.pairwise(asked_for))
    assert f"--name={storage.plan.parent.name}" in asked_for
    assert values["--paper"] == "Letter"


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
