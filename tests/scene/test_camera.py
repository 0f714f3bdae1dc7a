"""The eye of the 3-D view: what is nearer hides what is behind it, and turning keeps it about the head."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.scene.camera import Camera
from ronnaplan.scene.shapes import Body, ball

PIXELS = 100
EYE = Camera(np.array([0.0, -400.0, 0.0]), np.zeros(3))
RED, GREEN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize("turned", [False, True])
def test_the_nearer_ball_hides_the_other_whichever_is_drawn_first(turned: bool) -> None:
    picture, depths = np.zeros((PIXELS, PIXELS, 3), dtype=np.float32), EYE.depths((PIXELS, PIXELS))
    balls = [(ball([0.0, -50.0, 0.0], 10.0), RED), (ball([0.0, 50.0, 0.0], 30.0), GREEN)]
    for body, colour in balls[:: -1 if turned else 1]:
        EYE.draw(body, colour, picture, depths)
    blue, green, red = picture[PIXELS // 2, PIXELS // 2]
    assert red > 0.3
    assert blue == green == 0.0
    assert picture[PIXELS // 2, PIXELS // 2 + 8, 1] > 0.3  # beside the near one the far one is seen
    assert depths[PIXELS // 2, PIXELS // 2] == pytest.approx(340.0, abs=0.5)


def test_turning_keeps_the_distance_and_never_goes_over_the_top() -> None:
    for up in (30.0, 200.0, -500.0):
        eye = EYE.turned(40.0, up)
        assert np.linalg.norm(eye.position_mm - eye.focus_mm) == pytest.approx(400.0)
        assert 0 < np.sign(up) * eye.axes[2, 2] < 0.99
        assert eye.axes[1, 2] > 0  # superior stays up
        assert eye.axes @ eye.axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert EYE.turned(90.0, 0.0).position_mm == pytest.approx([400.0, 0.0, 0.0])


def test_coming_nearer_keeps_the_direction() -> None:
    assert EYE.nearer(2.0).position_mm == pytest.approx([0.0, -200.0, 0.0])


@pytest.mark.parametrize(
    "corners",
    [
        [[-2000.0, -2000, -100], [2000, -2000, -100], [0, 3900, -100]],  # two of them behind the eye
        [[2000.0, 3000, -100], [-2000, 3000, -100], [0, -2000, -100]],  # one
    ],
)
def test_of_a_floor_that_reaches_behind_the_eye_the_part_before_it_is_drawn(corners: list[list[float]]) -> None:
    floor = Body.of(np.array(corners), np.array([[0, 1, 2]]))
    eye = Camera(np.zeros(3), np.array([0.0, 100.0, 0.0]))
    picture, depths = np.zeros((90, 90, 3), dtype=np.float32), eye.depths((90, 90))
    eye.draw(floor, np.array([1.0, 0.5, 0.0]), picture, depths)
    assert not picture[:45].any()
    np.testing.assert_allclose(picture[60:, 40:50], picture[80, 45] * np.ones((30, 10, 3)), atol=1e-3)
    assert picture[80, 45, 0] == pytest.approx(2 * picture[80, 45, 1])
    assert 0.3 < picture[80, 45, 0] <= 1.0
    down = (80.5 - 45) / 45 * np.tan(np.radians(15))
    assert depths[80, 45] == pytest.approx(100 / down, rel=0.01)


def test_nothing_is_drawn_of_what_lies_behind_the_eye() -> None:
    eye = Camera(np.zeros(3), np.array([0.0, 100.0, 0.0]))
    picture, depths = np.zeros((90, 90, 3), dtype=np.float32), eye.depths((90, 90))
    eye.draw(ball(np.array([0.0, -300.0, 20.0]), 60.0), np.ones(3), picture, depths)
    assert not picture.any()


def test_a_whole_room_is_seen_from_far_enough_away() -> None:
    far = Camera(np.array([0.0, -8000.0, 0.0]), np.zeros(3))
    picture, depths = np.zeros((90, 90, 3), dtype=np.float32), far.depths((90, 90))
    far.draw(ball(np.zeros(3), 500.0), np.ones(3), picture, depths)
    assert picture[45, 45].all()
    assert depths[45, 45] == pytest.approx(7500.0, abs=10.0)
