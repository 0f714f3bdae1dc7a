"""Trajectories as a cut shows them, as plain values for the page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ronnaplan.planner.panes import Pane
from ronnaplan.planning import Trajectory
from ronnaplan.planning.contacts import contact_ends_mm
from ronnaplan.planning.trajectory import ends_mm
from ronnaplan.scene.cut import Cut

NEAR_MM = 3.0
"""What of a trajectory lies this near to the plane is drawn in full, the rest faintly and dashed."""

TICK_MM, TICK_HALF_MM = 5.0, 0.8
"""Depths from the target are marked so often; half the width of a mark, twice that where it is told."""

TOLD_MM, LINE_PIXELS, NUMBER_PIXELS = (10, 20, 50, 100), 14.0, 26.0
"""Depths are told as often as there is room: each takes so many pixels of a path upwards, and so many of one across."""

BESIDE_PIXELS = 4.0
"""From a mark to its depth."""

IN_PLANE = 1e-3
"""A path whose direction has no larger share out of a plane lies along it."""

LEAST_RISE_MM = 1e-6
"""A line that rises less from the plane is parallel to it."""


def paths_in_cut(those: Sequence[Trajectory], cut: Cut, pane: Pane, selected: str | None) -> list[dict[str, Any]]:
    """Return what is drawn of each trajectory, in mm from the middle of the cut that a ``pane`` shows."""
    seen = cut.on_screen_mm(ends_mm(those)).tolist()  # of all at once: a plan may hold hundreds
    return [
        _path(one, entry, target, cut, pane, one.name == selected)
        for one, (entry, target) in zip(those, seen, strict=True)
    ]


def _path(
    one: Trajectory, entry: list[float], target: list[float], cut: Cut, pane: Pane, selected: bool
) -> dict[str, Any]:
    """Return what is drawn of a trajectory; its ends are (3,) on the screen."""
    return {
        "name": one.name,
        "colour": one.colour,
        "selected": selected,
        "near": [abs(entry[2]) < NEAR_MM, abs(target[2]) < NEAR_MM],
        "width": 2.5 if selected else 1.5,
        "thick": one.instrument.diameter_mm,
        "contact": one.electrode.diameter_mm if one.electrode else 0,
        "entry": entry[:2],
        "target": target[:2],
        "part": _near_part(entry, target),
        "ticks": _ticks(one, cut, pane) if selected else [],
        "contacts": _contacts(one, cut) if one.electrode else [],
    }


def _contacts(one: Trajectory, cut: Cut) -> list[dict[str, Any]]:
    """Return the ends (2, 2) on the screen of the electrode's contacts that lie near the plane, and their numbers."""
    ends = cut.on_screen_mm(contact_ends_mm(one))
    near = np.flatnonzero((np.abs(ends[..., 2]) < NEAR_MM).all(axis=1)).tolist()
    return [{"number": n + 1, "ends": ends[n, :, :2].tolist()} for n in near]


def _ticks(one: Trajectory, cut: Cut, pane: Pane) -> list[dict[str, Any]]:
    """Return a mark across the path every `TICK_MM` from the target outwards, where the path lies in the plane.

    Only marks that the pane shows, and that are a pixel or more apart: a file may hold one of hundreds of metres.
    Depths stand to the left of a path upwards, for names stand to the right, and below one across.
    """
    pixel = pane.pixel(cut.field_mm / 2)
    if abs(one.inward @ cut.away) > IN_PLANE or pixel > TICK_MM:
        return []
    along = cut.on_screen_mm(cut.center_mm + one.inward)[:2]
    side = TICK_HALF_MM * np.array([-along[1], along[0]])
    across = bool(abs(along[0]) > abs(along[1]))
    room = pixel * (NUMBER_PIXELS if across else LINE_PIXELS)
    told = next((mm for mm in TOLD_MM if mm >= room), TOLD_MM[-1])
    away = pixel * np.array([0.0, LINE_PIXELS] if across else [-BESIDE_PIXELS, BESIDE_PIXELS])
    middle_mm, reach_mm = (one.target_mm - cut.center_mm) @ one.inward, cut.field_mm / 2 * np.hypot(*pane.halves)
    depths = np.arange(TICK_MM, one.length_mm, TICK_MM)
    marks = []
    for depth in depths[np.abs(depths - middle_mm) < reach_mm]:
        middle = cut.on_screen_mm(one.target_mm - depth * one.inward)[:2]
        labelled = round(depth) % told == 0
        ends = sorted(
            (middle + sign * (1 + labelled) * side for sign in (-1, 1)),
            key=lambda end: -end[1] if across else end[0],
        )
        marks.append(
            {
                "ends": [end.tolist() for end in ends],
                "label": f"{depth:.0f}" if labelled else "",
                "at": (ends[0] + away).tolist(),
                "anchor": "middle" if across else "end",
            }
        )
    return marks


def _near_part(entry: list[float], target: list[float]) -> list[list[float]]:
    """Return the ends (2, 2) on the screen of what lies near the plane of a line (2, 3); empty where nothing does."""
    away, rise = entry[2], target[2] - entry[2]
    if abs(rise) < LEAST_RISE_MM:
        shares = [0.0, 1.0] if abs(away) < NEAR_MM else []
    else:
        first, last = sorted(((-NEAR_MM - away) / rise, (NEAR_MM - away) / rise))
        shares = [max(first, 0.0), min(last, 1.0)] if max(first, 0.0) < min(last, 1.0) else []
    return [[a + share * (b - a) for a, b in zip(entry[:2], target[:2], strict=True)] for share in shares]
