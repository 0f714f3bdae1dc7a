"""Convex solids: each is a unit shape, stretched, turned and moved into the patient.

Coordinates are LPS mm. A `Solid` is made by `sphere`, `ellipsoid`, `cylinder`, `box`, `cone` or `half_space`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from phantoms.errors import PhantomError

FloatArray = NDArray[np.float64]
Vector = Sequence[float] | FloatArray
"""Three numbers: a place in mm or a direction."""


class Shape(IntEnum):
    """The unit shapes; the numbers are shared with the compiled code in `phantoms.rays`."""

    BALL = 0  # |p| <= 1
    CYLINDER = 1  # x^2 + y^2 <= 1, |z| <= 1
    BOX = 2  # |x|, |y|, |z| <= 1
    CONE = 3  # x^2 + y^2 <= r(z)^2, r from 1 at z = -1 to top_ratio at z = 1
    HALF_SPACE = 4  # z <= 0


@dataclass(frozen=True)
class Solid:
    """``shape`` under the map ``center_mm + half_axes_mm @ unit_point``; ``half_axes_mm`` (3, 3) holds columns."""

    shape: Shape
    center_mm: FloatArray
    half_axes_mm: FloatArray
    top_ratio: float = 0.0

    @property
    def radius_mm(self) -> float:
        """Radius of a ball about ``center_mm`` that holds the whole solid."""
        if self.shape is Shape.HALF_SPACE:
            return float("inf")
        lengths = np.linalg.norm(self.half_axes_mm, axis=0)
        if self.shape is Shape.BALL:
            return float(lengths.max())
        if self.shape is Shape.BOX:
            return float(np.linalg.norm(lengths))
        return float(np.hypot(lengths[:2].max() * max(1.0, self.top_ratio), lengths[2]))

    @property
    def unit_from_world(self) -> FloatArray:
        """The affine map (3, 4) from LPS mm to the unit shape."""
        inverse = np.linalg.inv(self.half_axes_mm)
        return np.column_stack([inverse, -inverse @ self.center_mm])

    def moved(self, rotation: FloatArray, translation_mm: FloatArray) -> Solid:
        """Return the solid after ``p -> rotation @ p + translation_mm``."""
        return replace(
            self,
            center_mm=rotation @ self.center_mm + translation_mm,
            half_axes_mm=rotation @ self.half_axes_mm,
        )

    def contains(self, points_mm: FloatArray, margin: float = 0.0) -> NDArray[np.bool_]:
        """Tell which of ``points_mm`` (N, 3) lie inside; ``margin`` grows the unit shape by that fraction."""
        affine = self.unit_from_world
        unit = points_mm @ affine[:, :3].T + affine[:, 3]
        limit = 1.0 + margin
        x, y, z = unit.T
        inside: NDArray[np.bool_]
        if self.shape is Shape.BALL:
            inside = np.sum(unit**2, axis=1) <= limit**2
        elif self.shape is Shape.BOX:
            inside = np.abs(unit).max(axis=1) <= limit
        elif self.shape is Shape.HALF_SPACE:
            inside = z <= margin
        else:
            radius = 1.0 if self.shape is Shape.CYLINDER else (1 - z) / 2 + self.top_ratio * (1 + z) / 2
            inside = (np.abs(z) <= limit) & (np.hypot(x, y) <= radius + margin)
        return inside


def sphere(center_mm: Vector, diameter_mm: float) -> Solid:
    """Return a ball of ``diameter_mm``."""
    return ellipsoid(center_mm, (diameter_mm / 2,) * 3)


def ellipsoid(center_mm: Vector, semi_axes_mm: Vector, rotation: FloatArray | None = None) -> Solid:
    """Return an ellipsoid; the columns of ``rotation`` (3, 3) are the directions of its semi-axes."""
    return _solid(Shape.BALL, center_mm, semi_axes_mm, rotation)


def box(center_mm: Vector, size_mm: Vector, rotation: FloatArray | None = None) -> Solid:
    """Return a box with edges of ``size_mm`` (3,) along the columns of ``rotation``."""
    return _solid(Shape.BOX, center_mm, np.asarray(size_mm, dtype=np.float64) / 2, rotation)


def cylinder(start_mm: Vector, direction: Vector, length_mm: float, diameter_mm: float) -> Solid:
    """Return a cylinder whose axis leaves ``start_mm``, the center of one end, along ``direction``."""
    return cone(start_mm, direction, length_mm, diameter_mm, diameter_mm)


def cone(
    start_mm: Vector, direction: Vector, length_mm: float, diameter_mm: float, end_diameter_mm: float = 0.0
) -> Solid:
    """Return a (truncated) cone: ``diameter_mm`` at ``start_mm``, ``end_diameter_mm`` at the other end."""
    if end_diameter_mm < 0:
        raise PhantomError(f"a cone's end diameter is {end_diameter_mm} mm; expected zero or more")
    rotation = frame_along(direction)
    center = np.asarray(start_mm, dtype=np.float64) + rotation[:, 2] * length_mm / 2
    shape = Shape.CYLINDER if diameter_mm == end_diameter_mm else Shape.CONE
    half = (diameter_mm / 2, diameter_mm / 2, length_mm / 2)
    solid = _solid(shape, center, half, rotation)
    return replace(solid, top_ratio=end_diameter_mm / diameter_mm)


def half_space(point_mm: Vector, outward: Vector) -> Solid:
    """Return everything behind the plane through ``point_mm`` whose normal is ``outward``."""
    return _solid(Shape.HALF_SPACE, point_mm, (1.0, 1.0, 1.0), frame_along(outward))


def frame_along(direction: Vector) -> FloatArray:
    """Return a rotation (3, 3) whose third column points along ``direction``."""
    z = np.asarray(direction, dtype=np.float64)
    length = float(np.linalg.norm(z))
    if z.shape != (3,) or not np.isfinite(length) or length == 0.0:
        raise PhantomError(f"direction {z.tolist()} has no direction; expected three numbers, not all zero")
    z = z / length
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _solid(shape: Shape, center_mm: Vector, half_mm: Vector, rotation: FloatArray | None) -> Solid:
    center = np.asarray(center_mm, dtype=np.float64)
    half = np.asarray(half_mm, dtype=np.float64)
    if center.shape != (3,) or not np.isfinite(center).all():
        raise PhantomError(f"a solid's place is {center.tolist()}; expected three finite coordinates in mm")
    if half.shape != (3,) or not (np.isfinite(half).all() and (half > 0).all()):
        raise PhantomError(f"a {shape.name.lower()} has half-sizes {half.tolist()} mm; expected positive lengths")
    axes = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
    return Solid(shape, center, axes * half)
