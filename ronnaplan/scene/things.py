"""What there is to see in 3-D, each a body with its colour: the same for the planner, for pictures and for files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Measures
from ronnaplan.planning.contacts import contact_ends_mm
from ronnaplan.planning.trajectory import Trajectory
from ronnaplan.scene.shapes import Body, ball, box, ellipsoid, joined, moved, specks, tube

SKIN_COLOUR: Final = "#e0b89c"
SKULL_COLOUR: Final = "#ece2cc"
MARKER_COLOUR: Final = "#ff9f1c"
REJECTED_COLOUR: Final = "#ff5252"
NO_GO_COLOUR: Final = "#e53935"
LABEL_COLOURS: Final = ("#b39ddb", "#a5d6a7", "#bcaaa4", "#90caf9", "#e6ee9c")
"""Of label maps one after another, until others are chosen."""
REGION_OPACITY: Final = 0.7
"""Of regions, until another is chosen."""

CONTACT_COLOUR: Final = "#f5f7fa"
PROPOSAL_COLOURS: Final = ("#3a0a2e", "#c2259a")
"""From the worst to the best; nothing else on the page is magenta, to colour-blind eyes neither."""

PROPOSED_COLOUR: Final = "#ffc2f0"
"""Of the numbers of the best, which stand on the map of those colours."""

CONTACT_SHARE: Final = 1.4
"""Contacts are drawn so much thicker than what they are on, to be seen."""

THINNEST_MM: Final = 0.5
"""A trajectory is drawn with at least this radius, to be seen."""

TARGET_MM: Final = 2.0
"""Radius of the ball at a target."""

REJECTED: Final = "rejected"
"""What candidates are called that were turned down."""

REJECTED_MM: Final = 2.5
"""Half width of what stands for a rejected candidate."""

TUBE_OPACITY: Final = 0.3
RADII_95: Final = 2.7955
"""Half axes, in standard deviations, of the ellipsoid that holds a place with a chance of 95 %."""

SPREAD_COLOUR: Final = "#ffffff"
SPREAD_FACTORS: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Ellipsoids are enlarged by one of these, all alike, to be seen beside their markers."""

TOOL_COLOUR: Final = "#fff176"
TRACKER_COLOUR: Final = "#90a4ae"
TOOL_MM, TOOL_RADIUS_MM, TIP_MM = 130.0, 1.5, 12.0
"""How long and thick a tracked tool is drawn, and over how long its tip narrows."""

BAR_MM, EYE_MM = (550.0, 80.0, 80.0), 32.0
"""A tracker is drawn as a bar of these sides, with two eyes of this radius."""

VEIL_MM: Final = 0.3
"""A marker is drawn so much larger, to come out of its own surface among the skin's."""


@dataclass(frozen=True, eq=False)
class Thing:
    """A body that is shown: ``colour`` (3,) or one a vertex (V, 3), red, green, blue from 0 to 1."""

    name: str
    body: Body
    colour: FloatArray
    opacity: float = 1.0
    gloss: float = 0.25
    screen: bool = False
    """Seen through only where something lies behind: nothing else would be seen but the background."""
    label: str = ""
    label_mm: FloatArray | None = None
    """What stands beside this place (3,) where names can be written."""


def rgb(colour: str) -> FloatArray:
    """Return #rrggbb as (3,) from 0 to 1."""
    return np.array([int(colour[n : n + 2], 16) for n in (1, 3, 5)]) / 255.0


def skin(body: Body, opacity: float = 1.0) -> Thing:
    """Return the skin."""
    return Thing("skin", body, rgb(SKIN_COLOUR), opacity, gloss=0.1, screen=True)


def skull(body: Body, opacity: float = 1.0) -> Thing:
    """Return the skull."""
    return Thing("skull", body, rgb(SKULL_COLOUR), opacity, gloss=0.1, screen=True)


def label_colour(number: int) -> str:
    """Return the color of a label map, counted from 0, until another is chosen."""
    return LABEL_COLOURS[number % len(LABEL_COLOURS)]


def no_go(name: str, body: Body, opacity: float = REGION_OPACITY, colour: str = NO_GO_COLOUR) -> Thing:
    """Return a region to keep away from."""
    return Thing(f"no-go {name}", body, rgb(colour), opacity)


def label_map(name: str, body: Body, colour: str, opacity: float = REGION_OPACITY) -> Thing:
    """Return a region that is shown only."""
    return Thing(f"region {name}", body, rgb(colour), opacity)


def marker(label: str, center_mm: FloatArray, diameter_mm: float, opacity: float = 1.0) -> Thing:
    """Return a marker at a place (3,), LPS mm, as a ball of its size."""
    round_one = ball(center_mm, diameter_mm / 2 + VEIL_MM, sides=32)
    return Thing(
        f"marker {label}", round_one, rgb(MARKER_COLOUR), opacity, gloss=0.4, label=label, label_mm=center_mm
    )


def spread_factor(covariances_mm2: FloatArray, diameter_mm: float) -> int:
    """Return how much the ellipsoids of markers (N, 3, 3) are enlarged so that none is thicker than a marker."""
    greatest = RADII_95 * float(np.sqrt(np.linalg.eigvalsh(covariances_mm2).max()))
    return max((factor for factor in SPREAD_FACTORS if factor * greatest <= diameter_mm / 2), default=1)


def spread_name(label: str, factor: int) -> str:
    """Return what an ellipsoid is, in words."""
    return f"95 % of {label}" if factor == 1 else f"95 % of {label}, {factor} times as large"


def spread(label: str, center_mm: FloatArray, covariance_mm2: FloatArray, factor: int) -> Thing:
    """Return the ellipsoid that holds a marker's center with a chance of 95 %, enlarged by ``factor``.

    ``center_mm`` (3,) in LPS, ``covariance_mm2`` (3, 3).
    """
    variances, directions = np.linalg.eigh(covariance_mm2)
    axes = factor * RADII_95 * directions * np.sqrt(variances)
    return Thing(spread_name(label, factor), ellipsoid(center_mm, axes, sides=24), rgb(SPREAD_COLOUR))


def tool(name: str, tip_mm: FloatArray, back: FloatArray) -> Thing:
    """Return a tracked tool that narrows to its tip, from there along the unit vector ``back`` (3,)."""
    points = tip_mm + np.outer([0.0, TIP_MM, TOOL_MM], back)
    return Thing(f"tool {name}", tube(points, [0.05, TOOL_RADIUS_MM, TOOL_RADIUS_MM]), rgb(TOOL_COLOUR))


def tracker(ct_from_ots: FloatArray) -> Thing:
    """Return a bar with two eyes at the origin of the tracker's frame, the bar along its x, the eyes towards its z.

    ``ct_from_ots`` (4, 4) says where that is.
    """
    eyes = [ball([side * BAR_MM[0] / 3, 0.0, BAR_MM[2] / 2], EYE_MM) for side in (-1.0, 1.0)]
    return Thing("tracker", moved(joined([box(np.zeros(3), BAR_MM), *eyes]), ct_from_ots), rgb(TRACKER_COLOUR))


def rejected(centers_mm: Sequence[FloatArray]) -> Thing:
    """Return what stands for the candidates that were turned down, at places (3,) in LPS mm."""
    return Thing(REJECTED, specks(np.array(centers_mm).reshape(-1, 3), REJECTED_MM), rgb(REJECTED_COLOUR))


def path(one: Trajectory, measured: Measures | None = None) -> list[Thing]:
    """Return a trajectory as thick as its instrument, its contacts, and the tube it stays in with a chance of 95 %."""
    line = tube(np.stack([one.entry_mm, one.target_mm]), max(one.instrument.radius_mm, THINNEST_MM))
    body = joined([line, ball(one.target_mm, TARGET_MM)])
    found = [Thing(f"path {one.name}", body, rgb(one.colour), label=one.name, label_mm=one.entry_mm)]
    if one.electrode is not None:
        thick = CONTACT_SHARE * max(one.electrode.diameter_mm / 2, one.instrument.radius_mm, THINNEST_MM)
        bodies = [tube(ends_mm, thick) for ends_mm in contact_ends_mm(one)]
        found.append(Thing(f"contacts {one.name}", joined(bodies), rgb(CONTACT_COLOUR)))
    if measured is not None and measured.error is not None:
        around = tube(one.at_depth(measured.error.depths_mm), measured.error.tube_mm)
        found.append(Thing(f"tube {one.name}", around, rgb(one.colour), TUBE_OPACITY))
    return found
