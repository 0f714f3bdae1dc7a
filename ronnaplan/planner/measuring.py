"""Distances and angles taken by clicks, and how they stand in the list and over the views."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.state import PlannerState
from ronnaplan.scene.names import Names

LETTERS = {2: "D", 3: "A"}
"""How distances and angles are named, with a number."""

RULER_COLOUR = "#b2ff59"

BESIDE_HALVES = 1 / 45
"""So far from a point stands its label, in halves of the view's shorter side."""


class Measuring:
    """The points that were clicked so far for a measurement; nothing is measured while none are ``wanted``."""

    def __init__(self, state: PlannerState) -> None:
        self.state = state
        self.wanted = 0

    def begin(self, points: int) -> None:
        """Ask for two points of a distance, or three of an angle; the same again leaves it."""
        if points not in LETTERS:
            raise UsageError(f"nothing is measured with {points} points; two make a distance, three an angle")
        self.wanted = 0 if self.wanted == points else points
        self.state.look.measured_mm = []

    def leave(self) -> None:
        """Measure nothing."""
        self.wanted, self.state.look.measured_mm = 0, []

    def take(self, place_mm: FloatArray) -> None:
        """Take a point (3,); the last one makes the measurement."""
        points = [*self.state.look.measured_mm, place_mm]
        if len(points) == self.wanted:
            self.leave()
            self.state.add_ruler(LETTERS[len(points)], points)
        else:
            self.state.look.measured_mm = points

    @property
    def asks(self) -> str:
        """What is to be clicked next, in words."""
        if not self.wanted:
            return ""
        orders = ("first", "second", "third")
        return f"click the {orders[len(self.state.look.measured_mm)]} point"


def ruler_rows(state: PlannerState) -> list[dict[str, str]]:
    """Return one row a measurement."""
    return [{"name": one.name, "value": one.told} for one in state.case.plan.rulers]


def drawn_rulers(
    state: PlannerState,
    on_screen: Callable[[FloatArray], FloatArray],
    near: Callable[[FloatArray], bool],
    names: Names,
    half: float,
) -> list[dict[str, Any]]:
    """Return measurements for a view: ``on_screen`` of points (N, 3) is (N, 2), ``near`` whether all are seen fully.

    Values are written among the view's ``names``, of what is seen fully only; half the view's shorter side is ``half``.
    What is being measured goes first, without a value.
    """
    drawn = [
        (one.name, on_screen(one.points_mm), 1, f"{one.name} {one.told}", near(one.points_mm))
        for one in state.case.plan.rulers
    ]
    begun = [on_screen(place[None])[0] for place in state.look.measured_mm]
    if begun:
        drawn.insert(0, ("", np.array(begun), -1, "...", True))
    return names.of_places(
        [
            {
                "name": name,
                "line": _line(points),
                "label": label if seen else "",
                "near": seen,
                "colour": RULER_COLOUR,
            }
            | {"x": float(points[at, 0]), "y": float(points[at, 1]), "r": half * BESIDE_HALVES}
            for name, points, at, label, seen in drawn
        ]
    )


def _line(points: Any) -> str:
    """Return points (N, 2) as SVG has them."""
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in points)
