"""The page of a scene, as a browser shows it: turned with WebGL2, a still without."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ronnaplan.report import html as report_html
from ronnaplan.report.overview import STYLE
from ronnaplan.scene.files import html, view, viewer
from ronnaplan.scene.shapes import ball
from ronnaplan.scene.things import Thing
from tests.loops import apart
from tests.planner.browser import PATIENCE_MS, at_rest, chromium, eventually, looking, needs_browser

pytestmark = needs_browser

AT_MM = np.array([-26.0, -30.0, 0.0])
RED = Thing("marker F1", ball(AT_MM, 10.0), np.array([1.0, 0.1, 0.1]), label="F1", label_mm=AT_MM)
SKIN = Thing("skin", ball([0.0, 0.0, 0.0], 50.0), np.array([0.2, 0.4, 0.9]), 0.5)


@pytest.fixture(scope="module")
def looked() -> Iterator[Callable[..., Any]]:
    """Have functions look at pages that the browser draws by itself."""
    with looking("--use-angle=swiftshader", "--enable-unsafe-swiftshader") as look:
        yield look


def drawn(page: Any, page_file: Path, width: int = 500, height: int = 400) -> None:
    """Open a page and wait until it is drawn."""
    page.set_default_timeout(PATIENCE_MS)
    page.set_viewport_size({"width": width, "height": height})
    page.goto(page_file.as_uri())
    page.wait_for_selector("canvas", state="visible")


@pytest.fixture
def page_file(tmp_path: Path) -> Path:
    still = cv2.imencode(".png", np.full((40, 40, 3), 255, dtype=np.uint8))[1].tobytes()
    file = tmp_path / "scene.html"
    file.write_bytes(html([RED, SKIN], "a case", still))
    return file


def shown(page: Any) -> np.ndarray:
    """What is on the screen (H, W, 3) once it stands still."""
    return at_rest(page, page.screenshot)


def is_red(picture: np.ndarray) -> np.ndarray:
    """Where the red ball is seen, beside the list."""
    return np.asarray(picture[:, :550, 2] - picture[:, :550, 0] > 25)


def red_middle(picture: np.ndarray) -> float:
    """Where it is seen across the page."""
    return float(np.nonzero(is_red(picture))[1].mean())


def test_a_scene_is_turned_in_the_browser_and_what_is_hidden_goes(
    page_file: Path, looked: Callable[..., Any]
) -> None:
    looked(turn_and_hide, page_file)


def test_no_name_covers_another_nor_leaves_the_page(tmp_path: Path, looked: Callable[..., Any]) -> None:
    near = [
        replace(
            RED, label=f"a path with a long name {n}", label_mm=AT_MM + np.array([50.0 * (n > 2), 0.0, 2.0 * n])
        )
        for n in range(6)
    ]
    near[5] = replace(
        near[5], label="a path with a long name, of which half the page has room for, then the name, second"
    )
    near[4] = replace(near[4], label="\u05e9\u05de\u05d0\u05dc (\u05e7\u05d3\u05de\u05d9) " * 9)
    file = tmp_path / "scene.html"
    file.write_bytes(html([*near, SKIN], "a case", b""))
    looked(read_names, file)


def test_the_far_side_of_what_is_seen_through_is_seen(tmp_path: Path, looked: Callable[..., Any]) -> None:
    file = tmp_path / "scene.html"
    file.write_bytes(html([SKIN], "a case", b""))
    looked(see_the_far_side, file)


def test_without_webgl_the_still_is_seen(page_file: Path) -> None:
    apart(see_the_still, page_file)


def test_a_report_runs_its_viewer_and_leaves_the_wheel_to_the_page_until_it_is_clicked(
    tmp_path: Path, looked: Callable[..., Any]
) -> None:
    seen = f'<div class="scene">{view([RED, SKIN], "a case", b"")}</div><p><span id="how"></span></p>'
    file = tmp_path / "report.html"
    file.write_text(
        report_html.page("a report", [seen, '<div style="height: 3000px"></div>'], style=STYLE, script=viewer())
    )
    looked(scroll_past, file)


def scroll_past(page: Any, page_file: Path) -> None:
    told: list[str] = []
    page.on("console", lambda message: told.append(message.text) if message.type == "error" else None)
    drawn(page, page_file, 700, 600)
    before = shown(page)
    page.mouse.move(200, 200)
    page.mouse.wheel(0, 120)
    eventually(page, lambda: bool(page.evaluate("window.scrollY > 50")))
    shown(page)
    page.evaluate("window.scrollTo(0, 0)")
    page.locator("canvas").click(position={"x": 150, "y": 150})
    page.mouse.wheel(0, -300)
    eventually(page, lambda: bool(np.abs(shown(page) - before).max() > 50))
    assert page.evaluate("window.scrollY") == 0
    assert told == []


def turn_and_hide(page: Any, page_file: Path) -> None:
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    drawn(page, page_file, 700, 400)
    assert not page.locator("#still").is_visible()
    assert "left" not in page.locator("footer").text_content()
    eventually(page, lambda: bool(is_red(shown(page)).any()))
    left, right, face = (page.locator(f"#names .side >> text={letter}") for letter in "LRA")
    assert left.bounding_box()["x"] > right.bounding_box()["x"] + 50  # the patient's, seen from the front
    before, face_before = red_middle(shown(page)), face.bounding_box()["x"]
    page.mouse.move(150, 300)
    page.mouse.down()
    page.mouse.move(250, 300, steps=3)
    page.mouse.up()
    eventually(page, lambda: red_middle(shown(page)) > before + 10)  # the near side follows the hand
    assert face.bounding_box()["x"] > face_before + 10
    page.locator("canvas").focus()
    page.keyboard.press("ArrowLeft")
    turned = shown(page)
    name = page.locator("#names span:not(.side)")
    assert name.text_content() == "F1"
    assert name.bounding_box()["x"] == pytest.approx(red_middle(turned) + 10, abs=8)  # it went with its marker
    page.click("summary")  # the list covers nothing until it is asked for
    page.uncheck("text=marker F1")
    eventually(page, lambda: not is_red(shown(page)).any())
    assert not name.is_visible()
    assert (np.abs(shown(page) - turned).max(axis=2) > 25).mean() > 0.003
    page.evaluate(
        "document.querySelector('canvas').getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()"
    )
    page.wait_for_selector("#still", state="visible")
    page.wait_for_selector("footer >> text=the left of the head on the right")
    assert errors == []


def read_names(page: Any, page_file: Path) -> None:
    drawn(page, page_file)
    shown(page)
    names = page.locator("#names span:not(.side)")
    boxes = [name.bounding_box() for name in names.all()]
    ways = names.evaluate_all("(spans) => spans.map((one) => getComputedStyle(one).direction)")
    assert ways == ["ltr"] * 4 + ["rtl", "ltr"]
    written = names.all_text_contents()
    assert written[0] == "a path with a long name 0"
    assert written[5].startswith("a path with a long")
    assert written[5].endswith("name, second")
    assert "\u2026" in written[5]
    assert len(boxes) == 6
    assert all(one["x"] >= 0 and one["x"] + one["width"] <= 500 for one in boxes)
    for number, one in enumerate(boxes):
        for other in boxes[:number]:
            beside = abs(one["x"] - other["x"]) >= min(one["width"], other["width"]) - 0.5
            assert beside or abs(one["y"] - other["y"]) >= one["height"] - 0.5


def see_the_far_side(page: Any, page_file: Path) -> None:
    drawn(page, page_file)
    # one half of a blue of about 200, and another half of that which is left
    eventually(page, lambda: shown(page)[200, 250, 0] > 130)
    assert shown(page)[200, 20, 0] < 30


def see_the_still(page_file: Path) -> None:
    with chromium("--disable-3d-apis") as browser:
        page = browser.new_page(viewport={"width": 500, "height": 400})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(page_file.as_uri())
        eventually(page, lambda: shown(page)[200, 200].tolist() == [255, 255, 255])
        assert page.locator("canvas").is_hidden()
        assert page.locator("#shown").is_hidden()
