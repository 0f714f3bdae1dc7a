"""What is drawn over each cut, as plain values for the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Trajectory
from ronnaplan.scene.cut import Cut
from ronnaplan.scene.things import MARKER_COLOUR, REJECTED_COLOUR

POINT_COLOUR = "#b2ff59"

NEAR_MM = 3.0
"""A trajectory with an end this near to the plane is drawn in full, others faintly."""

TITLES = {"inline": "in line with {}", "probe": "probe's eye, {:.1f} mm deep"}
LEFT_RIGHT = {"axial": "axial  R | L", "coronal": "coronal  R | L", "sagittal": "sagittal  A | P"}


def over_cut(state: PlannerState, view: str, show_rejected: bool) -> dict[str, Any]:
    """Return what is drawn over a view, in mm from its middle; empty for a path view without a trajectory."""
    if view not in LEFT_RIGHT and state.look.chosen is None:
        return {
            "box": "-1 -1 2 2",
            "half": 1,
            "title": "select a trajectory",
            "markers": [],
            "points": [],
            "paths": [],
        }
    cut = state.look.cut(view)
    half = cut.field_mm / 2
    return {
        "box": f"{-half} {-half} {2 * half} {2 * half}",
        "half": half,
        "title": _title(state, view, cut),
        "cross": _pair(cut, state.look.crosshair_mm) if view in LEFT_RIGHT else None,
        "markers": _markers(state, cut, show_rejected),
        "points": _points(state, cut),
        "paths": [_path(one, cut, one.name == state.look.selected) for one in state.case.plan.trajectories],
    }


def _title(state: PlannerState, view: str, cut: Cut) -> str:
    if view in LEFT_RIGHT:
        return f"{LEFT_RIGHT[view]}   {state.look.crosshair_mm @ np.abs(cut.away):.1f} mm"
    assert state.look.chosen is not None
    depth = float((cut.center_mm - state.look.chosen.entry_mm) @ state.look.chosen.inward)
    return TITLES[view].format(state.look.chosen.name if view == "inline" else depth)


def balls(state: PlannerState, show_rejected: bool) -> list[tuple[str, tuple[float, float, float], float, str]]:
    """Return label, center and radius (mm), and colour of each marker, and of what was rejected where it is shown."""
    found = state.case.fiducials
    if found is None:
        return []
    shown = [(one.label, one.center, one.diameter_mm / 2, MARKER_COLOUR) for one in found.fiducials]
    if show_rejected:
        radius = found.marker.diameter_mm / 2
        shown += [(f"x{n + 1}", one.center, radius, REJECTED_COLOUR) for n, one in enumerate(found.rejected)]
    return shown


def _markers(state: PlannerState, cut: Cut, show_rejected: bool) -> list[dict[str, Any]]:
    """Return the circles that the plane cuts out of the markers."""
    drawn = []
    for label, center, radius, colour in balls(state, show_rejected):
        x, y, away = cut.on_screen_mm(np.array(center))
        if abs(away) < radius and max(abs(x), abs(y)) < cut.field_mm / 2:
            r = float(np.sqrt(radius**2 - away**2))
            selected = label == state.look.marker
            drawn.append(
                {"label": label, "x": float(x), "y": float(y), "r": r, "colour": colour}
                | {"selected": selected, "ring": True}
            )
    return drawn


def _points(state: PlannerState, cut: Cut) -> list[dict[str, Any]]:
    """Return the points of the AC-PC frame that lie in the plane."""
    drawn = []
    for name, place in state.landmarks_mm.items():
        x, y, away = cut.on_screen_mm(place).tolist()
        if abs(away) < NEAR_MM and max(abs(x), abs(y)) < cut.field_mm / 2:
            drawn.append({"label": name, "x": x, "y": y, "colour": POINT_COLOUR})
    return drawn


def _path(one: Trajectory, cut: Cut, selected: bool) -> dict[str, Any]:
    ends = cut.on_screen_mm(np.stack([one.entry_mm, one.target_mm]))
    near = bool(np.abs(ends[:, 2]).min() < NEAR_MM or ends[0, 2] * ends[1, 2] < 0)
    places = {"entry": ends[0, :2].tolist(), "target": ends[1, :2].tolist()}
    look = {"selected": selected, "near": near, "width": 2.5 if selected else 1.5}
    return {"name": one.name, "colour": one.colour, **look, **places}


def _pair(cut: Cut, place_mm: FloatArray) -> list[float]:
    pair: list[float] = cut.on_screen_mm(place_mm)[:2].tolist()
    return pair
