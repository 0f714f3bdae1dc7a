"""What there is to see in 3-D, each a body with its colour: the same for the planner, for pictures and for files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Measures
from ronnaplan.planning.contacts import contact_paths
from ronnaplan.planning.trajectory import Trajectory
from ronnaplan.scene.shapes import Body, ball, joined, specks, tube

SKIN_COLOUR: Final = "#e0b89c"
SKULL_COLOUR: Final = "#ece2cc"
MARKER_COLOUR: Final = "#ff9f1c"
REJECTED_COLOUR: Final = "#ff5252"
NO_GO_COLOUR: Final = "#e53935"
CONTACT_COLOUR: Final = "#f5f7fa"
PROPOSAL_COLOURS: Final = ("#3a0a2e", "#c2259a")
"""From the worst to the best; nothing else on the page is magenta, to colour-blind eyes neither."""

CONTACT_SHARE: Final = 1.4
"""Contacts are drawn so much thicker than what they are on, to be seen."""

THINNEST_MM: Final = 0.5
"""A trajectory is drawn with at least this radius, to be seen."""

TARGET_MM: Final = 2.0
"""Radius of the ball at a target."""

REJECTED_MM: Final = 2.5
"""Half width of what stands for a rejected candidate."""

TUBE_OPACITY: Final = 0.3
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


def rgb(colour: str) -> FloatArray:
    """Return #rrggbb as (3,) from 0 to 1."""
    return np.array([int(colour[n : n + 2], 16) for n in (1, 3, 5)]) / 255.0


def skin(body: Body, opacity: float = 1.0) -> Thing:
    """Return the skin."""
    return Thing("skin", body, rgb(SKIN_COLOUR), opacity, gloss=0.1, screen=True)


def skull(body: Body, opacity: float = 1.0) -> Thing:
    """Return the skull."""
    return Thing("skull", body, rgb(SKULL_COLOUR), opacity, gloss=0.1, screen=True)


def no_go(name: str, body: Body, opacity: float = 0.7) -> Thing:
    """Return a region to keep away from."""
    return Thing(f"no-go {name}", body, rgb(NO_GO_COLOUR), opacity)


def marker(label: str, center_mm: FloatArray, diameter_mm: float) -> Thing:
    """Return a marker as a ball of its size."""
    return Thing(
        f"marker {label}", ball(center_mm, diameter_mm / 2 + VEIL_MM, sides=32), rgb(MARKER_COLOUR), gloss=0.4
    )


def rejected(centers_mm: Sequence[FloatArray]) -> Thing:
    """Return what stands for the candidates that were turned down."""
    return Thing("rejected", specks(np.array(centers_mm).reshape(-1, 3), REJECTED_MM), rgb(REJECTED_COLOUR))


def path(one: Trajectory, measured: Measures | None = None) -> list[Thing]:
    """Return a trajectory as thick as its instrument, its contacts, and the tube it stays in with a chance of 95 %."""
    line = tube(np.stack([one.entry_mm, one.target_mm]), max(one.instrument.radius_mm, THINNEST_MM))
    found = [Thing(f"path {one.name}", joined([line, ball(one.target_mm, TARGET_MM)]), rgb(one.colour))]
    if one.electrode is not None:
        thick = CONTACT_SHARE * max(one.electrode.diameter_mm / 2, one.instrument.radius_mm, THINNEST_MM)
        bodies = [tube(np.stack([part.entry_mm, part.target_mm]), thick) for part in contact_paths(one)]
        found.append(Thing(f"contacts {one.name}", joined(bodies), rgb(CONTACT_COLOUR)))
    if measured is not None and measured.error is not None:
        around = tube(one.at_depth(measured.error.depths_mm), measured.error.tube_mm)
        found.append(Thing(f"tube {one.name}", around, rgb(one.colour), TUBE_OPACITY))
    return found
