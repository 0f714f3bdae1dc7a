"""Where a pointer is in a view, in pixels, and what of the case that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.scene.cut import Cut


@dataclass(frozen=True)
class Pixel:
    """A place ``x``, ``y`` in a view of ``width`` x ``height`` pixels, whose square picture is fitted into it."""

    x: float
    y: float
    width: float
    height: float

    @property
    def side(self) -> float:
        """Pixels along a side of the picture."""
        return max(min(self.width, self.height), 1.0)

    @property
    def halves(self) -> FloatArray:
        """The place (2,) from the middle, across and down, in halves of the picture."""
        return np.array([self.x - self.width / 2, self.y - self.height / 2]) / (self.side / 2)

    def place_mm(self, cut: Cut) -> FloatArray:
        """Return the place (3,) in LPS under the pixel, in the plane of the cut."""
        across, down = self.halves * cut.field_mm / 2
        return cut.place_mm(across, down)

    def pixels_to(self, halves: FloatArray) -> FloatArray:
        """Return how many pixels places (..., 2) on the screen, in halves of the picture, are away."""
        distances: FloatArray = np.linalg.norm(halves - self.halves, axis=-1) * self.side / 2
        return distances
