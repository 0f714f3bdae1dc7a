"""Distances and angles that a person measured in the scan, kept with the plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray, as_points

SHORTEST_MM = 0.01
"""Points of a ruler that are nearer to each other are one place, without a direction."""


@dataclass(frozen=True, eq=False)
class Ruler:
    """A distance between two points, or the angle at the second of three: ``points_mm`` (2 or 3, 3), LPS mm.

    Raises `InputError` for an empty name, another number of points, and neighbouring points that are one place.
    """

    name: str
    points_mm: FloatArray

    def __post_init__(self) -> None:
        check_type(self.name, str, "a measurement's name", "give it a text")
        if not self.name.strip():
            raise InputError("a measurement has no name; give it one")
        points = as_points(self.points_mm, f"the points of {self.name}")
        if len(points) not in (2, 3):
            raise InputError(
                f"{self.name} has {len(points)} points; expected two for a distance, three for an angle"
            )
        if np.linalg.norm(np.diff(points, axis=0), axis=1).min() < SHORTEST_MM:
            raise InputError(f"two points of {self.name} are one place; expected different points")
        points.setflags(write=False)
        object.__setattr__(self, "points_mm", points)

    @property
    def is_angle(self) -> bool:
        """Whether it is an angle, in degrees; a distance is in mm."""
        return len(self.points_mm) == 3

    @property
    def value(self) -> float:
        """The distance in mm, or the angle in degrees."""
        if not self.is_angle:
            return float(np.linalg.norm(self.points_mm[1] - self.points_mm[0]))
        one, other = self.points_mm[0] - self.points_mm[1], self.points_mm[2] - self.points_mm[1]
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))

    @property
    def told(self) -> str:
        """The value with its unit."""
        return f"{self.value:.1f} {'deg' if self.is_angle else 'mm'}"
