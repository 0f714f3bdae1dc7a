"""What is typed: numbers as they are written, three at once, and the focus stays where a person works by keyboard."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ronnaplan.case.judgement import Judgement
from ronnaplan.documents.plan import change_plan, read_plan
from ronnaplan.errors import InputError, UsageError
from ronnaplan.planner.actions import Actions
from ronnaplan.planner.panels import chosen_path
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.state import PlannerState
from tests import cases
from tests.planner.browser import Planner, crosshair, eventually, fields, needs_browser, value

FOCUSED = "document.activeElement.id"


@pytest.fixture
def page(page: Any) -> Any:
    """The module's page with its first panel."""
    page.click(".rp-tab >> text=Trajectories")
    page.wait_for_selector("#paths")
    return page


def enter(page: Any, field: str, text: str, key: str = "Enter") -> None:
    """Type over what stands in a field, enter it, and wait until that was answered."""
    before = value(page, "chosen"), value(page, "refusals")
    page.locator(field).focus()
    page.keyboard.press("Control+a")
    page.keyboard.type(text)
    page.keyboard.press(key)
    eventually(page, lambda: (value(page, "chosen"), value(page, "refusals")) != before)
    page.wait_for_timeout(50)


@needs_browser
def test_the_focus_of_what_is_taken_away_is_its_panel_s(page: Any) -> None:
    page.locator("[aria-label='remove left']").focus()
    page.keyboard.press("Enter")
    page.wait_for_selector("text=No trajectory yet")
    page.wait_for_function(f"{FOCUSED} === 'paths'")
    page.keyboard.press("?")
    page.keyboard.press("Control+z")  # behind the list of keys nothing is done
    page.keyboard.press("Escape")
    page.wait_for_timeout(300)
    assert value(page, "paths") == []
    page.keyboard.press("Alt+d")  # the browser's own
    page.keyboard.press("Control+z")  # keys do what they do elsewhere
    page.wait_for_selector("[aria-label='remove left']")
    assert value(page, "look")["measuring"] == 0


@needs_browser
def test_three_coordinates_are_pasted_into_one_field(page: Any, kept: Planner) -> None:
    enter(page, "#target-y", "(11.5, 6, -2.25e1)")
    assert fields(page, "target") == [11.5, 6.0, -22.5]
    assert page.evaluate(FOCUSED) == "target-y"


@needs_browser
def test_what_is_typed_on_after_another_hand_changed_the_field_is_no_key(page: Any, kept: Planner) -> None:
    plan = kept.folder / "plan.json"
    page.locator("#notes").focus()
    page.keyboard.type("half a ")
    change_plan(plan, lambda plan: plan.edit("left", notes="theirs"))
    page.wait_for_function("document.getElementById('notes').value === 'theirs'")
    page.keyboard.type("sda3")
    page.keyboard.press("Delete")
    page.keyboard.press("Tab")
    assert value(page, "look")["window"] == "bone"
    assert not value(page, "look")["adding"]
    assert len(read_plan(plan).trajectories) == 1
    page.locator("#add").focus()
    page.keyboard.press("3")
    eventually(page, lambda: value(page, "look")["window"] == "wide")


@needs_browser
def test_the_focus_stays_in_the_field_in_which_something_was_entered(page: Any, kept: Planner) -> None:
    plan = kept.folder / "plan.json"
    enter(page, "#entry-x", "30.5")
    assert page.evaluate(FOCUSED) == "entry-x"
    enter(page, "#entry-x", "12,5")  # a browser's own field for numbers makes 125 of it
    assert "'12,5' is not a number; write one such as 12.5, with a point" in value(page, "message")
    assert page.evaluate(FOCUSED) == "entry-x"
    assert page.input_value("#entry-x") == "30.5"
    enter(page, "#entry-x", "nose", "Tab")
    assert page.evaluate(FOCUSED) == "entry-y"  # which is made anew, too
    page.keyboard.press("ArrowDown")
    eventually(page, lambda: bool(read_plan(plan).trajectory("left").entry_mm[1] == -20.1))
    page.wait_for_function("document.getElementById('entry-y').defaultValue === '-20.1'")
    assert page.evaluate(FOCUSED) == "entry-y"
    page.keyboard.press("Control+z")  # nothing is being typed
    eventually(page, lambda: bool(read_plan(plan).trajectory("left").entry_mm[1] == -20.0))
    enter(page, "#path-name", "right")
    assert page.evaluate(FOCUSED) == "path-name"
    page.click(".rp-tab >> text=Markers")
    page.locator("#marker-1").focus()
    page.keyboard.press("Control+a")
    page.keyboard.type("nose")
    page.keyboard.press("Enter")
    page.wait_for_selector("[aria-label='reject nose']")
    assert page.evaluate(FOCUSED) == "marker-1"


@pytest.mark.parametrize("typed", ["11.5, 6, 21", "11.5,6,21", "11.5 6 21", "[11.5; 6; 21]"])
def test_places_are_typed_in_several_ways(state: PlannerState, typed: str) -> None:
    actions = Actions(state, Pointer(state)).by_name()
    actions["place"]("left", "target", 0, typed)
    assert state.case.plan.trajectory("left").target_mm.tolist() == [11.5, 6.0, 21.0]
    actions["landmark"]("AC", typed)
    assert state.landmarks_mm["AC"].tolist() == [11.5, 6.0, 21.0]


def test_a_target_is_typed_from_the_mid_commissural_point(state: PlannerState) -> None:
    actions, middle = Actions(state, Pointer(state)).by_name(), np.array([0.5, 2.0, 22.0])
    with pytest.raises(InputError, match="state AC, PC and a point of the midline first"):
        actions["place_acpc"]("left", 0, "-11")
    for name, off in {"AC": (0.0, -12.0, 0.0), "PC": (0.0, 12.0, 0.0), "midline": (0.0, 0.0, 40.0)}.items():
        state.set_landmark(name, middle + off)
    actions["place_acpc"]("left", 2, "-11, -3, -4")  # left, behind and below it
    assert state.case.plan.trajectory("left").target_mm == pytest.approx(middle + np.array([11.0, 3.0, -4.0]))
    actions["place_acpc"]("left", 0, "-12.5")
    assert state.case.plan.trajectory("left").target_mm == pytest.approx(middle + np.array([12.5, 3.0, -4.0]))
    state.look.select("left")
    assert chosen_path(state, Judgement())["acpc"] == [-12.5, -3.0, -4.0]
    actions["show_end"]("left", "entry")
    assert state.look.crosshair_mm.tolist() == cases.ENTRY_MM.tolist()
    actions["show_end"]("left", "target")
    assert state.look.crosshair_mm == pytest.approx(middle + np.array([12.5, 3.0, -4.0]))


@needs_browser
def test_its_fields_stand_there_once_the_three_points_are_set(page: Any, kept: Planner) -> None:
    name = read_plan(kept.folder / "plan.json").trajectories[0].name
    assert page.locator("#acpc-right").count() == 0
    for point, at in {"AC": "0, -12, 10", "PC": "0, 12, 10", "midline": "0, 0, 50"}.items():
        page.fill(f"#landmark-{point}", at)
        page.press(f"#landmark-{point}", "Enter")
        page.wait_for_function(f"document.getElementById('landmark-{point}').defaultValue")
    enter(page, "#acpc-right", "-9.5, -2, 8")
    assert page.evaluate(FOCUSED) == "acpc-right"
    eventually(page, lambda: fields(page, "target") == [9.5, 2.0, 18.0])
    page.click("button[title='Show the target']")
    eventually(page, lambda: crosshair(kept.folder) == [9.5, 2.0, 18.0])
    assert name in page.inner_text("#paths .rp-row.on")
    eventually(page, lambda: value(page, "paths")[0]["verdict"][0] in page.inner_text("#paths .rp-row.on"))
    assert value(page, "paths")[0]["verdict"][0]


@pytest.mark.parametrize(
    "typed",
    ["11,5 6,0 21,0", "11,5 6", "1_1", "\uff11", "0x1f", "nan", "1e999", "11,5", "1 2", "", "1,2,3,4", "1,,2"],
)
def test_what_is_no_number_by_the_letter_is_refused(state: PlannerState, typed: str) -> None:
    actions, before = Actions(state, Pointer(state)).by_name(), state.case.plan
    with pytest.raises(UsageError, match=r"is not a number; write one such as 12\.5, with a point"):
        actions["place"]("left", "target", 0, typed)
    with pytest.raises(UsageError, match=r"is no place|is not a number"):
        actions["landmark"]("AC", typed)
    with pytest.raises(UsageError, match="is no number of markers; write a whole one"):
        actions["placement"]("6.5")
    assert state.case.plan is before
    assert np.array_equal(before.trajectory("left").target_mm, cases.TARGET_MM)


@needs_browser
def test_what_is_refused_is_told_where_the_panel_is_scrolled_to(page: Any) -> None:
    page.wait_for_selector("#measures tr")  # the panel is as long as it gets
    page.evaluate("document.getElementById('landmark-AC').scrollIntoView()")
    page.fill("#landmark-AC", "1, 2")
    page.press("#landmark-AC", "Enter")
    page.wait_for_selector("#message >> text=is no place")
    assert page.evaluate("document.querySelector('.rp-side').scrollTop") > 60  # more than the message takes
    seen = page.locator("#message").bounding_box()
    assert seen["y"] >= page.locator(".rp-side").bounding_box()["y"]
