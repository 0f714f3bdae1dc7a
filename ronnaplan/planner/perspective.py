"""How the 3-D view sees the head: where a place appears on the screen, and what lies under a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray, unit
from ronnaplan.planner.cuts import Cut


@dataclass(frozen=True, eq=False)
class Eye:
    """A pinhole camera at ``position_mm`` (3,) in LPS with a square picture.

    ``right`` and ``down`` (3,) are unit vectors on the screen; half the picture is seen under an angle whose tangent
    is ``half_tangent``; what lies ``middle_mm`` ahead is what the eye turns about.
    """

    position_mm: FloatArray
    right: FloatArray
    down: FloatArray
    half_tangent: float
    middle_mm: float

    @classmethod
    def looking_at(cls, position_mm: FloatArray, focus_mm: FloatArray, up: FloatArray, angle_deg: float) -> Eye:
        """Return the eye of a camera that sees ``angle_deg`` from the top to the bottom of its picture."""
        away = unit(np.asarray(focus_mm) - position_mm)
        right = unit(np.cross(away, up))
        distance = float(np.linalg.norm(np.asarray(focus_mm) - position_mm))
        return cls(
            np.asarray(position_mm),
            right,
            np.cross(away, right),
            float(np.tan(np.radians(angle_deg) / 2)),
            distance,
        )

    @property
    def away(self) -> FloatArray:
        """Unit vector (3,) into the screen."""
        away: FloatArray = np.cross(self.right, self.down)
        return away

    def plane_at(self, place_mm: FloatArray) -> Cut:
        """Return the plane parallel to the screen through a place (3,) before the eye, as large as the picture."""
        depth = float((place_mm - self.position_mm) @ self.away)
        return Cut(self.right, self.down, self.position_mm + depth * self.away, 2 * depth * self.half_tangent)

    def on_screen(self, places_mm: FloatArray) -> FloatArray:
        """Return places (..., 3) as (..., 3): across and down in halves of the picture, and mm away from the eye."""
        seen = (places_mm - self.position_mm) @ np.stack([self.right, self.down, self.away]).T
        depth = seen[..., 2:]
        screen: FloatArray = np.concatenate([seen[..., :2] / (depth * self.half_tangent), depth], axis=-1)
        return screen

    def ray(self, across: float, down: float) -> FloatArray:
        """Return the unit vector (3,) from the eye through a point of the picture, given in halves of it."""
        return unit(self.away + self.half_tangent * (across * self.right + down * self.down))
