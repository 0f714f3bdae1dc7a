"""The 3-D view shows the head where it is, without a screen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ronnaplan.documents.reading import to_json
from ronnaplan.errors import InputError
from ronnaplan.planner.opening import cube
from ronnaplan.planner.panels import robot_doubts
from ronnaplan.planner.regions import Region
from ronnaplan.planner.scene import Scene
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.planner.tab import Tab
from ronnaplan.planning.electrodes import ELECTRODES
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.shapes import ball
from tests import cases
from tests.documents.placements import placed


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    cases.write_case(tmp_path)
    return Scene(PlannerState(cases.volume(), Storage.of(str(tmp_path / "plan.json"), None, None)))


def drawn(scene: Scene, shape: tuple[int, int] = (320, 320)) -> np.ndarray:
    return np.asarray(
        cv2.imdecode(np.frombuffer(scene.draw(shape), dtype=np.uint8), cv2.IMREAD_COLOR), dtype=np.int16
    )


def test_each_thing_shown_changes_the_picture_and_can_be_taken_away(scene: Scene) -> None:
    empty = drawn(scene)
    scene.show_surface("skull", ball(scene.camera.focus_mm, 60.0))
    skull = drawn(scene)
    assert np.abs(skull - empty).max() > 50
    path = scene.state.case.plan.trajectory("left")
    scene.show_path(path, scene.state.case.judge(path).measures)
    assert np.abs(drawn(scene) - skull).max() > 50
    scene.hide_path("left")
    assert np.abs(drawn(scene) - skull).max() < 10
    scene.show_path(replace(path, electrode=ELECTRODES["Medtronic 3387"]), None)
    assert "contacts left" in [one["name"] for one in scene.listed]
    scene.hide_path("left")
    assert "contacts left" not in [one["name"] for one in scene.listed]
    scene.show_markers()
    marked = drawn(scene)
    assert np.abs(marked - skull).max() > 50
    scene.turn(60, 10)
    assert np.abs(drawn(scene) - marked).max() > 50
    before = drawn(scene)
    metal = Region("metal", "#e53935")
    scene.show_regions({"metal": metal}, {"metal": ball(scene.camera.focus_mm, 70.0)})
    assert np.abs(drawn(scene) - before).max() > 50
    scene.zoom(1.2)
    assert drawn(scene, (300, 500)).shape == (300, 500, 3)


def test_what_changed_gets_another_key_and_what_went_is_no_longer_there(scene: Scene) -> None:
    scene.show_markers()
    path = scene.state.case.plan.trajectory("left")
    scene.show_path(path, None)
    before = {one["name"]: one["key"] for one in scene.listed}
    scene.show_path(path, None)
    after = {one["name"]: one["key"] for one in scene.listed}
    assert {name for name in after if after[name] != before[name]} == {"path left"}
    assert scene.thing(before["path left"]) is None
    shown = scene.thing(after["path left"])
    assert shown is not None
    assert shown.name == "path left"


def test_the_cube_of_the_corner_is_seen_as_the_head_is() -> None:
    camera = Camera(np.array([0.0, -400.0, 0.0]), np.zeros(3))  # from in front: the patient's left is on the right
    numbers = [float(number) for number in cube(camera.axes)[len("matrix3d(") : -1].split(",")]
    turned = np.array(numbers).reshape(4, 4).T[:3, :3]  # CSS writes columns, and counts downwards, towards the eye
    assert turned @ [1, 0, 0] == pytest.approx([1, 0, 0])
    assert turned @ [0, 0, 1] == pytest.approx([0, -1, 0])
    assert turned @ [0, -1, 0] == pytest.approx([0, 0, 1])


def test_only_what_is_left_of_an_opened_head_is_picked(scene: Scene) -> None:
    look = scene.state.look
    look.jump([4.0, -3.0, 28.0])
    eye = np.array([-300.0, -320.0, 330.0])
    behind = look.crosshair_mm + np.array([3.0, 4.0, -2.0])
    ray = (behind - eye) / np.linalg.norm(behind - eye)
    whole = look.surface_along(eye, ray)
    look.open_head("corner")
    opened = look.surface_along(eye, ray)
    assert whole is not None
    assert opened is not None
    assert ((whole - look.crosshair_mm) * [-1, -1, 1] > 20).all()
    assert np.abs(opened - look.crosshair_mm).max() < 6
    assert ((opened - look.crosshair_mm) * [-1, -1, 1]).min() == pytest.approx(0.0, abs=0.5)


def test_what_the_robot_s_place_does_not_hold_for_is_told(tmp_path: Path) -> None:
    cases.write_case(tmp_path)
    (tmp_path / "placement.json").write_text(to_json(placed()))
    state = PlannerState(cases.volume(), Storage.of(str(tmp_path / "plan.json"), None, None))
    tab = Tab(state)
    tab.refresh()
    as_placed = tab.shown["robot"]
    assert not any("trajectory" in one for one in as_placed)
    state.case.edit("left", target_mm=cases.TARGET_MM + 1.0)
    tab.refresh()
    assert tab.shown["robot"] == [
        *as_placed,
        "nothing says that the robot's place serves trajectory left as it is now; run 'robot place' again",
    ]
    blocked = placed(robot_from_ct=(), status="blocked", blocked=("joint 5 is beyond its limit",))
    (tmp_path / "placement.json").write_text(to_json(blocked))
    state.case.look_again()
    tab.refresh()
    assert tab.shown["robot"] == ["no place of the robot serves all: joint 5 is beyond its limit"]
    (tmp_path / "placement.json").unlink()
    assert robot_doubts(PlannerState(cases.volume(), state.storage)) == []


def test_the_robot_is_shown_where_its_placement_lies_beside_the_plan(tmp_path: Path) -> None:
    cases.write_case(tmp_path)
    state = PlannerState(cases.volume(), Storage.of(str(tmp_path / "plan.json"), None, None))
    assert state.case.placement is None
    for written in (placed(), placed().model_copy(update={"arm": "another arm"})):
        (tmp_path / "placement.json").write_text(to_json(written))
        assert state.case.look_again(), "what another hand placed is shown in a planner that is open"
        assert state.case.placement == written
    (tmp_path / "placement.json").write_text("{")
    with pytest.raises(InputError, match=r"placement\.json is not a JSON document"):
        state.case.look_again()
    scene = Scene(state)
    scene.show_robot(state.case.placement)
    assert {"robot", "robot room"} <= {one["name"] for one in scene.listed}
    scene.show_robot(None)
    assert not scene.listed
    assert "placement.json" not in state.storage.readings()
