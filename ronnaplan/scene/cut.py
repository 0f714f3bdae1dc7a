"""A plane seen from one side, and where places lie on the screen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ronnaplan.geometry import FloatArray


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
