"""What is drawn over each cut, as plain values for the page."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.cuts import ACROSS
from ronnaplan.planner.measuring import BESIDE_HALVES, drawn_rulers
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.paths_in_cut import NEAR_MM, paths_in_cut
from ronnaplan.planner.state import PlannerState
from ronnaplan.scene.cut import Cut, letters
from ronnaplan.scene.things import MARKER_COLOUR, PROPOSED_COLOUR, REJECTED_COLOUR, TOOL_COLOUR
from ronnaplan.text import isolated

POINT_COLOUR, BEGUN_COLOUR = "#b2ff59", "#ffffff"

ALONG_SLICES, ON_SLICE, WIDE_GAP = 0.9, 0.05, 1.5
"""A cut whose normal has this share of the slices' lies along them; so near to one, in gaps, it shows that one; a gap
so many times the usual one lacks slices."""

TITLES = {
    "inline": "in line with {}",
    "second": "in line with {}, at right angles",
    "probe": "{:.1f} mm {} target, {:.1f} deep: probe's eye",
}
STANDARD_NAMES = ("axial", "coronal", "sagittal")

SCALES_MM = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
LONGEST_SCALE = 0.3
"""The scale bar is the longest of those that fill no more than this share of the shorter side."""


NOTHING: Final[dict[str, Any]] = {
    "letters": [],
    "scale": None,
    "cross": None,
    "markers": [],
    "points": [],
    "paths": [],
    "rulers": [],
    "regions": [],
}
"""All that is drawn over a view but its frame and title, where there is none of it."""


def over_cut(state: PlannerState, view: str, show_rejected: bool, pane: Pane) -> dict[str, Any]:
    """Return what is drawn over a view, in mm from its middle; empty for a path view without a trajectory."""
    if view not in STANDARD_NAMES and state.look.chosen is None:
        title = "select a trajectory" if state.case.plan.trajectories else "no trajectory yet: add one (A)"
        return {**NOTHING, **frame(1, 1, 1), **titled(title, pane)}
    cut = state.look.cut(view)
    half = cut.field_mm / 2
    wide, high = (half * share for share in pane.halves)
    chosen = state.look.chosen.name if state.look.chosen else ""
    title = _title(state, view, cut, pane.room(1.0).shortened(chosen))
    paths = paths_in_cut(state.case.plan.trajectories, cut, pane, state.look.selected)
    names = pane.names(half, title, (tick for one in paths for tick in one["ticks"] if tick["label"]))
    points = [one | {"r": half * BESIDE_HALVES} for one in _points(state, cut, (wide, high))]
    return {
        **frame(half, wide, high),
        "letters": [letters(way) for way in (-cut.right, cut.right, -cut.down, cut.down)],
        "scale": max((mm for mm in SCALES_MM if mm <= LONGEST_SCALE * cut.field_mm), default=SCALES_MM[0]),
        **titled(title, pane, spoken=_title(state, view, cut, chosen)),
        "cross": _pair(cut, state.look.crosshair_mm) if view in STANDARD_NAMES else None,
        **names.of_all(paths, _markers(state, cut, show_rejected, (wide, high)), points),
        "regions": [
            {**one, "colour": shown.colour}
            for one in state.outlines.drawn(view, cut, pane)
            if (shown := state.look.regions[one["name"]]).opacity
        ],
        "rulers": drawn_rulers(
            state,
            lambda points: cut.on_screen_mm(points)[:, :2],
            lambda points: bool((np.abs(cut.on_screen_mm(points)[:, 2]) < NEAR_MM).all()),
            names,
            half,
        ),
    }


def frame(half: float, wide: float, high: float) -> dict[str, Any]:
    """Return the part of the plane that a view shows: half its shorter side, its width and its height, and its box."""
    return {"box": f"{-wide} {-high} {2 * wide} {2 * high}", "half": half, "wide": wide, "high": high}


def titled(title: str, pane: Pane, spoken: str = "") -> dict[str, Any]:
    """Return a view's title, how many lines it takes, and how it is ``spoken`` where a long name is not shortened."""
    return {"title": title, "title_lines": pane.title_lines(title), "spoken": spoken or title}


def _title(state: PlannerState, view: str, cut: Cut, name: str) -> str:
    if view in STANDARD_NAMES:
        return f"{view}  {_level(float(state.look.crosshair_mm @ cut.away), cut)}{_missing(state, cut)}"
    path = state.look.chosen
    assert path is not None
    if view != ACROSS:
        return TITLES[view].format(isolated(name))
    left = round(float((path.target_mm - cut.center_mm) @ path.inward), 1)
    deep = round(float((cut.center_mm - path.entry_mm) @ path.inward), 1)
    # marks of the cuts beside it count from the target; this cut stays while an end is dragged, which may pass it
    return TITLES[view].format(abs(left), "past" if left < 0.0 else "to", deep + 0.0)


def _level(away_mm: float, cut: Cut) -> str:
    """Return where a cut lies, by its side of the scan's origin: a sign is another side to those who think in RAS."""
    side = letters(cut.away * np.sign(away_mm)) if round(away_mm, 1) else ""
    return f"{side} {abs(away_mm):.1f} mm".lstrip()


def _missing(state: PlannerState, cut: Cut) -> str:
    """Return what a cut along the slices is made of where slices are missing: it shows what was not measured there."""
    grid = state.case.volume.grid
    if abs(cut.away @ grid.normal) < ALONG_SLICES:
        return ""
    k = float(grid.indices(state.look.crosshair_mm[np.newaxis])[0, 0])
    below = min(max(math.floor(k), 0), len(grid.spacings_mm) - 1)
    gap_mm = float(grid.spacings_mm[below])
    between = ON_SLICE < k - below < 1.0 - ON_SLICE
    return f", gap {gap_mm:.1f} mm" if between and gap_mm > WIDE_GAP * grid.typical_gap_mm else ""


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


def _markers(
    state: PlannerState, cut: Cut, show_rejected: bool, reach_mm: tuple[float, float]
) -> list[dict[str, Any]]:
    """Return the circles that the plane cuts out of the markers."""
    drawn = []
    for label, center, radius, colour in balls(state, show_rejected):
        x, y, away = cut.on_screen_mm(np.array(center))
        if abs(away) < radius and _is_within(x, y, reach_mm):
            r = float(np.sqrt(radius**2 - away**2))
            selected = label == state.look.marker
            drawn.append(
                {"label": label, "x": float(x), "y": float(y), "r": r, "colour": colour}
                | {"selected": selected, "ring": True}
            )
    return drawn


def _points(state: PlannerState, cut: Cut, reach_mm: tuple[float, float]) -> list[dict[str, Any]]:
    """Return points of the AC-PC frame and proposed entries in the plane, tips of tools, and the first click."""
    drawn = _in_plane(state.landmarks_mm.items(), POINT_COLOUR, cut, reach_mm)
    if state.look.begun_mm is not None:
        x, y, _ = cut.on_screen_mm(state.look.begun_mm).tolist()
        drawn.append({"label": "entry", "x": x, "y": y, "colour": BEGUN_COLOUR})
    for one in state.following.seen:
        x, y, away = cut.on_screen_mm(one.tip_mm).tolist()
        far = "" if abs(away) < NEAR_MM else f" {away:+.0f} mm"
        if _is_within(x, y, reach_mm):
            drawn.append({"label": f"{one.name}{far}", "x": x, "y": y, "colour": TOOL_COLOUR})
    return drawn + _in_plane(proposed(state), PROPOSED_COLOUR, cut, reach_mm)


def _in_plane(
    named: Iterable[tuple[str, FloatArray]], colour: str, cut: Cut, reach_mm: tuple[float, float]
) -> list[dict[str, Any]]:
    """Return those of the ``named`` places (3,), LPS mm, that lie near the plane and in the picture."""
    drawn = []
    for name, place_mm in named:
        x, y, away = cut.on_screen_mm(place_mm).tolist()
        if abs(away) < NEAR_MM and _is_within(x, y, reach_mm):
            drawn.append({"label": name, "x": x, "y": y, "colour": colour})
    return drawn


def _is_within(x: float, y: float, reach_mm: tuple[float, float]) -> bool:
    """Whether a place of the plane is in the picture, whose half width and height are ``reach_mm``."""
    return abs(x) < reach_mm[0] and abs(y) < reach_mm[1]


def proposed(state: PlannerState) -> list[tuple[str, FloatArray]]:
    """Return number and entry (3,) of each path that is proposed."""
    found = state.offers.proposals
    return [(f"{n}", one.trajectory.entry_mm) for n, one in enumerate(found.best if found else (), start=1)]


def _pair(cut: Cut, place_mm: FloatArray) -> list[float]:
    pair: list[float] = cut.on_screen_mm(place_mm)[:2].tolist()
    return pair
