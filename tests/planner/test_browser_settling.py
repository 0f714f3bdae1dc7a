"""What is settled by hand in the page: an ambiguous pairing, names and sizes, AC and PC, markers."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.documents.fiducials import read_fiducials
from ronnaplan.documents.plan import change_plan, read_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.planning import Trajectory
from tests import cases
from tests.planner.browser import (
    Planner,
    crosshair,
    eventually,
    needs_browser,
    opened,
    planner,
    seen_at,
    value,
    with_head,
)

pytestmark = needs_browser

RECTANGLE = [(60.0, 40.0, 28.0), (-60.0, 40.0, 28.0), (-60.0, -40.0, 28.0), (60.0, -40.0, 28.0)]
"""A half turn maps these markers onto each other: the readings alone cannot tell which is which."""


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Planner]:
    """A planner that names the patient, and whose readings do not tell which marker is which."""
    folder, found = cases.write_case(tmp_path_factory.mktemp("ambiguous")), cases.fiducials()
    few = tuple(
        one.model_copy(update={"center": place}) for one, place in zip(found.fiducials, RECTANGLE, strict=False)
    )
    (folder / "fiducials.json").write_text(to_json(found.model_copy(update={"fiducials": few})))
    (folder / "registration.json").unlink()
    seen = cases.TURN.apply(np.array(RECTANGLE)) + cases.SHIFT_MM
    rows = [f"{name},{x},{y},{z}" for name, (x, y, z) in zip("abcd", seen, strict=True)]
    (folder / "readings.csv").write_text("\n".join(["label,x,y,z", *rows]) + "\n")
    with planner(folder, "--patient") as one:
        yield one


def status(folder: Path) -> str:
    return str(json.loads((folder / "registration.json").read_text())["status"])


def pairs(folder: Path) -> dict[str, str]:
    return {pair["ct"]: pair["ots"] for pair in json.loads((folder / "registration.json").read_text())["pairs"]}


def marker_at(page: Any, view: str, label: str) -> tuple[float, float]:
    """Pixels of a marker in a view."""
    drawn = value(page, f"drawn_{view}")
    one = next(one for one in drawn["markers"] if one["label"] == label)
    return seen_at(page, view, (one["x"] / drawn["half"], one["y"] / drawn["half"]))


@pytest.fixture
def page(page: Any) -> Any:
    """The module's page with its first panel."""
    page.click(".rp-tab >> text=Trajectories")
    page.wait_for_selector("#paths")
    return page


def test_an_ambiguity_is_settled_by_clicks_on_a_marker_and_a_reading(page: Any, kept: Planner) -> None:
    with_head(page)
    folder = kept.folder
    page.click(".rp-tab >> text=Registration")
    page.click("text=readings.csv")
    page.wait_for_selector("#ask")
    assert status(folder) == "ambiguous"
    refused = (folder / "registration.json").read_bytes()
    eventually(page, lambda: page.locator("#rivals tr.rp-differs").count() == 4)
    page.mouse.click(*marker_at(page, "axial", "F3"))
    page.wait_for_function("window.trame.state.get('pointing').marker === 'F3'")
    assert status(folder) == "ambiguous"
    page.click("#pick-readings tr:has-text('a')  >> nth=1")
    eventually(page, lambda: status(folder) == "unique")
    assert pairs(folder)["F3"] == "a"
    page.wait_for_selector("#register >> text=F3 is a")

    (folder / "registration.json").write_bytes(refused)  # as by another hand: to register anew takes seconds
    page.wait_for_selector("#ask")
    page.click("#pick-readings tr >> nth=3")
    page.wait_for_function("window.trame.state.get('pointing').reading === 'c'")
    page.mouse.click(*marker_at(page, "head", "F3"))
    eventually(page, lambda: status(folder) == "unique")
    assert pairs(folder) == {"F1": "a", "F2": "b", "F3": "c", "F4": "d"}


def test_a_trajectory_is_named_sized_and_noted_in_the_page(page: Any, kept: Planner) -> None:
    folder = kept.folder
    page.fill("#path-name", "lead")
    page.press("#path-name", "Tab")
    page.wait_for_selector("text=lead, LPS mm")
    page.fill("#diameter", "1.5")
    page.press("#diameter", "Tab")
    page.fill("#length", "60")  # while the answer to the one before is under way
    page.press("#length", "Tab")
    page.fill("#notes", "by hand")
    page.wait_for_function("window.trame.state.get('chosen').length === 60")
    assert page.input_value("#notes") == "by hand"
    page.press("#notes", "Tab")

    def written() -> bool:
        one = read_plan(folder / "plan.json").trajectories[0]
        sizes = (one.instrument.diameter_mm, one.instrument.length_mm)
        return (one.name, sizes, one.notes) == ("lead", (1.5, 60.0), "by hand")

    eventually(page, written)
    page.fill("#diameter", "-1")
    page.press("#diameter", "Enter")
    page.wait_for_function("window.trame.state.get('message').includes('expected a positive length')")
    assert written()
    page.wait_for_function("document.getElementById('diameter').value === '1.5'")
    page.click("text=lock")
    page.wait_for_function("document.getElementById('path-name').disabled")
    assert read_plan(folder / "plan.json").trajectories[0].locked


def test_what_is_half_typed_when_another_hand_changes_the_plan_is_entered_nowhere(
    page: Any, kept: Planner
) -> None:
    path, scan = kept.folder / "plan.json", cases.volume()
    entry, target = np.array(cases.ENTRY_MM), np.array(cases.TARGET_MM)
    change_plan(path, lambda plan: plan.add(Trajectory("one", entry, target, scan.frame)))
    change_plan(path, lambda plan: plan.add(Trajectory("two", entry, target, scan.frame)))
    page.click("#paths .rp-row button:has-text('one')")
    page.wait_for_selector("text=one, LPS mm")
    for typed, act in (
        ("3", lambda plan: plan.edit("one", entry_mm=entry + np.eye(3)[0])),
        (f"{entry[0] + 2:g}", lambda plan: plan.remove("one")),
    ):
        page.click("#entry-x")
        page.keyboard.press("Control+a")
        page.keyboard.type(typed)
        change_plan(path, act)
        page.wait_for_function("typed => document.getElementById('entry-x').value !== typed", arg=typed)
        page.keyboard.press("Tab")
    page.click("#paths .rp-row button:has-text('two')")
    page.fill("#notes", "told after all that")
    page.press("#notes", "Tab")
    eventually(page, lambda: bool(read_plan(path).trajectory("two").notes))
    assert np.array_equal(read_plan(path).trajectory("two").entry_mm, entry)
    assert [one.action for one in read_plan(path).history[-5:]] == ["add", "add", "edit", "remove", "edit"]
    change_plan(path, lambda plan: plan.remove("two"))


def test_a_button_does_not_overtake_the_press_before_it(page: Any, kept: Planner) -> None:
    x, y = seen_at(page, "axial", (0.3, 0.2))
    page.evaluate(
        """([x, y]) => {
          const view = document.querySelector("svg[data-view=axial]");
          view.setPointerCapture = () => {};  // no such pointer is there to be captured
          const at = { clientX: x, clientY: y, pointerId: 1, button: 0, bubbles: true, cancelable: true };
          for (const kind of ["pointermove", "pointerdown", "pointerup"]) {
            view.dispatchEvent(new PointerEvent(kind, { ...at, buttons: kind === "pointerdown" ? 1 : 0 }));
          }
          document.querySelector("[title='Set AC where the crosshair is']").click();
        }""",
        [x, y],
    )
    page.wait_for_function("window.trame.state.get('landmarks')[0].place")
    shown = [float(part) for part in page.evaluate("window.trame.state.get('landmarks')[0].place").split(",")]
    eventually(page, lambda: crosshair(kept.folder)[:1] > [20.0])  # it began at 4 mm
    assert crosshair(kept.folder) == pytest.approx(shown, abs=0.01)


def test_ac_and_pc_are_set_at_the_crosshair_and_typed(page: Any, kept: Planner) -> None:
    folder = kept.folder
    page.mouse.click(*seen_at(page, "axial", (0.0, -0.1)))
    page.click("text=set AC here")
    page.wait_for_function("window.trame.state.get('landmarks')[0].place")
    for name, typed in (("PC", "0, 24, 28"), ("midline", "0 10 60")):
        page.fill(f"input[aria-label={name}]", typed)
        page.press(f"input[aria-label={name}]", "Enter")
        page.wait_for_function(
            "name => window.trame.state.get('landmarks').find(one => one.name === name).place", arg=name
        )
    landmarks = read_plan(folder / "plan.json").landmarks
    assert landmarks is not None
    ac_mm = landmarks.ac_mm
    eventually(page, lambda: crosshair(folder) == pytest.approx(ac_mm))
    assert landmarks.pc_mm == pytest.approx([0, 24, 28])
    page.wait_for_selector("#measures >> text=AC-PC sagittal, coronal angle")
    page.fill("input[aria-label=PC]", "here")
    page.press("input[aria-label=PC]", "Enter")
    page.wait_for_function("window.trame.state.get('message').includes('is no place')")


def test_markers_are_rejected_renamed_and_taken_back(page: Any, kept: Planner) -> None:
    def labels() -> list[str]:
        return [one.label for one in read_fiducials(kept.folder / "fiducials.json").fiducials]

    page.click(".rp-tab >> text=Markers")
    page.click("#markers tr.rp-row >> nth=1 >> text=reject")
    eventually(page, lambda: "F2" not in labels())
    page.fill("input[aria-label='rename F1']", "nose")
    page.press("input[aria-label='rename F1']", "Enter")
    eventually(page, lambda: labels()[0] == "nose")
    page.keyboard.press("Control+z")
    eventually(page, lambda: labels()[0] == "F1")
    page.keyboard.press("Control+z")
    eventually(page, lambda: "F2" in labels())
    page.keyboard.press("Control+Shift+z")
    eventually(page, lambda: "F2" not in labels())
    page.keyboard.press("Control+z")  # other tests need it
    eventually(page, lambda: "F2" in labels())


def test_the_patient_is_named_when_asked_for(page: Any) -> None:
    assert page.inner_text("#patient") == "PHANTOM^SYNTHETIC"


def test_keys_are_listed_and_a_view_is_enlarged_in_this_tab_only(page: Any, browser: Any, kept: Planner) -> None:
    other = opened(browser, kept.url)
    small = page.locator("[data-view=coronal]").bounding_box()["width"]
    page.click(".rp-coronal [data-grow]")
    eventually(page, lambda: page.locator("[data-view=coronal]").bounding_box()["width"] > 2.5 * small)
    assert other.locator("[data-view=coronal]").bounding_box()["width"] == small
    page.click(".rp-coronal [data-grow]")
    page.set_viewport_size({"width": 390, "height": 500})
    page.keyboard.press("?")
    assert page.locator("#keys").evaluate(
        "(list) => list.scrollHeight > list.clientHeight && list.scrollTop === 0"
    )
    listed = page.inner_text("#keys")
    for key in value(page, "keys"):
        assert key.split("+")[-1].replace("page", "page ").lower() in listed.lower()
    for words in ("move the crosshair by 1 mm", "clicks at the crosshair", "goes onto the scalp"):
        assert words in listed  # what keys do in a view, which the server knows nothing of
    page.keyboard.press("Escape")
    page.wait_for_selector("#keys", state="hidden")
