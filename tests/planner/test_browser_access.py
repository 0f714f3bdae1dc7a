"""The page without a mouse and without eyes, and while something long is being worked on."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.documents.plan import change_plan, read_plan
from ronnaplan.planning.electrodes import ELECTRODES
from tests.planner.browser import (
    PATIENCE_MS,
    Planner,
    at_rest,
    eventually,
    needs_browser,
    opened,
    place,
    planner,
    value,
    wait_until_whole,
    with_head,
)

pytestmark = needs_browser

axe = pytest.importorskip("axe_playwright_python")
AXE = (files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(running_browser: Any, shared: Planner) -> Iterator[Any]:
    """One open page for all tests here; they leave it as they found it."""
    page = opened(running_browser, shared.url, 1440, 900)
    page.evaluate(AXE)
    yield page
    page.close()


def faults(page: Any) -> list[str]:
    """What axe-core finds that keeps people out, or is amiss with headings, with the first place of each."""
    rules = (
        "rules: { 'label-content-name-mismatch': { enabled: true } }"  # what is seen is what is said to a computer
    )
    found = page.evaluate(f"axe.run(document, {{ resultTypes: ['violations'], {rules} }})")["violations"]
    named = ("heading-order", "page-has-heading-one", "empty-table-header")
    grave = [one for one in found if one["impact"] in ("serious", "critical") or one["id"] in named]
    return [f"{one['id']}: {one['help']} {one['nodes'][0]['html'][:200]}" for one in grave]


@pytest.mark.parametrize("panel", ["Markers", "Registration", "Files", "Trajectories"])
def test_no_serious_fault_keeps_anyone_out(page: Any, panel: str) -> None:
    page.click(f".rp-tab >> text={panel}")
    page.wait_for_selector("#markers, #register, #files, #paths")
    page.wait_for_function(
        "document.getAnimations().every(one => one.playState !== 'running')"
    )  # its colours change
    assert faults(page) == []


@pytest.mark.parametrize("panel", ["Markers", "Registration", "Files", "Trajectories"])
def test_what_can_be_clicked_is_large_enough_and_the_page_can_be_enlarged(page: Any, panel: str) -> None:
    """WCAG 2.2 asks for 24 pixels; the sides of the cube are seen aslant."""
    page.click(f".rp-tab >> text={panel}")
    page.wait_for_selector(f".rp-tab[aria-selected=true] >> text={panel}")
    found = page.evaluate("axe.run('.rp-side', { runOnly: ['target-size'] })")["violations"]
    assert [node["html"][:100] for one in found for node in one["nodes"]] == []
    assert "scale=1," not in page.locator("meta[name=viewport]").get_attribute("content")


def test_what_is_pressed_is_seen_in_a_contrast_theme(page: Any) -> None:
    pressed, other = (page.locator(f".rp-bar [aria-pressed={one}]").first for one in ("true", "false"))
    page.emulate_media(forced_colors="active")
    colours = [one.evaluate("one => getComputedStyle(one).backgroundColor") for one in (pressed, other)]
    page.emulate_media(forced_colors="none")
    assert colours[0] != colours[1]


def test_no_bar_of_another_length_and_no_panel_is_printed_but_where_there_is_a_report(page: Any) -> None:
    """Paper has panes of another shape than the screen, for which the pictures were drawn."""
    bar = page.locator(".rp-axial .rp-scale-bar")
    shown = bar.is_visible()
    page.emulate_media(media="print")
    printed = bar.is_visible()
    told = page.evaluate("getComputedStyle(document.querySelector('.rp-main'), '::before').content")
    panels = page.locator(".rp-side").is_visible()
    page.emulate_media(media="screen")
    assert (shown, printed) == (True, False)
    assert ("report.pdf" in told, panels) == (True, False)  # half a panel would be lost without a word


def test_what_can_be_clicked_is_reached_by_the_keyboard(page: Any) -> None:
    page.click(".rp-tab >> text=Markers")
    page.wait_for_selector("#markers")
    assert page.evaluate("[...document.querySelectorAll('.rp-row')].every((row) => row.querySelector('button'))")
    page.locator("#markers button[aria-label^='show F2 at']").focus()
    page.keyboard.press("Enter")
    page.wait_for_function("window.trame.state.get('look').marker === 'F2'")
    outline = "getComputedStyle(document.activeElement).outlineStyle"
    assert page.evaluate(outline) == "solid"
    page.locator("svg[data-view=axial]").focus()
    before = value(page, "drawn_coronal")["cross"]
    page.keyboard.press("ArrowRight")
    page.keyboard.press("PageDown")
    eventually(page, lambda: value(page, "drawn_coronal")["cross"][1] != before[1])
    after = value(page, "drawn_coronal")["cross"]
    assert after[0] - before[0] == pytest.approx(1.0)
    assert abs(after[1] - before[1]) == pytest.approx(1.5)
    page.keyboard.press("d")  # a distance is measured
    page.wait_for_selector("#asked[role=status] >> text=click the first point", state="attached")
    for key in ("Enter", "ArrowRight", "Enter"):
        page.keyboard.press(key)
    told = page.locator("#under").inner_text().split()
    eventually(page, lambda: page.locator("#spoken[aria-live=polite]").inner_text().split() == told)
    page.wait_for_function("window.trame.state.get('rulers').length === 1")
    assert value(page, "rulers")[0]["value"] == "1.0 mm"
    page.keyboard.press("Control+z")
    page.wait_for_function("window.trame.state.get('rulers').length === 0")


def test_the_verdict_is_spoken(page: Any) -> None:
    page.click(".rp-tab >> text=Trajectories")
    verdict = page.locator("#verdict[aria-live=polite]")
    eventually(page, lambda: "limits" in (verdict.text_content() or ""))
    page.click(".rp-tab >> text=Markers")
    page.wait_for_selector("#markers")
    assert "limits" in (verdict.text_content() or "")  # whichever panel is shown
    page.click(".rp-tab >> text=Trajectories")
    rows = value(page, "chosen")["verdicts"]
    kept = [row for row in rows if row[2] != "FAIL"]
    assert page.locator("#broken tr").count() == len([row for row in rows if row[2] != "pass"])
    assert page.locator("#kept summary").text_content() == f"{len(kept)} of {len(rows)} limits kept"
    assert not page.locator("#kept tr >> nth=0").is_visible()
    page.click("#kept summary")
    page.wait_for_selector("#kept tr >> nth=0", state="visible")


def test_long_work_is_shown_cancelled_and_holds_nothing_up(page: Any) -> None:
    page.click(".rp-tab >> text=Markers")
    before = value(page, "markers")
    page.click("#markers .rp-btn >> text=localize")
    page.wait_for_selector("#work >> text=looking for balls of 11.5 mm")
    assert page.locator("#markers .rp-btn").is_disabled()
    cross = value(page, "drawn_coronal")["cross"]
    page.evaluate("window.trame.trigger('localize', [9.0])")
    page.wait_for_selector("#message >> text=wait for that, or cancel it first")
    page.locator("svg[data-view=axial]").focus()
    page.keyboard.press("PageUp")
    eventually(page, lambda: value(page, "drawn_coronal")["cross"] != cross)
    assert value(page, "work")["what"]
    page.click("#work >> text=cancel")
    page.wait_for_selector("#news >> text=cancelled: looking for balls")
    eventually(page, lambda: not value(page, "work")["what"])
    assert value(page, "markers") == before
    page.click("#news >> text=dismiss")
    page.wait_for_selector("#news", state="detached")


def test_the_panels_are_reached_at_once_and_long_work_leaves_the_focus_where_it_is(page: Any) -> None:
    skip = page.locator("button, a, input").nth(1)
    above = skip.bounding_box()
    skip.focus()
    assert above["y"] < 0 < skip.bounding_box()["y"]  # it is seen while it has the focus
    page.keyboard.press("Enter")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.matches('.rp-tab')")
    page.click(".rp-tab >> text=Markers")
    page.locator("#localize-diameter").focus()
    refusals = value(page, "refusals")
    for _ in range(3):
        page.keyboard.down("Enter")  # held for a while
    page.keyboard.up("Enter")
    page.wait_for_selector("#work >> text=looking for balls of 11.5 mm")
    page.click("#work >> text=cancel")
    eventually(page, lambda: not value(page, "work")["what"])
    assert value(page, "refusals") == refusals
    button = page.locator("#markers .rp-btn")
    button.focus()
    page.keyboard.press("Enter")
    page.wait_for_selector("#work >> text=looking for balls of 11.5 mm")
    page.wait_for_timeout(300)
    assert button.is_disabled()
    assert button.evaluate("button => button === document.activeElement")
    page.evaluate("window.trame.trigger('cancel')")
    eventually(page, lambda: not value(page, "work")["what"])


def test_the_field_for_a_file_of_readings_is_seen_when_it_has_the_focus(page: Any) -> None:
    page.click(".rp-tab >> text=Files")
    field = page.locator("#readings-file")
    frame = "field => getComputedStyle(field.parentElement).outlineStyle"
    assert field.evaluate(frame) == "none"
    for _ in range(30):
        page.keyboard.press("Tab")
        if field.evaluate("field => field === document.activeElement"):
            break
    assert field.evaluate(frame) == "solid"


COLOURED = """([status, doubts]) => {
  const { state } = window.trame;
  state.set("registration", { ...state.get("registration"), status, summary: `${status}: FRE 0.1 mm`, doubts });
  return new Promise((done) => setTimeout(() => done(document.getElementById("status").className), 100));
}"""


def test_a_registration_that_is_doubted_is_not_green(page: Any) -> None:
    page.click(".rp-tab >> text=Registration")
    before = value(page, "registration")
    colours = [
        page.evaluate(COLOURED, [status, doubts])
        for status, doubts in (("unique", []), ("unique", ["far too exact"]), ("ambiguous", ["two are alike"]))
    ]
    page.evaluate("before => window.trame.state.set('registration', before)", before)
    assert colours == ["rp-good", "rp-doubt", "rp-bad"]


def test_a_layout_shows_fewer_views_larger_and_names_stay_where_they_belong(page: Any) -> None:
    page.click(".rp-bar .rp-btn >> text=3-D")
    page.wait_for_selector("svg[data-view=inline]", state="hidden")
    box = page.locator("svg[data-view=head]").bounding_box()
    assert box["height"] > 700

    def fits() -> bool:
        drawn = value(page, "drawn_head")
        return bool(abs(drawn["wide"] / drawn["high"] - box["width"] / box["height"]) < 0.01)

    eventually(page, fits)
    page.click(".rp-bar .rp-btn >> text=path")
    page.wait_for_selector("svg[data-view=second]", state="visible")
    eventually(page, lambda: value(page, "drawn_second")["letters"] != value(page, "drawn_inline")["letters"])
    eventually(page, lambda: page.locator("svg[data-view=second] .rp-tick text").count() == 7)
    page.click(".rp-bar .rp-btn >> text=six")
    page.wait_for_selector("svg[data-view=inline]", state="visible")
    page.wait_for_selector("svg[data-view=second]", state="hidden")


def test_one_view_alone_is_remembered(page: Any) -> None:
    page.click(".rp-coronal .rp-grow")
    page.wait_for_selector(".rp-coronal.grown")
    page.reload()
    page.wait_for_selector(".rp-coronal.grown canvas[data-number]")
    whole = page.locator(".rp-views").bounding_box()
    eventually(page, lambda: page.locator("svg[data-view=coronal]").bounding_box() == whole)
    page.click(".rp-coronal .rp-grow")
    page.wait_for_selector("svg[data-view=axial]", state="visible")
    page.wait_for_selector(".rp-coronal:not(.grown)")


def test_depths_from_the_target_are_marked_along_the_path(page: Any) -> None:
    page.wait_for_selector("svg[data-view=inline] .rp-tick >> nth=0", state="attached")
    told = page.locator("svg[data-view=inline] .rp-tick text").all_text_contents()
    assert told == [str(depth) for depth in range(10, 71, 10)]  # the path is 71.6 mm long


def test_two_fingers_zoom_and_move_the_picture(page: Any) -> None:
    fingers = page.context.new_cdp_session(page)
    (x, y), before = place(page, "axial", 0.5, 0.5), value(page, "drawn_axial")

    def touch(kind: str, *places: tuple[float, float]) -> None:
        points = [{"x": px, "y": py, "id": n} for n, (px, py) in enumerate(places)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", (x - 20, y))
    touch("touchStart", (x - 20, y), (x + 20, y))
    for wide in (25, 35, 45, 55, 65):
        touch("touchMove", (x - wide, y), (x + wide, y))
    touch("touchEnd")
    apart = pytest.approx(before["half"] / 1.15**8)  # the whole steps of 1.15 in 130 / 40 pixels
    eventually(page, lambda: value(page, "drawn_axial")["half"] == apart)
    near = value(page, "drawn_axial")
    page.click("#distance")  # two fingers click no point meanwhile
    touch("touchStart", (x - 20, y))
    touch("touchStart", (x - 20, y), (x + 20, y))
    for far in (6, 15, 30, 50):
        touch("touchMove", (x - 20, y + far), (x + 20, y + far))
    touch("touchEnd")
    eventually(page, lambda: value(page, "drawn_axial")["cross"][1] > near["cross"][1] + 10)
    assert value(page, "drawn_axial")["half"] == near["half"]
    assert value(page, "look")["asks"] == "click the first point"
    touch("touchStart", (x, y))
    touch("touchEnd")
    eventually(page, lambda: value(page, "look")["asks"] == "click the second point")
    page.keyboard.press("Escape")
    page.keyboard.press("f")
    eventually(page, lambda: value(page, "drawn_axial")["half"] == before["half"])


def test_an_electrode_is_chosen_by_the_keyboard_and_by_another_hand(page: Any, shared: Planner) -> None:
    page.click(".rp-tab >> text=Trajectories")
    plan = shared.folder / "plan.json"
    before = len(read_plan(plan).history)
    chosen = page.get_by_role("combobox", name="Electrode that stays, its tip at the target")
    contacts = page.locator("svg[data-view=inline] .rp-contact")
    assert chosen.input_value() == "none"
    page.locator("#length").focus()
    page.keyboard.press("Tab")
    page.keyboard.type("Medtronic 3389")
    eventually(page, lambda: read_plan(plan).trajectory("left").electrode == ELECTRODES["Medtronic 3389"])
    eventually(page, lambda: contacts.count() == 4 and chosen.input_value() == "Medtronic 3389")
    page.wait_for_selector("#kept >> text=contacts to metal", state="attached")  # folded
    change_plan(plan, lambda plan: plan.edit("left", electrode=ELECTRODES["DIXI D08-05AM"]))
    eventually(page, lambda: contacts.count() == 5 and chosen.input_value() == "DIXI D08-05AM")
    for _ in range(len(read_plan(plan).history) - before):
        page.click("#undo")
    eventually(page, lambda: contacts.count() == 0 and chosen.input_value() == "none")


def test_a_distance_is_measured_by_two_clicks(page: Any) -> None:
    page.click(".rp-tab >> text=Trajectories")
    page.click("#distance")
    page.wait_for_selector("#distance >> text=first point")
    page.mouse.click(*place(page, "axial", 0.5, 0.4))
    page.wait_for_selector("#distance >> text=second point")
    page.mouse.click(*place(page, "axial", 0.5, 0.6))
    page.wait_for_selector("#rulers >> text=D1")
    told = page.locator("#rulers td >> nth=1").text_content()
    assert page.locator("svg[data-view=axial] .rp-ruler text").text_content() == f"D1 {told}"
    drawn, box = value(page, "drawn_axial"), page.locator("[data-view=axial]").bounding_box()
    assert float(told.split()[0]) == pytest.approx(
        0.2 * box["height"] * 2 * drawn["high"] / box["height"], abs=1.0
    )
    page.click("#rulers >> text=remove")
    page.wait_for_selector("#rulers", state="detached")


DARK = 40
"""A grey that light letters are read on: the contrast is 10 or more."""

WHITE = """view => {
  const picture = document.querySelector(`canvas[data-picture=${view}]`);
  picture.parentElement.style.background = picture.style.visibility ? "" : "#fff";
  picture.style.visibility = picture.style.visibility ? "" : "hidden";
}"""
"""Have a view show nothing but white, or its picture again."""


def test_sides_scale_and_faint_names_are_read_on_white_bone(page: Any) -> None:
    """Letters as light as bone are told from it by what surrounds them."""
    page.evaluate(WHITE, "axial")
    for what in ("edge-0", "edge-1", "scale-bar", "title"):
        seen = at_rest(page, lambda: page.locator(f".rp-axial .rp-{what}").screenshot())  # noqa: B023
        assert seen.sum(axis=2).min() < 3 * DARK, what
    assert not value(page, "drawn_axial")["paths"][0]["near"][0]  # so that its name is faint
    faint = at_rest(page, page.locator("svg[data-view=axial] .rp-path text").first.screenshot)
    assert faint.sum(axis=2).min() < 3 * 2 * DARK
    page.evaluate(WHITE, "axial")


SHOWN_ONE_AFTER_THE_OTHER = """async ([name, part, lists]) => {
  const { state } = window.trame, before = state.get(name);
  const painted = () => new Promise((done) => setTimeout(done, 100));
  for (const rows of lists) {
    state.set(name, { ...before, [part]: rows });
    await painted();
  }
  const text = (place) => [...document.querySelectorAll(place)].map((one) => one.textContent.trim());
  const shown = { rows: text("#kept td:nth-child(2)"), points: text("svg[data-view=axial] .rp-point") };
  state.set(name, before);
  await painted();
  return shown;
}"""


def test_of_things_that_are_called_alike_none_stays_when_it_is_gone(page: Any) -> None:
    """A trajectory may have a marker's name, and a tool that of a point: their rows and places are told by number."""
    page.click(".rp-tab >> text=Trajectories")
    page.wait_for_selector("#kept", state="attached")
    limits = [
        [(name, value, "pass") for name, value in one] for one in (("a1", "b2", "b3", "c4"), ("b5", "c6", "b7"))
    ]
    assert page.evaluate(SHOWN_ONE_AFTER_THE_OTHER, ["chosen", "verdicts", limits])["rows"] == ["5", "6", "7"]
    written = {"x": 0, "y": 0, "anchor": "start"}
    points = [
        [
            {"x": 0, "y": 0, "colour": "#ffffff", "label": name, "written": {**written, "text": name + value}}
            for name, value in one
        ]
        for one in (("a1", "b2", "b3", "c4"), ("b5", "c6", "b7"))
    ]
    assert page.evaluate(SHOWN_ONE_AFTER_THE_OTHER, ["drawn_axial", "points", points])["points"] == [
        "b5",
        "c6",
        "b7",
    ]


def test_the_tools_take_one_line_and_no_view_moves_while_points_are_clicked(page: Any) -> None:
    """What is asked for is longer than the button's name; views that moved by it would be clicked elsewhere."""
    bar = page.locator(".rp-bar")
    for width, lines in ((800, 2), (1024, 1), (1280, 1), (1440, 1)):
        page.set_viewport_size({"width": width, "height": 800})
        high = bar.bounding_box()["height"]
        assert high < 45 * lines
        for tool in ("distance", "angle"):
            page.click(f"#{tool}")
            page.wait_for_selector(f"#{tool} >> text=first point")
            assert bar.bounding_box()["height"] == high, (width, tool)
            page.keyboard.press("Escape")
            page.wait_for_selector(f"#{tool} >> text={tool}")
    page.set_viewport_size({"width": 1440, "height": 900})


def test_a_name_from_right_to_left_that_is_shortened_ends_at_its_left(page: Any) -> None:
    ends_at_left = page.evaluate("""() => {
        const text = document.createElementNS("http://www.w3.org/2000/svg", "text");
        text.textContent = "\\u05e9\\u05de\\u05d0\\u05dc (\\u05e7\\u2026";
        document.querySelector("svg[data-view=axial]").append(text);
        const at = (n) => text.getExtentOfChar(n).x, last = text.textContent.length - 1;
        const left = [...Array(last).keys()].every((n) => at(last) < at(n));
        text.remove();
        return left;
    }""")
    assert ends_at_left


def test_an_upright_screen_wastes_no_room_on_views_of_a_trajectory_that_is_not_there(
    browser: Any, tmp_path: Path
) -> None:
    with planner(tmp_path) as bare:
        page = opened(browser, bare.url, 390, 844)
        assert page.locator("svg[data-view=inline]").is_hidden()
        assert page.locator("svg[data-view=axial]").bounding_box()["height"] > 200
        label = page.locator("svg[data-view=head]").get_attribute("aria-label")
        assert "arrow keys turn it" in label
        page.set_viewport_size({"width": 1280, "height": 800})
        assert page.locator(".rp-inline >> text=no trajectory yet: add one (A)").is_visible()


def test_a_phone_has_its_tools_in_one_line_and_sees_its_head(running_browser: Any, shared: Planner) -> None:
    context = running_browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(shared.url)
    wait_until_whole(page)
    with_head(page)
    assert page.locator(".rp-bar").bounding_box()["height"] < 64
    assert page.locator(".rp-notice").is_visible()
    add, undo = (page.locator(which).bounding_box() for which in ("#add", "#undo"))
    assert add["height"] >= 40
    for width, height in ((844, 390), (390, 844)):  # what is pointed at is told beside the pictures, on none
        page.set_viewport_size({"width": width, "height": height})
        page.locator("svg[data-view=axial]").focus()
        page.wait_for_selector("#under >> text=HU")
        views, told = (page.locator(which).bounding_box() for which in (".rp-views", "#under"))
        assert views["y"] + views["height"] <= told["y"]
        assert told["y"] + told["height"] <= height
    assert undo["x"] + undo["width"] < 390
    tools = page.locator(".rp-tools")
    page.locator(".rp-bar .rp-btn >> text=3-D").focus()  # the browser draws them along
    assert tools.evaluate("one => one.scrollLeft") > 0
    head, cube = (page.locator(which).bounding_box() for which in ("[data-view=head]", ".rp-cube"))
    assert cube["width"] * cube["height"] < head["width"] * head["height"] / 25
    assert min(cube["width"], cube["height"]) >= 24  # what a finger meets at the least, by WCAG 2.2
    page.evaluate(AXE)
    assert faults(page) == []
    page.evaluate("document.querySelector('.rp-head').classList.add('rp-drawn-here')")  # whatever drew it
    assert not page.locator(".rp-open").is_visible()
    page.click(".rp-head [data-grow]")
    page.wait_for_function("document.querySelector('.rp-cube').getBoundingClientRect().width > 45")
    assert page.locator(".rp-open").is_visible()
    context.close()
