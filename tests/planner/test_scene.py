"""The 3-D view shows the head where it is, without a screen."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from ronnaplan.planner.scene import Scene
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.scene.shapes import ball
from tests import cases


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
    scene.show_markers()
    marked = drawn(scene)
    assert np.abs(marked - skull).max() > 50
    scene.turn(60, 10)
    assert np.abs(drawn(scene) - marked).max() > 50
    before = drawn(scene)
    scene.show_region("metal", ball(scene.camera.focus_mm, 70.0))
    assert np.abs(drawn(scene) - before).max() > 50
    scene.zoom(1.2)
    assert drawn(scene, (300, 500)).shape == (300, 500, 3)
