"""An archive on the start page: its series with pictures, one of which is fetched and opened by a click."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aiohttp import web
from aiohttp.test_utils import make_mocked_request
from numpy.typing import NDArray

from ronnaplan.errors import InputError, UsageError
from ronnaplan.planner.shelves import Shelves
from tests import cases
from tests.isolation import is_isolated
from tests.loops import run
from tests.node.peers import Orthanc, program
from tests.planner.browser import PATIENCE_MS, environment, eventually, needs_browser


class Books:
    """A shelf of one series; its picture takes until it is let go."""

    name = "pacs"

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.may_go_on, self.is_gone = threading.Event(), False

    def look(self, patient_id: str, date: str) -> list[dict[str, Any]]:
        self.asked.append(f"look {patient_id} {date}")
        return [{"series_uid": "1.2"}]

    def picture(self, number: int) -> NDArray[np.uint8] | None:
        self.asked.append(f"picture {number}")
        self.may_go_on.wait(60)
        if self.is_gone:
            raise InputError("the archive has gone")
        return np.zeros((2, 2), np.uint8)

    def fetch(self, number: int, folder: Path) -> None:
        self.asked.append(f"fetch {number}")


def request(path: str, **match: str) -> web.Request:
    return make_mocked_request("GET", path, match_info=match)


def test_what_matters_comes_before_the_pictures_that_still_wait(tmp_path: Path) -> None:
    books = Books()

    async def asked() -> list[Any]:
        shelves = Shelves(books)
        assert await shelves.look(request("/archive")) == {"name": "pacs"}
        (row,) = (await shelves.look(request("/archive?patient=%20X%20")))["series"]
        one = request(f"/archive/{row['key']}", key=row["key"])
        pictures = [asyncio.create_task(shelves.picture(one)) for _ in range(3)]
        while "picture 0" not in books.asked:
            await asyncio.sleep(0.01)
        fetching = asyncio.create_task(shelves.fetch(request(f"/fetch?key={row['key']}"), tmp_path))
        await asyncio.sleep(0.05)
        books.may_go_on.set()
        await fetching
        books.is_gone = True
        return [*(await asyncio.gather(*pictures)), await shelves.picture(one)]

    found = run(asked())
    assert [one is not None for one in found] == [True, False, False, False]
    assert books.asked == ["look X ", "picture 0", "fetch 0", "picture 0"]


def test_no_series_of_a_later_look_is_fetched_in_the_place_of_one_that_was_listed(tmp_path: Path) -> None:
    """Of two tabs one looks for another patient, and then the other's button is pressed."""
    books = Books()

    async def asked() -> None:
        shelves = Shelves(books)
        (before,), (now,) = [(await shelves.look(request(f"/archive?patient={who}")))["series"] for who in "XY"]
        with pytest.raises(UsageError, match="no longer listed; look for it again"):
            await shelves.fetch(request(f"/fetch?key={before['key']}"), tmp_path)
        await shelves.fetch(request(f"/fetch?key={now['key']}"), tmp_path)

    run(asked())
    assert books.asked == ["look X ", "look Y ", "fetch 0"]


def test_what_is_asked_for_while_another_tab_looks_is_not_taken_from_its_list(tmp_path: Path) -> None:
    """The number of a series was known before the look ended, and meant another series after it."""
    books = Books()

    async def asked() -> NDArray[np.uint8] | None:
        shelves = Shelves(books)
        (row,) = (await shelves.look(request("/archive?patient=X")))["series"]
        looking = asyncio.create_task(shelves.look(request("/archive?patient=Y")))
        await asyncio.sleep(0)  # it has its turn
        picture = asyncio.create_task(shelves.picture(request(f"/archive/{row['key']}", key=row["key"])))
        fetching = asyncio.create_task(shelves.fetch(request(f"/fetch?key={row['key']}"), tmp_path))
        with pytest.raises(UsageError, match="no longer listed; look for it again"):
            await fetching
        await looking
        return await picture

    books.may_go_on.set()
    assert run(asked()) is None
    assert books.asked == ["look X ", "look Y "]


def test_without_an_archive_there_is_none_to_ask(tmp_path: Path) -> None:
    async def asked() -> None:
        shelves = Shelves(None)
        assert await shelves.look(request("/archive?patient=X")) == {"name": ""}
        assert await shelves.picture(request("/archive/0", key="0")) is None
        with pytest.raises(UsageError, match="no longer listed"):
            await shelves.fetch(request("/fetch?key=0"), tmp_path)

    run(asked())


@needs_browser
@pytest.mark.skipif(program("Orthanc") is None or not is_isolated(), reason="no Orthanc, or no network of its own")
def test_a_click_fetches_a_series_from_an_archive_and_opens_it(browser: Any, tmp_path: Path) -> None:
    archive = Orthanc(tmp_path / "db", {"planner": ["RONNAPLAN", "127.0.0.1", 1]})
    (home := tmp_path / "home").mkdir()
    command = [sys.executable, "-m", "ronnaplan", "view", "--peer", f"ORTHANC@127.0.0.1:{archive.port}"]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=home,
        env=environment(surfaces=False),
    )
    try:
        for path in cases.CT.glob("*.dcm"):
            archive.post("/instances", path.read_bytes())
        assert process.stdout is not None
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(process.stdout.readline().strip())
        page.wait_for_selector("#archive >> text=In ORTHANC")
        page.click("#look button")
        page.wait_for_selector("#error >> text=nothing says which series")
        page.fill("#patient", "*")
        page.click("#look button")
        eventually(page, lambda: page.evaluate("document.querySelector('#archive img')?.naturalWidth") == 96)
        page.click("#archive >> text=fetch and plan")
        page.wait_for_selector("canvas[data-picture=axial][data-number]")
        assert len(list((home / "case-1" / "ct").iterdir())) == len(list(cases.CT.glob("*.dcm")))
    finally:
        process.kill()
        process.communicate()
        archive.stop()
