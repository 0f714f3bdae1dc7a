"""What goes out of the page is made of the case that it shows, or refused."""

from __future__ import annotations

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
