"""Vessels whose distance to a straight path is known exactly, to be drawn as label maps.

The wall of each goes through the origin; a path is laid beside it there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SHAPES = ("straight", "bent", "ellipsoid")


@dataclass(frozen=True)
class Vessel:
    """A solid with the origin on its wall and the outward unit ``normal`` (3,) there.

    ``depth`` of places (..., 3) is negative inside and positive outside; of tubes it is the distance in mm.
    """

    normal: FloatArray
    depth: Callable[[FloatArray], FloatArray]

    def path_beside(self, distance_mm: float, generator: np.random.Generator) -> FloatArray | None:
        """Return the direction of a path through ``distance_mm * normal`` that comes no nearer anywhere.

        The path is square to the normal, so that is so of every convex vessel; None where a bent one comes nearer.
        """
        way = np.cross(self.normal, _unit(generator))
        way /= np.linalg.norm(way)
        steps = np.linspace(-60.0, 60.0, 2401)[:, np.newaxis]
        depths = self.depth(distance_mm * self.normal + steps * way)
        return way if depths.min() >= depths[1200] - 1e-9 else None


def straight(radius_mm: float, axis: FloatArray, generator: np.random.Generator) -> Vessel:
    """Return a tube along the unit vector ``axis`` (3,)."""
    normal = _square_to(axis, generator)
    return Vessel(
        normal, lambda p: np.asarray(np.linalg.norm(np.cross(p + radius_mm * normal, axis), axis=-1) - radius_mm)
    )


def bent(radius_mm: float, bend_mm: float, generator: np.random.Generator) -> Vessel:
    """Return a ring-shaped tube whose axis is a circle of ``bend_mm``, anyhow in space."""
    axis = _unit(generator)
    normal, towards = _square_to(axis, generator), _square_to(axis, generator)
    square, center = np.cross(axis, towards), bend_mm * towards - radius_mm * normal

    def depth(p: FloatArray) -> FloatArray:
        up = (p - center) @ square
        out = np.linalg.norm(p - center - up[..., np.newaxis] * square, axis=-1)
        return np.asarray(np.hypot(out - bend_mm, up) - radius_mm)

    return Vessel(normal, depth)


def ellipsoid(half_axes_mm: FloatArray, generator: np.random.Generator) -> Vessel:
    """Return an ellipsoid with ``half_axes_mm`` (3,), anyhow in space."""
    turn, place = np.linalg.qr(generator.normal(size=(3, 3)))[0], _unit(generator)
    normal = turn @ (place / half_axes_mm)
    wall = turn @ (place * half_axes_mm)
    return Vessel(
        normal / np.linalg.norm(normal),
        lambda p: np.asarray(np.linalg.norm((p + wall) @ turn / half_axes_mm, axis=-1) - 1.0),
    )


def random_vessel(shape: str, radius_mm: float, generator: np.random.Generator) -> Vessel:
    """Return one of `SHAPES`, anyhow in space.

    A bent tube's axis is a circle of 4 to 12 radii; an ellipsoid is up to 1.5 times as thick and 1.5 to 3 times as
    long as a tube of the radius.
    """
    if shape == "straight":
        return straight(radius_mm, _unit(generator), generator)
    if shape == "bent":
        return bent(radius_mm, radius_mm * generator.uniform(4.0, 12.0), generator)
    return ellipsoid(
        radius_mm * np.array([1.0, generator.uniform(1.0, 1.5), generator.uniform(1.5, 3.0)]), generator
    )


def _unit(generator: np.random.Generator) -> FloatArray:
    direction = generator.normal(size=3)
    unit: FloatArray = direction / np.linalg.norm(direction)
    return unit


def _square_to(axis: FloatArray, generator: np.random.Generator) -> FloatArray:
    across = np.cross(axis, _unit(generator))
    unit: FloatArray = across / np.linalg.norm(across)
    return unit
