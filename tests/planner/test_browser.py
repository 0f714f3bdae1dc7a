"""The planner used as a person uses it: headless Chromium, the mouse, the keyboard, a second tab, a crash."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pyigtl
import pytest

from tests import cases
from tests.long import few_and_others
from tests.planner.browser import (
    Planner,
    eventually,
    fields,
    kept_open,
    last_target,
    needs_browser,
    opened,
    place,
    planner,
    settled,
    value,
    wait_until_whole,
    with_head,
)

pytestmark = needs_browser

BRIGHTEST = """view => {
  const canvas = document.querySelector(`canvas[data-picture=${view}]`);
  return canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data
    .filter((_, n) => n % 4 === 0).reduce((most, one) => Math.max(most, one), 0);
}"""
"""The greatest red of a picture."""

FIRST_FRAME = """const look = () => {
  const canvas = document.querySelector("canvas[data-picture=axial]");
  if (canvas) window.firstHas = ["number" in canvas.dataset, document.querySelector(".rp-tab") !== null];
  else requestAnimationFrame(look);
};
requestAnimationFrame(look);"""

AXIAL = "document.querySelector('canvas[data-picture=axial]').dataset.number"
"""Which picture is drawn in the axial view."""


@pytest.fixture(scope="module")
def page(running_browser: Any, shared: Planner) -> Iterator[Any]:
    """One page for the tests here that plan nothing."""
    with kept_open(running_browser, shared.url) as page:
        yield page


def sized(page: Any, width: int = 1280, height: int = 800) -> Any:
    """Wait until a page has drawn itself anew in another size, if it has."""
    page.set_viewport_size({"width": width, "height": height})
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return page


def test_every_view_shows_something(page: Any) -> None:
    with_head(sized(page))
    for view in ("axial", "coronal", "sagittal", "inline", "probe", "head"):
        page.wait_for_function(f"view => ({BRIGHTEST})(view) > 40", arg=view)
    for view in ("axial", "coronal", "sagittal", "inline", "probe", "head"):
        box = page.locator(f"[data-view={view}]").bounding_box()
        assert box["width"] > 200, view
        assert box["height"] > 200, view
    dashed = {view: page.locator(f"[data-view={view}] .rp-far").count() for view in ("axial", "inline", "head")}
    assert dashed == {"axial": 1, "inline": 0, "head": 0}  # what is drawn in full is not dashed, too


@few_and_others(("width", "height"), [(1280, 800), (390, 600)], [(2560, 1440)])
def test_nothing_falls_off_the_screen(page: Any, width: int, height: int) -> None:
    sized(page, width, height)
    page.wait_for_function("document.getElementById('verdict')?.textContent")  # at the end of the panel, unseen
    over = page.evaluate(
        "(page => [page.scrollWidth - innerWidth, page.scrollHeight - innerHeight])(document.documentElement)"
    )
    assert max(over) <= 0
    for view in ("axial", "probe", "head"):
        box = page.locator(f"[data-view={view}]").bounding_box()
        assert box["x"] + box["width"] <= width
        assert box["y"] + box["height"] <= height
    assert page.locator("#undo").bounding_box()["x"] < width


CUT_TITLES = """() => [...document.querySelectorAll(".rp-title")].filter((one) => one.offsetParent &&
  (one.scrollWidth > one.clientWidth + 1 || one.scrollHeight > one.clientHeight + 1)).map((one) => one.textContent)"""
DEEP_IS_SEEN = """() => {
  const title = document.querySelector(".rp-probe .rp-title"), words = document.createRange();
  words.setStart(title.firstChild, 0);
  words.setEnd(title.firstChild, title.textContent.indexOf("deep") + "deep".length);
  return words.getBoundingClientRect().bottom <= title.getBoundingClientRect().bottom + 1; }"""
UPPER_LETTERS_ON_TITLES = """() => [...document.querySelectorAll(".rp-edge-2")].filter((one) => one.offsetParent &&
  one.getBoundingClientRect().top + 3 <
  one.closest(".rp-view").querySelector(".rp-title").getBoundingClientRect().bottom).length"""


@few_and_others(("width", "height", "cut"), [(683, 384, 2)], [(960, 540, 0), (1024, 768, 0)])
def test_titles_are_read_where_the_page_is_enlarged(page: Any, width: int, height: int, cut: int) -> None:
    """Screens of 1,920 x 1,080 and of 1,366 x 768 that are enlarged twice; on these two say only what comes first.

    That is how far the target is, and how deep the cut lies, which was cut off; and as what the head is drawn.
    """
    with_head(sized(page, width, height))
    page.wait_for_function("document.querySelectorAll('.rp-title')[0].textContent.includes('mm')")
    eventually(page, lambda: len(page.evaluate(CUT_TITLES)) == cut)
    assert all(one.endswith((": probe's eye", "; 95 % tubes")) for one in page.evaluate(CUT_TITLES))
    assert page.evaluate(DEEP_IS_SEEN)
    assert page.evaluate(UPPER_LETTERS_ON_TITLES) == 0
    page.click("button:text-is('3-D')")  # whose cuts are the smallest
    page.wait_for_function("document.querySelector('.rp-axial').clientHeight < innerHeight / 3")
    eventually(page, lambda: not page.evaluate(CUT_TITLES))
    assert page.evaluate(UPPER_LETTERS_ON_TITLES) == 0
    page.click("button:text-is('six')")  # as others expect it
    page.wait_for_function("document.querySelector('.rp-axial').clientHeight > innerHeight / 3")


@few_and_others(("width", "height"), [(390, 844)], [(1280, 800)])
def test_a_name_without_blanks_takes_nothing_off_the_panel(
    browser: Any, kept: Planner, width: int, height: int
) -> None:
    page = opened(browser, kept.url, width, height)
    name = "left_anterior_hippocampus_of_the_second_plan_after_the_conference"
    page.fill("#path-name", name)
    page.press("#path-name", "Enter")
    page.wait_for_selector(f"text={name}, LPS mm")
    page.wait_for_function("document.getElementById('verdict')?.textContent")
    over = "panel => panel.scrollWidth - panel.clientWidth"
    assert page.locator(".rp-side").evaluate(over) <= 0


def test_a_trajectory_is_added_by_two_clicks_dragged_and_undone(browser: Any, kept: Planner) -> None:
    page, folder = opened(browser, kept.url), kept.folder
    page.click("#add")
    page.mouse.click(*place(page, "axial", 0.6, 0.4))
    page.wait_for_function("document.getElementById('add').textContent.includes('target')")
    page.mouse.click(*place(page, "axial", 0.5, 0.55))
    page.wait_for_selector("text=T1, LPS mm")
    page.wait_for_function("window.trame.state.get('drawn_axial').paths.some(one => one.name === 'T1')")
    added = settled(page, folder, "T1", "target", [])

    x, y = last_target(page, "axial")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 20, y + 5, steps=4)
    page.mouse.move(x + 30, y + 10)
    page.mouse.up()
    dragged = settled(page, folder, "T1", "target", added)
    box = page.locator("[data-view=axial]").bounding_box()
    scale = json.loads((folder / "planner.json").read_text())["field_mm"] / min(box["width"], box["height"])
    assert np.subtract(dragged, added) == pytest.approx([30 * scale, 10 * scale, 0.0], abs=0.5 * scale)

    page.keyboard.press("Control+z")
    assert settled(page, folder, "T1", "target", dragged) == pytest.approx(added)
    page.keyboard.press("Control+y")
    assert settled(page, folder, "T1", "target", added) == pytest.approx(dragged)


def test_an_end_is_kept_whose_finger_the_system_takes_away(running_browser: Any, kept: Planner) -> None:
    context = running_browser.new_context(viewport={"width": 1280, "height": 800}, has_touch=True)
    page = context.new_page()
    page.goto(kept.url)
    wait_until_whole(page)
    before, (x, y) = fields(page, "target"), last_target(page, "axial")
    session = context.new_cdp_session(page)
    for kind, at in (("Start", [0]), *(("Move", [step]) for step in (10, 20, 30)), ("Cancel", [])):
        touched = {"type": f"touch{kind}", "touchPoints": [{"x": x + way, "y": y} for way in at]}
        session.send("Input.dispatchTouchEvent", touched)
    settled(page, kept.folder, value(page, "chosen")["name"], "target", before)
    context.close()


def test_what_was_done_is_found_again_after_reload_and_after_a_crash(
    browser: Any, running: Planner, folder: Path
) -> None:
    page = opened(browser, running.url)
    before = fields(page, "target")
    page.fill("#target-x", "17.25")
    page.press("#target-x", "Enter")
    after = settled(page, folder, "left", "target", before)
    assert after[0] == 17.25
    page.reload()
    page.wait_for_selector("canvas[data-picture=axial][data-number]")
    eventually(page, lambda: fields(page, "target") == after)
    assert not page.locator("#gone").is_visible()
    running.kill()
    page.wait_for_selector("#gone >> text=What was done is kept")
    assert "another address" in page.inner_text("#gone")  # where its port was taken meanwhile
    assert "sans-serif" in page.evaluate("getComputedStyle(document.getElementById('gone')).fontFamily")
    with planner(folder) as second:
        assert second.url == running.url
        page.wait_for_selector("#gone", state="detached")
        eventually(page, lambda: page.locator("#target-x").count() > 0 and fields(page, "target") == after)


def test_two_tabs_show_one_plan_each_where_it_looks(browser: Any, kept: Planner) -> None:
    first, second = opened(browser, kept.url), opened(browser, kept.url)
    held = value(second, "drawn_axial")["cross"]
    first.click("text=brain")
    first.click(".rp-bar >> text=four")
    first.mouse.click(*place(first, "axial", 0.4, 0.4))
    first.wait_for_function("window.trame.state.get('look').layout === 'four'")
    eventually(first, lambda: value(first, "drawn_axial")["cross"] != held)
    first.fill("#notes", "seen by both")
    first.press("#notes", "Tab")
    second.wait_for_function("window.trame.state.get('chosen').notes === 'seen by both'")
    look = value(second, "look")
    assert (look["window"], look["layout"]) == ("bone", "six")
    assert value(second, "drawn_axial")["cross"] == held
    second.click("text=markers >> nth=0")
    second.wait_for_function("window.trame.state.get('look').window === 'markers'")
    assert value(first, "look")["window"] == "brain"
    first.reload()  # it goes on where the page was that did something last
    first.wait_for_selector("canvas[data-picture=axial][data-number]")
    assert value(first, "look")["window"] in ("brain", "markers")


@pytest.mark.long  # each step is done by other tests of the page, too: those of a tracker and of an ambiguous pairing
def test_readings_are_registered_from_the_page(browser: Any, shared: Planner) -> None:
    file = shared.folder / "registration.json"
    file.unlink()
    page = opened(browser, shared.url)
    page.click(".rp-tab >> text=Registration")
    page.click("text=readings.csv")
    eventually(page, file.exists)
    page.wait_for_function("window.trame.state.get('registration').pairs.length === 6")
    assert json.loads(file.read_text())["status"] == "unique"


def test_a_live_tracker_is_listened_to_and_entries_are_proposed(browser: Any, folder: Path) -> None:
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            for _ in range(10):
                connection.sendall(pyigtl.PointMessage(positions=cases.seen_mm(), device_name="Polaris").pack())

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    (folder / "registration.json").unlink()
    with listener, planner(folder, "--tracker", f"127.0.0.1:{listener.getsockname()[1]}") as one:
        page = opened(browser, one.url)
        page.click(".rp-tab >> text=Registration")
        page.click("text=listen to")
        page.wait_for_function("window.trame.state.get('registration').status === 'unique'")
        assert len(json.loads((folder / "registration.json").read_text())["pairs"]) == 6
        page.click(".rp-tab >> text=Trajectories")
        eventually(page, lambda: not value(page, "chosen")["measuring"])  # what is measured moves the button down
        page.click("text=propose entries")
        page.wait_for_selector("#proposals tbody tr >> nth=4")
        page.focus("#proposals th >> nth=2 >> button")
        page.keyboard.press("Enter")
        page.wait_for_selector("#proposals th[aria-sort=ascending] >> text=mm")
        page.keyboard.press("Enter")
        page.wait_for_selector("#proposals th[aria-sort=descending] >> text=mm")
        lengths = [float(text) for text in page.locator("#proposals tbody td:nth-child(3)").all_inner_texts()]
        assert lengths == sorted(lengths, reverse=True) != sorted(lengths)
        before = fields(page, "entry")
        page.click("#proposals tbody tr >> nth=0")
        settled(page, folder, "left", "entry", before)
    thread.join(10)


def test_the_wheel_scrolls_and_the_cuts_stay_linked(page: Any) -> None:
    sized(page)
    before, cross = page.evaluate(AXIAL), value(page, "drawn_coronal")["cross"]
    page.mouse.move(*place(page, "axial", 0.5, 0.5))
    page.mouse.wheel(0, 120)
    page.wait_for_function(f"old => {AXIAL} !== old", arg=before)
    eventually(page, lambda: value(page, "drawn_coronal")["cross"] != cross)
    moved = value(page, "drawn_coronal")["cross"]
    assert abs(moved[1] - cross[1]) == pytest.approx(1.5)
    assert moved[0] == cross[0]


def test_pictures_come_with_the_page_and_no_other_host_is_asked_nor_a_patient_named(
    browser: Any, shared: Planner
) -> None:
    page = opened(browser, shared.url, script=FIRST_FRAME)
    assert page.evaluate("window.firstHas") == [True, False]  # the panels are made after the pictures
    page.click(".rp-tab >> text=Markers")
    page.wait_for_timeout(500)
    own = urlsplit(shared.url).netloc
    assert sum(url.endswith("/page.js") for url in page.requested) == 1  # and not again, once ahead
    assert {urlsplit(url).netloc for url in page.requested if not url.startswith(("data:", "blob:"))} == {own}
    assert page.locator("#patient").count() == 0
    name = "SYNTHETIC"
    assert name not in page.content().upper()
    assert name not in page.evaluate("JSON.stringify(window.trame.state.state)").upper()
