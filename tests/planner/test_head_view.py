"""The 3-D view follows the state: what was changed is drawn, what was not is not drawn again."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer

from ronnaplan.planner.cuts import Picture
from ronnaplan.planner.head_view import HeadView, head_routes
from ronnaplan.planner.over_head import over_head
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.regions import Region
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Measures
from ronnaplan.scene.field import Field
from ronnaplan.scene.head import HeadParts
from ronnaplan.scene.shapes import Body
from ronnaplan.scene.surfaces import surfaces
from ronnaplan.scene.vtk import Workshop
from tests import cases
from tests.loops import run

SAME = 1e-4
"""Share of the picture that may differ where things seen through lie on each other."""


@pytest.fixture(scope="module")
def made() -> dict[str, Body]:
    with Workshop() as workshop:
        return surfaces(workshop, Field.of(cases.volume(), 3.0))


@pytest.fixture
def head(state: PlannerState, made: dict[str, Body]) -> HeadView:
    view = HeadView(state)
    view.open(HeadParts(surfaces=made))
    return view


def shown(head: HeadView) -> Picture | None:
    head.state.case.surroundings.judge_all(head.state.case.plan)
    head.update(head.state.case.plan)
    return head.picture()


def pixels(head: HeadView) -> np.ndarray:
    picture = shown(head)
    assert picture is not None
    data = np.frombuffer(picture["bytes"], dtype=np.uint8)
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.int16)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Share of the picture that is not the same."""
    return float((np.abs(a - b).max(axis=2) > 40).mean())


def test_before_it_is_opened_there_is_no_picture(state: PlannerState) -> None:
    view = HeadView(state)
    assert view.picture() is None
    assert over_head(state, view.camera, False, {}, Pane())["title"] == "3-D is being made ready ..."


def test_the_map_of_entries_is_coloured_on_the_scalp_and_goes_with_its_target(head: HeadView) -> None:
    state, plain = head.state, pixels(head)
    state.offers.propose("left")
    mapped = pixels(head)
    assert difference(mapped, plain) > 0.1
    magenta = mapped[..., 2] - mapped[..., 1]
    assert (magenta > 60).mean() > 0.05  # where there was only skin
    state.case.edit("left", target_mm=cases.TARGET_MM + np.array([0.0, 0.0, 2.0]))
    assert difference(pixels(head), plain) < 0.01


def test_proposed_places_and_markers_come_and_go(head: HeadView) -> None:
    state, plain = head.state, pixels(head)
    state.offers.propose_markers(4)
    assert difference(pixels(head), plain) > 0.001
    state.offers.offered.placed = None
    assert difference(pixels(head), plain) < SAME
    state.case.reject_marker("F2")
    assert difference(pixels(head), plain) > 0.001
    state.case.undo()
    assert difference(pixels(head), plain) < SAME


def test_trajectories_are_followed_by_name_and_place(head: HeadView) -> None:
    state, plain = head.state, pixels(head)
    state.case.rename("left", "lead")
    assert difference(pixels(head), plain) < SAME
    state.case.remove("lead")
    without = pixels(head)
    assert difference(without, plain) > 0.0005
    state.case.undo()
    assert difference(pixels(head), plain) < SAME


def test_the_tube_is_that_of_the_markers_as_they_are_now(head: HeadView, monkeypatch: pytest.MonkeyPatch) -> None:
    shown(head)
    drawn_with: list[Measures | None] = []
    assert head.scene is not None
    monkeypatch.setattr(head.scene, "show_path", lambda _, measured: drawn_with.append(measured))
    for number in range(10):
        head.state.case.reject_marker("F2") if number % 2 == 0 else head.state.case.undo()
        shown(head)
        (path,) = head.state.case.plan.trajectories
        now = head.state.case.judge(path).measures
        assert now is not None
        assert now.error is not None
        drawn = drawn_with[number]
        assert drawn is not None
        assert drawn.error is not None
        np.testing.assert_array_equal(drawn.error.tube_mm, now.error.tube_mm)


def test_what_is_not_measured_yet_has_no_tube_and_is_not_measured_to_be_drawn(
    head: HeadView, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where another hand adds hundreds: each page would wait until all are measured."""
    case, drawn = head.state.case, list[tuple[str, bool]]()
    shown(head)
    assert head.scene is not None
    monkeypatch.setattr(
        head.scene, "show_path", lambda one, measured: drawn.append((one.name, measured is not None))
    )
    case.change_plan(case.plan.add(replace(case.plan.trajectory("left"), name="theirs")))
    for _ in range(2):
        head.update(case.plan)
    assert drawn == [("theirs", False)]
    shown(head)
    head.update(case.plan)
    assert drawn == [("theirs", False), ("theirs", True)]


def test_the_contacts_of_an_electrode_are_shown_as_soon_as_it_is_chosen(head: HeadView) -> None:
    plain = pixels(head)
    head.state.case.choose_electrode("left", "Medtronic 3387")
    assert difference(pixels(head), plain) > SAME
    head.state.case.choose_electrode("left", "none")
    assert difference(pixels(head), plain) < SAME


def test_nothing_is_drawn_twice(head: HeadView, monkeypatch: pytest.MonkeyPatch) -> None:
    first = shown(head)
    assert head.scene is not None
    monkeypatch.setattr(head.scene, "draw", lambda: pytest.fail("drawn again"))
    head.state.look.jump(cases.TARGET_MM)
    assert shown(head) == first


def test_names_stand_where_things_are_drawn(head: HeadView) -> None:
    state = head.state
    state.pick_marker("F3")
    state.set_landmark("AC", cases.TARGET_MM)
    state.look.regions = {"vessels": Region("vessels", "#e53935")}
    drawn = over_head(state, head.camera, True, {"vessels": cases.ENTRY_MM}, Pane())
    assert [one["label"] for one in drawn["markers"] if one["ring"]] == ["F3", "x1"]
    assert drawn["title"].startswith("3-D skin; 95 % tubes")
    places = {one["label"]: (one["x"], one["y"]) for one in drawn["points"]}
    (path,) = drawn["paths"]
    assert places["AC"] == pytest.approx(path["target"])
    assert places["vessels"] == pytest.approx(path["entry"])
    picture = pixels(head)
    marker = next(one for one in drawn["markers"] if one["label"] == "F2")
    row, column = (round((marker[axis] + 1) * len(picture) / 2) for axis in ("y", "x"))
    blue, _, red = picture[row, column]
    assert red - blue > 80  # the orange of a marker


def test_the_title_tells_who_draws_and_of_tubes_where_there_are_some(head: HeadView) -> None:
    assert "tubes" in over_head(head.state, head.camera, False, {}, Pane())["title"]
    for marker in [one.label for one in head.state.case.fiducials.fiducials]:  # type: ignore[union-attr]
        head.state.case.reject_marker(marker)
    assert over_head(head.state, head.camera, False, {}, Pane())["title"] == "3-D skin", (
        "no error is expected then"
    )
    head.state.case.remove("left")
    title = over_head(head.state, head.camera, False, {}, Pane(), drawn_here=False)["title"]
    assert title == "3-D skin, drawn by the server"


def test_a_thing_is_sent_once_however_often_one_request_names_it(head: HeadView) -> None:
    """Of one request that named a tube 1,900 times 33 MB were made in 2 s, and no page was answered meanwhile."""
    application = web.Application()
    application.add_routes(head_routes(lambda: [head, head]))
    shown(head)
    assert head.scene is not None
    (key,) = (one["key"] for one in head.scene.listed if one["name"] == "skin")

    async def asked() -> None:
        async with TestClient(TestServer(application)) as client:
            once = await (await client.get(f"/things/{key}")).json()
            assert [one["name"] for one in once.values()] == ["skin"]
            assert await (await client.get(f"/things/{','.join([key] * 1000)},,-1,x")).json() == once

    run(asked())
