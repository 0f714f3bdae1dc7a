"""What the page needs to draw the 3-D view itself: the eye, and the corner of the head that is taken away."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.cuts import STANDARD
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.state import PlannerState
from ronnaplan.scene.camera import Camera

SIDES: Final = {
    "L": (1.0, 0.0, 0.0),
    "R": (-1.0, 0.0, 0.0),
    "P": (0.0, 1.0, 0.0),
    "A": (0.0, -1.0, 0.0),
    "S": (0.0, 0.17, 0.98),
    "I": (0.0, 0.17, -0.98),
}
"""Faces of the cube in the corner, and from where one then looks, LPS; never from straight above or below."""


def seen_from(
    state: PlannerState, camera: Camera | None, panes: dict[str, Pane], reach_mm: float
) -> dict[str, Any]:
    """Return eye, cube and opening as the page takes them, in LPS mm; empty until there is a camera.

    What lies no further than ``reach_mm`` from what is looked at, or than the scan is large, is drawn.
    """
    if camera is None:
        return {}
    low, high = state.look.bounds_mm
    eye = {
        "position": camera.position_mm.tolist(),
        "axes": camera.axes.ravel().tolist(),
        "away": float(np.linalg.norm(camera.position_mm - camera.focus_mm)),
        "reach": max(reach_mm, float(np.linalg.norm(high - low))),
        "cube": cube(camera.axes),
        "corner": None,
        "way": [1.0, 1.0, 1.0],
        "planes": [],
    }
    if not state.look.opened:
        return eye
    way = state.look.opened_towards(camera.position_mm)
    shown = STANDARD if state.look.opened == "corner" else (state.look.opened,)
    planes = [_plane(state, view, panes[view]) for view in shown]
    return {**eye, "corner": state.look.crosshair_mm.tolist(), "way": way.tolist(), "planes": planes}


def cube(axes: FloatArray) -> str:
    """Return how CSS turns a cube that stands in LPS so that it is seen as the head is; ``axes`` (3, 3) of `Camera`."""
    right, up, back = axes
    columns = np.stack([right, -up, back])  # CSS counts downwards
    numbers = [*(value for n in range(3) for value in (*columns[:, n], 0.0)), 0.0, 0.0, 0.0, 1.0]
    return f"matrix3d({', '.join(f'{value:.5f}' for value in numbers)})"


def _plane(state: PlannerState, view: str, pane: Pane) -> dict[str, Any]:
    """Return where the picture of a cut lies: its middle, and from there to its right and lower edges."""
    cut = state.look.cut(view)
    wide, high = (cut.field_mm / 2 * share for share in pane.halves)
    return {
        "view": view,
        "middle": cut.center_mm.tolist(),
        "right": (wide * cut.right).tolist(),
        "down": (high * cut.down).tolist(),
        "across": np.abs(cut.away).tolist(),
    }
