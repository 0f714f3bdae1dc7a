"""Many trajectories and markers, with names that are long, in other scripts, or look like markup."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.documents.plan import change_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.planning import Plan
from tests import cases
from tests.long import few_and_others
from tests.planner.browser import PATIENCE_MS, Planner, eventually, needs_browser, opened, planner, value

pytestmark = needs_browser

NAMES = (
    "left anterior hippocampus, approach through the middle temporal gyrus below the vein, after the conference",
    "\u05e9\u05de\u05d0\u05dc \u05d4\u05d9\u05e4\u05d5\u05e7\u05de\u05e4\u05d5\u05e1 (CT (2)) " * 4,
    "\u5de6\u6d77\u9a6c\u524d\u90e8\u901a\u8fc7\u989e\u4e2d\u56de" * 6,
    "x" * 300,
    "<b>bold</b> & {{ 7 * 7 }}",
)

OVERFLOW = """() => {
  const side = document.querySelector(".rp-side"), edge = side.getBoundingClientRect().right + 1;
  const beyond = [...side.querySelectorAll("*")].filter((one) => one.getBoundingClientRect().right > edge);
  return [side.scrollWidth - side.clientWidth, document.documentElement.scrollWidth - innerWidth,
    beyond.map((one) => one.outerHTML.slice(0, 90))];
}"""


def crowded(folder: Path) -> Path:
    """A case of 24 trajectories, 16 markers, and a file of readings with a long name."""
    cases.write_case(folder)
    generator = np.random.default_rng(3)

    def more(plan: Plan) -> Plan:
        one = plan.trajectory("left")
        for name in (*NAMES, *(f"E{number}" for number in range(24 - len(NAMES)))):
            plan = plan.add(replace(one, name=name.strip(), target_mm=one.target_mm + generator.uniform(-9, 9, 3)))
        return plan

    change_plan(folder / "plan.json", more)
    found = cases.fiducials()
    shown = [
        one.model_copy(update={"label": name.strip()}) for one, name in zip(found.fiducials, NAMES, strict=False)
    ]
    places = generator.uniform(-70, 70, (16 - len(found.fiducials), 3)).tolist()
    extra = [
        found.fiducials[-1].model_copy(update={"label": f"M{n}", "center": tuple(place), "flags": ("radius",)})
        for n, place in enumerate(places)
    ]
    whole = (*shown, *found.fiducials[len(NAMES) :], *extra)
    (folder / "fiducials.json").write_text(to_json(found.model_copy(update={"fiducials": whole})))
    (folder / "registration.json").unlink()
    cases.write_readings(folder / f"{NAMES[0]}.csv")
    return folder


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with planner(crowded(tmp_path_factory.mktemp("crowded"))) as one:
        yield one


@pytest.fixture(scope="module")
def page(running_browser: Any, full: Planner) -> Iterator[Any]:
    """One page for all sizes: to list so much in a new one takes seconds."""
    page = opened(running_browser, full.url)
    page.wait_for_selector("#errors td")  # which markers an error is expected with
    page.wait_for_selector("#broken td")
    yield page
    page.close()


@few_and_others(("width", "height"), [(390, 844), (1280, 800)], [(640, 400)])
def test_long_names_stay_within_their_line_and_are_whole_in_their_title(
    page: Any, width: int, height: int
) -> None:
    """A screen of 1,280 x 800 that is enlarged twice has 640 x 400."""
    page.set_viewport_size({"width": width, "height": height})
    for tab in ("Registration", "Markers", "Trajectories"):
        page.click(f".rp-tab >> text={tab}")
        page.wait_for_selector(f".rp-tab[aria-selected=true] >> text={tab}")
        page.wait_for_timeout(100)
        assert page.evaluate(OVERFLOW) == [0, 0, []], tab
    rows = page.locator("#paths .rp-row")
    plain = rows.last.bounding_box()["height"]
    for number, name in enumerate(NAMES, start=1):
        assert rows.nth(number).bounding_box()["height"] == pytest.approx(plain, abs=4.0)
        assert name.strip() in rows.nth(number).locator("button").first.get_attribute("title")
        written = rows.nth(number).locator("bdi")
        assert written.text_content() == name.strip()
        (listed, last), room = (
            (one.bounding_box() for one in (written, written.locator("span").last)),
            rows.nth(number).locator("td").first.bounding_box(),
        )
        for box in (listed, last):  # the end of a long name is seen, too: it may be told from another only there
            assert room["x"] - 1 <= box["x"] < box["x"] + box["width"] <= room["x"] + room["width"] + 1


def test_what_stands_below_a_long_list_is_within_reach_and_what_is_selected_is_seen(
    page: Any, running_browser: Any, full: Planner
) -> None:
    page.set_viewport_size({"width": 1280, "height": 800})
    page.wait_for_selector("#measures td")
    assert page.locator("#remarks").bounding_box()["height"] < 40  # flagged markers: a long sentence
    page.click("#remarks summary")
    assert "radius" in page.inner_text("#remarks p")
    page.click("#remarks summary")
    page.locator("#entry-x").scroll_into_view_if_needed()
    listed = page.locator(".rp-list").bounding_box()
    assert listed["height"] < 330
    page.locator("#paths .rp-row").last.scroll_into_view_if_needed()
    page.click("#paths .rp-row >> nth=-1")
    last = value(page, "paths")[-1]["name"]
    eventually(page, lambda: bool(value(page, "chosen")["name"] == last))
    other = opened(running_browser, full.url)  # begins where this one looked
    assert value(other, "chosen")["name"] == last
    other.wait_for_function(
        """() => { const list = document.querySelector(".rp-list").getBoundingClientRect(),
          row = document.querySelector(".rp-row.on").getBoundingClientRect();
          return row.top >= list.top - 1 && row.bottom <= list.bottom + 1; }""",
        timeout=PATIENCE_MS,
    )
    other.close()
