"""The 3-D view used with the mouse: picking, turning, and dragging an end to the same millimetres everywhere."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from ronnaplan.documents.plan import read_plan
from tests import cases
from tests.planner.browser import (
    Planner,
    crosshair,
    eventually,
    fields,
    kept_open,
    needs_browser,
    seen_at,
    settled,
    value,
    with_head,
)

pytestmark = needs_browser


@pytest.fixture(scope="module")
def page(running_browser: Any, shared: Planner) -> Iterator[Any]:
    """One page for all tests here; they leave the plan as they found it."""
    with kept_open(running_browser, shared.url) as page:
        yield with_head(page)


def drawn(page: Any, what: str, **named: str) -> dict[str, Any]:
    """What is drawn over the 3-D view under a label or name."""
    ((key, name),) = named.items()
    found: dict[str, Any] = next(one for one in value(page, "drawn_head")[what] if one[key] == name)
    return found


def test_an_end_is_dragged_in_3d_and_the_view_does_not_move(page: Any, shared: Planner) -> None:
    folder = shared.folder
    markers, before = value(page, "drawn_head")["markers"], fields(page, "target")
    x, y = seen_at(page, "head", drawn(page, "paths", name="left")["target"])
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 10, y - 5, steps=3)
    held = value(page, "picture_head")
    page.mouse.move(x + 30, y - 20)
    eventually(page, lambda: fields(page, "target") != before)
    page.mouse.up()
    after = settled(page, folder, "left", "target", before)

    def end() -> tuple[float, float]:
        return seen_at(page, "head", drawn(page, "paths", name="left")["target"])

    eventually(page, lambda: end() == pytest.approx((x + 30, y - 20), abs=1.0))
    assert value(page, "drawn_head")["markers"] == markers
    eventually(page, lambda: value(page, "picture_head") != held)
    page.keyboard.press("Control+z")
    assert settled(page, folder, "left", "target", after) == pytest.approx(before)
    assert len(read_plan(folder / "plan.json").undone) == 1


def test_markers_trajectories_and_the_skin_are_picked(page: Any, shared: Planner) -> None:
    folder = shared.folder
    plan = (folder / "plan.json").read_text()
    marker = drawn(page, "markers", label="F2")
    page.mouse.click(*seen_at(page, "head", (marker["x"], marker["y"])))
    page.wait_for_function("window.trame.state.get('look').marker === 'F2'")
    center = pytest.approx(cases.fiducials().fiducials[1].center)
    eventually(page, lambda: crosshair(folder) == center)

    path = drawn(page, "paths", name="left")
    half_way = tuple((np.array(path["entry"]) + path["target"]) / 2)
    before = crosshair(folder)
    page.mouse.click(*seen_at(page, "head", half_way))
    eventually(page, lambda: crosshair(folder) != before)
    beside = np.cross(np.array(crosshair(folder)) - cases.ENTRY_MM, cases.plan().trajectory("left").inward)
    assert beside == pytest.approx(np.zeros(3), abs=1e-6)

    before = crosshair(folder)
    page.mouse.click(*seen_at(page, "head", (0.1, 0.4)))

    def cross() -> tuple[float, float]:
        one = drawn(page, "points", label="")
        return one["x"], one["y"]

    eventually(page, lambda: cross() == pytest.approx((0.1, 0.4), abs=0.01) and crosshair(folder) != before)
    outward = np.array(crosshair(folder)) - [0.0, 0.0, 20.0]
    outward /= np.linalg.norm(outward)
    hu = [hu_at(np.array(crosshair(folder)) + step * outward) for step in (-3.0, 3.0)]
    assert hu[0] > -300 > hu[1]
    assert (folder / "plan.json").read_text() == plan


def hu_at(place: np.ndarray) -> float:
    volume = cases.volume()
    k, j, i = np.rint(volume.grid.indices(place)).astype(int)
    return float(volume.voxels_hu[k, j, i])


def test_an_entry_is_clicked_on_the_skin(page: Any, shared: Planner) -> None:
    folder = shared.folder
    page.keyboard.press("a")
    page.wait_for_function("window.trame.state.get('look').adding === 'click the entry'")
    page.mouse.click(*seen_at(page, "head", (0.0, -0.3)))
    page.wait_for_function("window.trame.state.get('look').adding === 'click the target'")
    page.mouse.click(*seen_at(page, "head", (0.0, -0.3)))
    page.wait_for_function("window.trame.state.get('message').includes('inside the head')")
    page.mouse.click(*seen_at(page, "axial", (0.0, 0.1)))
    page.wait_for_selector("text=T1, LPS mm")
    made = read_plan(folder / "plan.json").trajectory("T1")
    assert abs(hu_at(made.entry_mm) + 400) < 700
    assert "lies in air" not in value(page, "chosen")["problem"]
    page.keyboard.press("Control+z")  # other tests expect one
    eventually(page, lambda: len(read_plan(folder / "plan.json").trajectories) == 1)


def test_a_drag_beside_the_ends_turns_the_head(page: Any) -> None:
    before, picture = drawn(page, "markers", label="F2"), value(page, "picture_head")
    x, y = seen_at(page, "head", (-0.8, 0.8))
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y, steps=3)
    page.mouse.up()
    eventually(page, lambda: drawn(page, "markers", label="F2")["x"] != before["x"])
    eventually(page, lambda: value(page, "picture_head") != picture)
