"""The picture of a head shows its markers where it says they are."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.scene.head import PIXELS, head_picture
from tests.scans import balls, scan, small_stack


def test_a_marker_is_drawn_where_the_camera_says_it_is() -> None:
    center = np.array([[3.0, -4.0, 2.0]])
    picture, camera = head_picture(scan(balls([(3.0, -4.0, 2.0)]), small_stack()), center, 11.5)
    lit = np.argwhere(picture.sum(axis=-1) > 0)
    down, across = (lit.mean(axis=0) + 0.5) / (PIXELS / 2) - 1.0
    assert [across, down] == pytest.approx(camera.on_screen(center)[0, :2], abs=0.01)


def test_an_empty_scan_can_be_drawn() -> None:
    picture, _ = head_picture(scan(balls([(300.0, 0.0, 0.0)]), small_stack()), np.empty((0, 3)), 11.5)
    assert picture.max() == 0.0
