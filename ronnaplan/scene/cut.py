"""A plane seen from one side, and where places lie on the screen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ronnaplan.geometry import FloatArray, unit

AXIS_LETTERS = ("LR", "PA", "SI")
"""What the positive and the negative ends of the LPS axes are called."""

LEAST_SHARE = 0.35
"""An edge of a picture is named after every axis that its direction has this share of."""

ANTERIOR, SUPERIOR = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])

STEEP = 0.7
"""A path that has a greater share of the axis from head to feet is looked along with the face up, any other upright."""

AWAY = np.array([-1.0, 1.0, 1.0])
"""Signs of the LPS axes into the screen, as radiologists look: from the left, from the front, from the feet."""


@dataclass(frozen=True, eq=False)
class Cut:
    """A plane seen from one side: unit vectors ``right`` and ``down`` (3,) on the screen, in LPS.

    ``center_mm`` (3,) is in the middle of the picture, which is ``field_mm`` wide and high.
    """

    right: FloatArray
    down: FloatArray
    center_mm: FloatArray
    field_mm: float

    @cached_property
    def away(self) -> FloatArray:
        """Unit vector (3,) from the eye into the screen."""
        away: FloatArray = np.cross(self.right, self.down)
        return away

    def place_mm(self, across_mm: float, down_mm: float) -> FloatArray:
        """Return the place (3,) in LPS at a distance from the middle of the picture."""
        place: FloatArray = self.center_mm + across_mm * self.right + down_mm * self.down
        return place

    def on_screen_mm(self, places_mm: FloatArray) -> FloatArray:
        """Return places (..., 3) as (..., 3): across and down from the middle, and away from the eye."""
        seen: FloatArray = (places_mm - self.center_mm) @ np.stack([self.right, self.down, self.away]).T
        return seen


def letters(direction: FloatArray) -> str:
    """Return towards what of the patient a unit vector (3,) in LPS leads.

    >>> letters(np.array([0.0, 0.0, -1.0])), letters(np.array([0.6, -0.8, 0.0]))
    ('I', 'AL')
    """
    order = np.argsort(-np.abs(direction))
    named = [axis for axis in order if abs(direction[axis]) > LEAST_SHARE]
    return "".join(AXIS_LETTERS[axis][0 if direction[axis] > 0 else 1] for axis in named)


def axes_along(inward: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return right and down (3,) of what is seen along a path that leads ``inward`` (3,), from outside.

    The patient's front is up where the path is steep, the top of the head else.
    """
    right = unit(np.cross(inward, ANTERIOR if abs(inward[2]) > STEEP else SUPERIOR))
    return right, np.cross(inward, right)


def axes_beside(inward: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the right (3,) of the two cuts that hold a path and have ``inward`` (3,) down, at right angles.

    Each is seen from the side from which the standard cut is seen that it is most like, and is no mirror image of that.
    """
    first, second = (way if _as_usual(np.cross(way, inward)) else -way for way in axes_along(inward))
    return first, second


def _as_usual(away: FloatArray) -> bool:
    axis = int(np.argmax(np.abs(away)))
    return bool(away[axis] * AWAY[axis] > 0)
