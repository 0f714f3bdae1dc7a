"""The start page: folders below the root only, series with pictures and reasons, and the planner in its place."""

from __future__ import annotations

import asyncio
import shutil
import subprocess
import sys
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer
from pydicom import dcmread

from ronnaplan.ct import read_ct
from ronnaplan.documents.plan import write_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import UsageError
from ronnaplan.planner.places import Places, rows, series_at
from ronnaplan.planner.starting import StartPage
from ronnaplan.planning import Plan
from tests import cases
from tests.documents.placements import placed
from tests.loops import run
from tests.planner.browser import PATIENCE_MS, environment, eventually, needs_browser


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    """A root with a study: a CT of its own case, and an image that is no CT slice."""
    shutil.copytree(cases.CT, tmp_path / "scans" / "study" / "ct")
    cases.write_case(tmp_path / "scans" / "study")
    (tmp_path / "home").mkdir()
    return tmp_path / "scans"


def test_nothing_but_what_lies_below_the_root_is_shown(scans: Path) -> None:
    places = Places(scans)
    (scans / "out").symlink_to(scans.parent)
    (scans / ".hidden").mkdir()
    assert [(one["name"], one["case"]) for one in places.listed("")["entries"]] == [
        ("out", False),
        ("study", True),
    ]
    for below in ("..", "out", "/etc", "study/../..", "nowhere", "a\0b", 5000 * "x", "study/plan.json"):
        with pytest.raises(UsageError, match=r"below the root|no folder"):
            places.listed(below)


def test_series_are_listed_with_a_picture_and_without_the_patient(scans: Path) -> None:
    (one,) = series_at(scans / "study", scans)
    (row,) = rows([one])
    assert (row["modality"], row["problems"], row["drawn"]) == ("CT", (), True)
    assert "patient_name" not in row
    assert one.picture is not None
    assert max(one.picture.shape) == 96
    assert one.picture.max() > 150 > 50 > one.picture.min()


def test_a_scan_is_of_one_case_wherever_it_was_looked_for_and_each_of_its_own(scans: Path) -> None:
    """Of two patients below a root the first had the root's case, and the other one was refused for that."""
    other = scans / "other"
    other.mkdir()
    for file in (scans / "study" / "ct").glob("*.dcm"):
        made = dcmread(file)
        made.SeriesInstanceUID = "1.2.3"
        made.save_as(other / file.name)
    found = {one.case: one for one in series_at(scans, scans)}
    assert sorted(found) == [other, scans / "study"]
    for looked_in in (scans / "study", scans / "study" / "ct"):
        assert [one.case for one in series_at(looked_in, scans)] == [scans / "study"]
    assert [row["known"] for row in rows([found[other], found[scans / "study"]])] == [False, True]


def test_a_case_whose_scan_lies_in_folders_below_it_is_gone_on_with(scans: Path) -> None:
    """As what is dropped with its folders does, and a patient's folder of an export: its plan was passed over."""
    study = scans / "study"
    shutil.move(study / "ct", scans / "S1")
    (study / "ct").mkdir()
    shutil.move(scans / "S1", study / "ct")
    for looked_in in (scans, study, study / "ct", study / "ct" / "S1"):
        assert [(one.case, one.is_known) for one in series_at(looked_in, scans)] == [(study, True)]
    for document in ("plan.json", "fiducials.json", "registration.json"):
        assert [one.case for one in series_at(study, scans)] == [study]
        (study / document).unlink()
    shutil.copy(cases.write_case(scans.parent / "home") / "plan.json", scans.parent)
    assert [one.case for one in series_at(study, scans)] == [study / "ct" / "S1"], "nothing above the root counts"


def test_a_scan_in_a_folder_with_another_scans_plan_is_not_gone_on_with(scans: Path) -> None:
    """The page said "go on" of it, and refused it when that was pressed."""
    study = scans / "study"
    for file in (study / "ct").glob("*.dcm"):
        made = dcmread(file)
        made.FrameOfReferenceUID = "1.2.3"
        made.save_as(file)
    (study / "placement.json").write_text(to_json(placed()))
    (row,) = rows(series_at(study, scans))
    strangers = "plan.json, fiducials.json, registration.json, placement.json"
    assert (row["known"], row["strangers"]) == (False, strangers)
    for document in ("plan.json", "registration.json", "placement.json"):
        (study / document).unlink()
    assert [one["strangers"] for one in rows(series_at(study, scans))] == ["fiducials.json"]
    (study / "fiducials.json").unlink()
    assert [one["strangers"] for one in rows(series_at(study, scans))] == [""]


def test_an_image_file_names_no_frame_and_is_not_gone_on_with_by_a_dicom_scans_plan(scans: Path) -> None:
    """As of an MR beside the plan of a CT; a plan of its own is gone on with."""
    study = scans / "study"
    image = cases.write_label_map(study / "mr.nii.gz")
    (row,) = rows(series_at(image, scans))
    assert (row["known"], row["strangers"]) == (False, "plan.json, fiducials.json, registration.json")
    for document in ("plan.json", "fiducials.json", "registration.json"):
        (study / document).unlink()
    write_plan(study / "plan.json", Plan.of_scan(read_ct(image)))
    (row,) = rows(series_at(image, scans))
    assert (row["known"], row["strangers"]) == (True, "")


def test_no_series_of_another_tabs_folder_is_opened_in_the_place_of_one_that_is_listed(scans: Path) -> None:
    """What the other tab looks for comes between the list and the press of its button."""
    shutil.copytree(scans / "study" / "ct", scans / "other")
    opened: list[Path] = []

    def open_case(scan: Path, *_: object) -> Any:
        opened.append(scan)

    async def asked() -> None:
        page = StartPage(scans.parent / "home", scans, open_case)
        async with TestClient(TestServer(served(page))) as client:
            listed = [
                (await (await client.get(f"/series?at={at}")).json())["series"][0]["key"]
                for at in ("study/ct", "other")
            ]
            refused, taken = [await (await client.post(f"/open?key={key}")).json() for key in listed]
            assert refused == {"error": "that series is no longer listed; look for it again"}
            assert taken == {}
            assert (await client.get(f"/thumbnail/{listed[0]}")).status == HTTPStatus.NOT_FOUND

    run(asked())
    assert opened == [scans / "other"]


def test_no_file_of_one_tabs_drop_gets_among_those_that_another_tab_drops_meanwhile(scans: Path) -> None:
    """A tab is told so, and is shown no series of the other one's in the place of its own."""
    one, another, *_ = (file.read_bytes() for file in sorted(cases.CT.glob("*.dcm")))
    page = StartPage(scans.parent / "home", scans, lambda *_: None)  # type: ignore[arg-type]

    async def asked() -> None:
        async with TestClient(TestServer(served(page))) as client:
            first = (await (await client.post("/drop")).json())["drop"]
            assert (await client.put(f"/dropped?drop={first}&name=a/1.dcm", data=one)).status == HTTPStatus.OK
            second = (await (await client.post("/drop")).json())["drop"]
            assert (await client.put(f"/dropped?drop={second}&name=b/1.dcm", data=another)).status == HTTPStatus.OK
            for late in (
                client.put(f"/dropped?drop={first}&name=a/2.dcm", data=one),
                client.get(f"/series?drop={first}"),
            ):
                assert "since; drop or fetch it again" in (await (await late).json())["error"]
            assert [file.name for file in page.dropped.scan.rglob("*.dcm")] == ["1.dcm"]
            listed = await (await client.get(f"/series?drop={second}")).json()
            assert [row["images"] for row in listed["series"]] == [1]

    run(asked())


def test_where_no_series_is_the_page_is_told_so_of_what_it_calls_that_place(scans: Path) -> None:
    """The machine's own paths tell a page nothing, least of all that of a passing folder of what was dropped."""
    (scans / "empty").mkdir()
    page = StartPage(scans.parent / "home", scans, lambda *_: None)  # type: ignore[arg-type]

    async def asked() -> None:
        async with TestClient(TestServer(served(page))) as client:
            drop = (await (await client.post("/drop")).json())["drop"]
            await client.put(f"/dropped?drop={drop}&name=notes.txt", data=b"no scan")
            told = [
                (await (await client.get(f"/series?{where}")).json())["error"]
                for where in ("at=empty", f"drop={drop}")
            ]
            assert told == [
                "empty holds no DICOM series; give a folder of CT images",
                "what was dropped holds no DICOM series (notes.txt: it is not a DICOM file); give a folder of CT "
                "images",
            ]

    run(asked())


async def dropped_scan(client: TestClient[Any, Any]) -> str:
    """Drop a CT on the start page, and return the drop's key."""
    drop: str = (await (await client.post("/drop")).json())["drop"]
    for file in cases.CT.glob("*.dcm"):
        await client.put(f"/dropped?drop={drop}&name={file.name}", data=file.read_bytes())
    return drop


def test_what_one_tab_dropped_is_not_taken_away_while_it_is_looked_through(scans: Path) -> None:
    page = StartPage(scans.parent / "home", scans, lambda *_: None)  # type: ignore[arg-type]

    async def asked() -> None:
        async with TestClient(TestServer(served(page))) as client:
            drop = await dropped_scan(client)
            looking = asyncio.create_task(client.get(f"/series?drop={drop}"))
            while not page._busy:
                await asyncio.sleep(0)
            other = await (await client.post("/drop")).json()
            assert other == {"error": "the planner is looking for series; wait for that"}
            assert len((await (await looking).json())["series"]) == 1

    run(asked())


@pytest.mark.parametrize("name", ["case.", "case ", ".case", " case", "", "a/b", "x" * 61])
def test_no_case_gets_a_name_that_windows_changes_or_no_system_takes(scans: Path, name: str) -> None:
    page = StartPage(scans.parent / "home", scans, lambda *_: None)  # type: ignore[arg-type]

    async def asked() -> None:
        async with TestClient(TestServer(served(page))) as client:
            drop = await dropped_scan(client)
            (series,) = (await (await client.get(f"/series?drop={drop}")).json())["series"]
            answer = await client.post("/open", params={"drop": drop, "key": series["key"], "name": name})
            assert (await answer.json())["error"].startswith("name the case with letters")

    run(asked())


def served(page: StartPage) -> web.Application:
    """The page without its gate."""
    application = web.Application()
    application.add_routes(page.routes())
    return application


@pytest.fixture
def started(scans: Path) -> Iterator[str]:
    command = [sys.executable, "-m", "ronnaplan", "view", "--root", str(scans)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=scans.parent / "home",
        env=environment(surfaces=False),
    ) as process:  # fmt: skip
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        process.kill()


@needs_browser
def test_a_scan_is_dropped_opened_and_its_files_go_out_and_in(browser: Any, started: str, scans: Path) -> None:
    page, home = browser.new_page(viewport={"width": 1440, "height": 900}), scans.parent / "home"
    page.set_default_timeout(PATIENCE_MS)
    open_a_root_without_folders(page, started)
    list_a_part_of_a_series(page, started)
    list_what_lies_in_another_scans_case(page)
    page.goto(started)
    press_while_a_folder_is_listed(page)
    drop_a_scan(page, scans)
    assert page.url == started
    assert sorted(one.name for one in (home / "first").iterdir()) == [".planner-address.json", "ct.zip"]
    download_its_files(page, home / "first", scans)
    put_in_readings(page, home / "first", scans)
    (home / "first" / "plan.json").write_bytes((scans / "plan.json").read_bytes())
    leave_and_come_back(page)
    assert page.url == started


def open_a_root_without_folders(page: Any, url: str) -> None:
    """Nothing is looked for before anything was pressed, and the page says what to press."""
    page.route(
        "**/folders?at=", lambda route: route.fulfill(json={"root": "ct", "at": "", "entries": [], "more": 0})
    )
    page.goto(url)
    page.wait_for_selector("#entries >> text=no folders in here; the button above lists its scans")
    page.unroute("**/folders?at=")


def list_a_part_of_a_series(page: Any, url: str) -> None:
    """Its kernel is told once, whether or not the parts differ in it."""
    row = {"key": "1", "modality": "CT", "description": "head", "kernel": "H30", "series": "1.2#1", "images": 9}
    row |= {"problems": [], "notes": [], "drawn": False, "known": False, "pixel_mm": None, "spacing_mm": None}
    parts: tuple[list[str], ...] = (["kernel H30", "tube voltage 80 kV"], ["tube voltage 80 kV"], [])
    listed = {"series": [row | {"part": part} for part in parts], "name": ""}
    page.goto(url)
    page.route("**/series?at=", lambda route: route.fulfill(json=listed))
    page.click("text=look for series here")
    page.wait_for_selector("#found tbody")
    assert page.locator("#found td:nth-child(2) small").all_inner_texts() == [
        *("kernel H30, tube voltage 80 kV, 1.2#1", "H30, tube voltage 80 kV, 1.2#1", "H30, 1.2#1")
    ]
    page.unroute("**/series?at=")


def list_what_lies_in_another_scans_case(page: Any) -> None:
    """It is told before it is pressed, and not where a new case is made of it."""
    row = {"key": "1", "modality": "CT", "description": "head", "kernel": "H30", "series": "1.2", "images": 9}
    row |= {"problems": [], "notes": [], "part": [], "drawn": False, "known": False, "strangers": "plan.json"}
    row |= {"pixel_mm": None, "spacing_mm": None}
    for name, told in (("", "of another scan in its case: plan.json"), ("case-1", "can be planned in")):
        listed = {"series": [row], "name": name}
        page.route("**/series?at=", lambda route, _, listed=listed: route.fulfill(json=listed))
        page.click("text=look for series here")
        page.wait_for_selector(f"#found td >> text={told}")
        assert page.locator("#found tbody button").is_enabled() == bool(name)
        page.unroute("**/series?at=")


def press_while_a_folder_is_listed(page: Any) -> None:
    """The press is not lost: the page says that it comes next, and what was listed is hidden until then."""
    held: list[Any] = []
    page.route("**/folders?at=study", lambda route: held.append(route))
    page.click("#entries >> text=study/")
    page.click("text=look for series here")
    page.wait_for_selector("#busy >> text=opening study ... next: looking for series in the root ...")
    eventually(page, lambda: len(held) == 1)
    held[0].continue_()
    page.unroute("**/folders?at=study")
    page.wait_for_selector("#found h2 >> text=Series in the root")
    page.click("#entries >> text=ct/")
    page.wait_for_selector("#found h2 >> text=Series in study/ct")
    page.set_input_files("#file", __file__)
    page.wait_for_selector("#error >> text=holds no DICOM series")
    assert page.locator("#found").is_hidden()
    page.click("#path >> text=scans")


def drop_a_scan(page: Any, scans: Path) -> None:
    """Look through folders, then drop what is no scan, an archive, and open it as a case."""
    page.click("#entries >> text=study/")
    page.click("#entries >> text=ct/")
    page.wait_for_selector("#entries >> text='no folders in here'")
    page.wait_for_selector("#found >> text=go on")  # without a further click
    assert page.evaluate("document.activeElement.textContent") == "ct"  # who works by keyboard goes on from there
    assert page.locator("#found img").count() == 1
    (scans / "notes.txt").write_text("no scan")
    page.set_input_files("#file", scans / "notes.txt")
    page.wait_for_selector("#error >> text=holds no DICOM series")
    archive = shutil.make_archive(str(scans / "all"), "zip", cases.CT)
    page.set_input_files("#file", archive)
    page.wait_for_selector("#case:not([hidden])")
    page.fill("#name", "../x")
    page.click("#found tbody button")
    page.wait_for_selector("#error >> text=name the case with letters")
    page.fill("#name", "first")
    other = page.context.browser.new_page()
    other.set_default_timeout(PATIENCE_MS)
    other.goto(page.url)
    other.wait_for_selector("text=study/")
    page.click("#found tbody button")
    page.wait_for_selector("canvas[data-picture=axial][data-number]")
    other.click("#entries >> text=study/")  # another tab finds the planner where the start page was
    other.wait_for_selector("canvas[data-picture=axial][data-number]")
    other.close()


def download_its_files(page: Any, case: Path, scans: Path) -> None:
    """Take the plan out of the page, and what a report says in numbers: its picture takes ten seconds."""
    page.click("#add")
    page.keyboard.press("Escape")
    page.click(".rp-tab >> text=Files")
    page.wait_for_selector("#files >> text=plan.json: none yet")
    assert page.locator("[data-download='plan.json']").count() == 0
    shutil.copy(cases.write_case(scans) / "plan.json", case / "plan.json")
    eventually(page, lambda: page.evaluate("window.trame.state.get('paths').length") == 1)
    with page.expect_download() as coming:
        page.click("[data-download='plan.json']")
    assert coming.value.path().read_bytes() == (case / "plan.json").read_bytes()
    with page.expect_download(timeout=120_000) as made:
        page.click("[data-download='measures.csv']")
    assert "\nfirst,left," in made.value.path().read_text()


def put_in_readings(page: Any, case: Path, scans: Path) -> None:
    """Put readings into the case; no file that is there is replaced."""
    page.set_input_files("#readings-file", cases.write_readings(scans / "readings.csv"))
    page.wait_for_selector("#news >> text=readings were put into the case")
    assert (case / "readings.csv").read_text() == (scans / "readings.csv").read_text()
    page.set_input_files("#readings-file", scans / "plan.json")
    page.wait_for_selector("#message >> text=is in the case already")
    page.set_input_files("#readings-file", cases.CT / "truth.json")
    page.wait_for_selector("#message >> text=truth.json holds no readings; drop a table")
    assert not (case / "truth.json").exists()


def leave_and_come_back(page: Any) -> None:
    """Go to the start page, open the case again from there, and leave it."""
    page.click("#leave")
    page.wait_for_selector("text=Open a scan")
    page.click("#entries >> text=study/")
    page.click("text=look for series here")
    page.click("#found >> text=go on")
    page.wait_for_selector("canvas[data-picture=axial][data-number]")
    page.wait_for_function("window.trame.state.get('paths').length === 1")
    page.click("#leave")
    page.wait_for_selector("text=Open a scan")
