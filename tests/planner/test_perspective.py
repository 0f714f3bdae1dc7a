"""The 3-D view's geometry agrees with VTK's camera, and a plane parallel to its screen is what is dragged in."""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ronnaplan.planner.perspective import Eye

EYE = Eye.looking_at(
    np.array([-280.0, -217.0, 200.0]), np.array([4.0, -3.0, 28.0]), np.array([0.0, 0.0, 1.0]), 30.0
)
NUMBERS = st.floats(-0.9, 0.9)


@settings(max_examples=50, deadline=None)
@given(NUMBERS, NUMBERS, st.floats(50.0, 900.0))
def test_a_ray_passes_through_what_is_seen_under_its_pixel(across: float, down: float, reach_mm: float) -> None:
    place = EYE.position_mm + reach_mm * EYE.ray(across, down)
    assert EYE.on_screen(place)[:2] == pytest.approx([across, down], abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(NUMBERS, NUMBERS, st.floats(50.0, 900.0))
def test_the_plane_at_a_place_is_as_large_as_the_picture(across: float, down: float, reach_mm: float) -> None:
    place = EYE.position_mm + reach_mm * EYE.ray(across, down)
    plane = EYE.plane_at(place)
    assert plane.on_screen_mm(place) / (plane.field_mm / 2) == pytest.approx([across, down, 0.0], abs=1e-9)


def test_places_appear_where_vtk_draws_them() -> None:
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    from vtkmodules.vtkRenderingCore import vtkCamera

    camera = vtkCamera()
    camera.SetPosition(EYE.position_mm)
    camera.SetFocalPoint(4.0, -3.0, 28.0)
    camera.SetViewUp(0.0, 0.0, 1.0)
    camera.SetViewAngle(30.0)
    matrix = camera.GetCompositeProjectionTransformMatrix(1.0, -1.0, 1.0)
    projection = np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])
    for place in ([4.0, -3.0, 28.0], [60.0, 10.0, 90.0], [-40.0, 70.0, -30.0]):
        seen = projection @ [*place, 1.0]
        expected = [seen[0] / seen[3], -seen[1] / seen[3]]
        assert EYE.on_screen(np.array(place))[:2] == pytest.approx(expected, abs=1e-9)
