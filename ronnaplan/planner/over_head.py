"""What is drawn over the 3-D picture at once, while the picture itself follows: names, ends and points."""

from __future__ import annotations

from typing import Any

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.measuring import BESIDE_HALVES, drawn_rulers
from ronnaplan.planner.over_cut import BEGUN_COLOUR, NOTHING, POINT_COLOUR, balls, frame, proposed, titled
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning.trajectory import ends_mm
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.names import Names
from ronnaplan.scene.things import PROPOSED_COLOUR, REJECTED_COLOUR, TOOL_COLOUR, spread_factor, spread_name

CROSS_COLOUR = "#4fc3f7"

LEAST_DEPTH_MM = 1.0
"""What is nearer to the eye than this, or behind it, is not drawn."""


def over_head(
    state: PlannerState,
    camera: Camera | None,
    show_rejected: bool,
    region_places_mm: dict[str, FloatArray],
    pane: Pane,
    wanting: str = "",
    *,
    drawn_here: bool = True,
) -> dict[str, Any]:
    """Return what is drawn over the 3-D view, in halves of its picture; ``camera`` is None until it is ready.

    ``wanting`` says why there are no surfaces, where there are none; ``drawn_here`` is whether the browser draws it;
    regions are named at ``region_places_mm`` (3,), LPS mm.
    """
    wide, high = pane.halves
    drawn = {**NOTHING, **frame(1, wide, high)}
    if camera is None:
        return {**drawn, **titled("3-D is being made ready ...", pane)}
    points = [_point(camera, name, place, POINT_COLOUR) for name, place in state.landmarks_mm.items()]
    points += [
        _point(camera, name, place, state.look.regions[name].colour)
        for name, place in region_places_mm.items()
        if state.look.regions[name].opacity
    ]
    points += [_point(camera, label, entry, PROPOSED_COLOUR) for label, entry in proposed(state)]
    points += [_point(camera, one.name, one.tip_mm, TOOL_COLOUR) for one in state.following.seen]
    title = wanting or _title(state, drawn_here=drawn_here)
    names = Names(pane.room(1.0, title))
    paths = _paths(camera, state)
    points.append(_point(camera, "", state.look.crosshair_mm, CROSS_COLOUR))
    if state.look.begun_mm is not None:
        points.append(_point(camera, "entry", state.look.begun_mm, BEGUN_COLOUR))
    return {
        **drawn,
        **titled(title, pane),
        **names.of_all(paths, _markers(state, camera, show_rejected), [one for one in points if one is not None]),
        "rulers": drawn_rulers(
            state, lambda points: camera.on_screen(points)[:, :2], lambda _: True, names, drawn["half"]
        ),
    }


def _title(state: PlannerState, *, drawn_here: bool) -> str:
    """Return what the head is drawn as, and by whom, and what tubes and the ellipsoid of the selected marker are."""
    title = f"3-D {state.look.preset or state.look.surface}"
    if not drawn_here:
        title += ", drawn by the server"  # where the whole scan and the opened head are not to be had
    if state.case.plan.trajectories and state.case.surroundings.expected.counted is not None:
        title += "; 95 % tubes"
    found = state.case.fiducials.fiducials if state.case.fiducials else ()
    for one in found:
        if one.label == state.look.marker:
            factor = spread_factor(np.array(one.covariance)[np.newaxis], one.diameter_mm)
            title += f"; {spread_name(one.label, factor)}"
    return title


def _markers(state: PlannerState, camera: Camera, show_rejected: bool) -> list[dict[str, Any]]:
    drawn = []
    for label, center, radius, colour in balls(state, show_rejected):
        x, y, depth = camera.on_screen(np.array(center)).tolist()
        if depth < LEAST_DEPTH_MM:
            continue
        selected = label == state.look.marker
        ring = selected or colour == REJECTED_COLOUR
        r = 2 * radius / camera.plane_at(np.array(center)).field_mm
        drawn.append(
            {"label": label, "x": x, "y": y, "r": r, "colour": colour, "selected": selected, "ring": ring}
        )
    return drawn


def _point(camera: Camera, name: str, place_mm: FloatArray, colour: str) -> dict[str, Any] | None:
    x, y, depth = camera.on_screen(place_mm).tolist()
    if depth < LEAST_DEPTH_MM:
        return None
    return {"label": name, "x": x, "y": y, "r": BESIDE_HALVES, "colour": colour}


def _paths(camera: Camera, state: PlannerState) -> list[dict[str, Any]]:
    """Return the ends of each trajectory, with a thin line: it and its tube are in the picture."""
    those = state.case.plan.trajectories
    seen = camera.on_screen(ends_mm(those))  # of all at once: a plan may hold hundreds
    before = seen[..., 2] >= LEAST_DEPTH_MM
    return [
        {
            "name": one.name,
            "colour": one.colour,
            "near": near,
            "selected": one.name == state.look.selected,
            "width": 1,
            "thick": 0,
            "ticks": [],
            "contacts": [],
            "entry": both[0],
            "target": both[1],
            "part": both if all(near) else [],
        }
        for one, both, near in zip(those, seen[..., :2].tolist(), before.tolist(), strict=True)
    ]
