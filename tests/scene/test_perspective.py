"""Where places appear in the 3-D view is where they are drawn, and a plane parallel to it is what is dragged in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ronnaplan.scene.camera import Camera
from ronnaplan.scene.shapes import ball

EYE = Camera(np.array([-280.0, -217.0, 200.0]), np.array([4.0, -3.0, 28.0]))
NUMBERS = st.floats(-0.9, 0.9)


@settings(max_examples=50)
@given(NUMBERS, NUMBERS, st.floats(50.0, 900.0))
def test_a_ray_passes_through_what_is_seen_under_its_pixel(across: float, down: float, reach_mm: float) -> None:
    place = EYE.position_mm + reach_mm * EYE.ray(across, down)[1]
    assert EYE.on_screen(place)[:2] == pytest.approx([across, down], abs=1e-9)


@settings(max_examples=50)
@given(NUMBERS, NUMBERS, st.floats(50.0, 900.0))
def test_the_plane_at_a_place_is_as_large_as_the_picture(across: float, down: float, reach_mm: float) -> None:
    place = EYE.position_mm + reach_mm * EYE.ray(across, down)[1]
    plane = EYE.plane_at(place)
    assert plane.on_screen_mm(place) / (plane.field_mm / 2) == pytest.approx([across, down, 0.0], abs=1e-9)


@pytest.mark.parametrize("place", [(4.0, -3.0, 28.0), (60.0, 10.0, 90.0), (-40.0, 70.0, -30.0)])
def test_places_appear_where_they_are_drawn(place: tuple[float, float, float]) -> None:
    pixels = 400
    picture = np.zeros((pixels, pixels, 3), dtype=np.float32)
    EYE.draw(ball(np.array(place), 4.0), np.ones(3), picture, EYE.depths((pixels, pixels)))
    rows, columns = np.nonzero(picture.max(axis=2) > 0)
    middle = np.array([columns.min() + columns.max(), rows.min() + rows.max()]) / 2
    expected = (EYE.on_screen(np.array(place))[:2] + 1) * pixels / 2
    assert middle == pytest.approx(expected, abs=1.5)
