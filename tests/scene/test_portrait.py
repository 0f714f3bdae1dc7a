"""The picture of a head shows its markers where it says they are, whoever draws it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ronnaplan.scene.camera import VIEW_DEG
from ronnaplan.scene.field import Field
from ronnaplan.scene.picture import filled_in, rendered
from ronnaplan.scene.portrait import filling, head_picture
from ronnaplan.scene.shapes import ball, tube
from ronnaplan.scene.things import Thing
from ronnaplan.scene.vtk import NoGraphicsError, Workshop
from tests.scans import balls, scan, small_stack

SHAPE = (200, 260)


def places(shades: np.ndarray, camera: object) -> tuple[float, float]:
    down, across = np.argwhere(shades[..., 3] > 128).mean(axis=0) + 0.5 - np.array(shades.shape[:2]) / 2
    return across / (min(shades.shape[:2]) / 2), down / (min(shades.shape[:2]) / 2)


def test_a_marker_is_drawn_where_the_camera_says_it_is_by_both_hands(workshop: Workshop) -> None:
    things = [Thing("left", ball([8.0, 0.0, 0.0], 5.75), np.array([1.0, 0.2, 0.1]))]
    camera = filling([*things, Thing("right", ball([-9.0, 3.0, 4.0], 6.0), np.ones(3))])
    by_opencv = filled_in(things, camera, SHAPE)
    assert places(by_opencv, camera) == pytest.approx(camera.on_screen(np.array([8.0, 0.0, 0.0]))[:2], abs=0.02)
    try:
        by_vtk = rendered(workshop, things, camera, SHAPE)
    except NoGraphicsError as error:
        pytest.skip(f"no graphics library can be loaded here: {error}")
    assert places(by_vtk, camera) == pytest.approx(places(by_opencv, camera), abs=0.02)
    apart = (by_vtk[..., 3] > 128) != (by_opencv[..., 3] > 128)
    assert apart.mean() < 0.01
    lit = by_vtk[by_vtk[..., 3] > 250][:, :3].mean(axis=0)
    assert lit[0] > 3 * lit[1]  # red stays red


@pytest.mark.usefixtures("shared_workshop")
def test_a_head_is_seen_from_where_its_marker_is_seen_and_without_a_graphics_library(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def without(*_: object) -> None:
        raise NoGraphicsError("none here")

    monkeypatch.setattr("ronnaplan.scene.picture.rendered", without)
    head = scan(balls([(0.0, 0.0, 0.0)], 30.0), small_stack())
    marker = np.array([[18.0, 3.0, 0.0]])  # on the left
    found = head_picture(head, marker, 4.0, SHAPE)
    assert found.seen.tolist() == [True]
    assert found.camera.axes[2, 0] > 0
    assert found.shades.shape == (*SHAPE, 4)
    behind = head_picture(head, np.array([[0.0, 18.0, -8.0]]), 4.0, SHAPE)
    assert behind.seen.tolist() == [False]
    shown = np.argwhere(found.shades[..., 3] > 0)
    assert np.ptp(shown, axis=0).max() > 0.85 * min(SHAPE)  # it fills the picture


def test_all_that_is_shown_lies_in_the_picture() -> None:
    things = [
        Thing("one", ball([100.0, 20.0, -50.0], 60.0), np.ones(3)),
        Thing("two", ball([0, 0, 60], 5.0), np.ones(3)),
    ]
    camera = filling(things)
    at = np.concatenate([camera.on_screen(one.body.vertices_mm.astype(float)) for one in things])
    assert np.abs(at[:, :2]).max() < 1.0
    assert np.abs(at[:, :2]).max() > 0.85
    assert camera.upright_deg((300, 200)) > VIEW_DEG == pytest.approx(camera.upright_deg((200, 300)))


@pytest.mark.usefixtures("shared_workshop")
def test_an_empty_scan_can_be_drawn() -> None:
    empty = scan(balls([(300.0, 0.0, 0.0)]), small_stack())
    assert head_picture(empty, np.empty((0, 3)), 11.5, SHAPE).shades.max() == 0
    assert Field.of(empty).values.max() < -900


def test_a_screen_is_whole_but_for_where_something_lies_behind_it() -> None:
    inside = Thing("inside", ball([0.0, 0.0, 0.0], 3.0), np.array([0.0, 0.0, 1.0]))
    around = Thing("around", ball([0.0, 0.0, 0.0], 10.0), np.ones(3), 0.5, screen=True)
    camera = filling([around])
    shades = filled_in([inside, around], camera, (101, 101)).astype(int)
    alone = filled_in([around], camera, (101, 101)).astype(int)
    assert shades[50, 50, 0] < 0.6 * alone[50, 50, 0]
    assert shades[50, 50, 2] > 100
    assert (shades[50, 75] == alone[50, 75]).all()


def test_many_things_alike_are_drawn_at_once_as_they_look_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan of 300 trajectories has 300 tubes; a picture was copied for each."""
    import cv2

    those = []
    for number in range(6):
        ends_mm = np.array([[14.0 * number, -9.0, 0.0], [14.0 * number, 9.0, 5.0]])
        those.append(Thing(f"path {number}", tube(ends_mm, 1.0), np.eye(3)[number % 3]))
        those.append(Thing(f"tube {number}", tube(ends_mm, 2.5), np.eye(3)[number % 3], 0.3))
    camera, drawn = filling(those), list[int]()
    each = [filled_in(those[n : n + 2], camera, SHAPE, np.zeros(3)) for n in range(0, len(those), 2)]
    rasterize = cv2.triangleRasterize

    def counted(*given: Any) -> Any:
        drawn.append(given[1].shape[1])
        return rasterize(*given)

    monkeypatch.setattr(cv2, "triangleRasterize", counted)
    together = filled_in(those, camera, SHAPE, np.zeros(3))
    assert len(drawn) == 2
    np.testing.assert_array_equal(together, np.max(each, axis=0))  # none stands before another
