"""Closed-form intersections of rays with scenes: the compiled heart of both renderers.

A ray is ``origin + t * direction``. Every solid is convex, so it covers one interval of ``t``; where parts
overlap, the later part replaces the earlier one (an inner part is listed after the outer one).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantoms.compiled import compiled
from phantoms.solids import FloatArray, Shape, Solid

FAR = 1e9
"""A ray parameter (mm) beyond every scene; bounds the interval of a half-space."""

_BALL, _CYLINDER, _BOX, _CONE = (int(s) for s in (Shape.BALL, Shape.CYLINDER, Shape.BOX, Shape.CONE))


class PackedSolids(NamedTuple):
    """Solids as arrays, in ascending priority, for the compiled code."""

    shapes: NDArray[np.int64]
    unit_from_world: FloatArray
    """(N, 3, 4)"""
    top_ratios: FloatArray
    centers_mm: FloatArray
    radii_mm: FloatArray


def pack(solids: Sequence[Solid]) -> PackedSolids:
    """Lay ``solids`` out for the compiled code; later ones replace earlier ones."""
    return PackedSolids(
        np.array([int(s.shape) for s in solids], dtype=np.int64),
        np.array([s.unit_from_world for s in solids]).reshape(-1, 3, 4),
        np.array([s.top_ratio for s in solids], dtype=np.float64),
        np.array([s.center_mm for s in solids], dtype=np.float64).reshape(-1, 3),
        np.array([s.radius_mm for s in solids], dtype=np.float64),
    )


@compiled()
def quadratic_interval(a: float, b: float, c: float) -> tuple[float, float]:
    """Where ``a t^2 + 2 b t + c <= 0`` with ``a >= 0``; (1, 0) where nowhere."""
    if a < 1e-18:
        return (-FAR, FAR) if c <= 0 else (1.0, 0.0)
    root = b * b - a * c
    if root <= 0:
        return 1.0, 0.0
    root = np.sqrt(root)
    return (-b - root) / a, (-b + root) / a


@compiled()
def slab_interval(origin: float, direction: float) -> tuple[float, float]:
    """Where ``|origin + t direction| <= 1``."""
    if abs(direction) < 1e-12:
        return (-FAR, FAR) if abs(origin) <= 1 else (1.0, 0.0)
    t0, t1 = (-1 - origin) / direction, (1 - origin) / direction
    return (t0, t1) if t0 < t1 else (t1, t0)


@compiled()
def cone_interval(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, ratio: float
) -> tuple[float, float]:
    """Where the ray is inside the unit cone, whose radius goes from 1 at z = -1 to ``ratio`` at z = 1."""
    z0, z1 = slab_interval(oz, dz)
    slope, radius = (ratio - 1) / 2, (ratio + 1) / 2
    ro, rd = radius + slope * oz, slope * dz
    a = dx * dx + dy * dy - rd * rd
    b = ox * dx + oy * dy - ro * rd
    c = ox * ox + oy * oy - ro * ro
    if a > 1e-15:
        t0, t1 = quadratic_interval(a, b, c)
        return max(t0, z0), min(t1, z1)
    if abs(a) <= 1e-15:
        if abs(b) < 1e-15:
            return (z0, z1) if c <= 0 else (1.0, 0.0)
        edge = -c / (2 * b)
        return (z0, min(z1, edge)) if b > 0 else (max(z0, edge), z1)
    # Steeper than the cone: inside before the first and after the second crossing, one in each nappe; ours is
    # the one whose radius is positive.
    root = np.sqrt(max(b * b - a * c, 0.0))
    t0, t1 = (-b + root) / a, (-b - root) / a
    return (max(z0, t1), z1) if rd > 0 else (z0, min(z1, t0))


@compiled()
def unit_interval(
    shape: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, ratio: float
) -> tuple[float, float]:
    """Return the interval of a ray, given in unit coordinates, inside the unit shape; empty when t1 <= t0."""
    if shape == _BALL:
        return quadratic_interval(
            dx * dx + dy * dy + dz * dz, ox * dx + oy * dy + oz * dz, ox * ox + oy * oy + oz * oz - 1
        )
    if shape == _CYLINDER:
        z0, z1 = slab_interval(oz, dz)
        t0, t1 = quadratic_interval(dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - 1)
        return max(t0, z0), min(t1, z1)
    if shape == _BOX:
        x0, x1 = slab_interval(ox, dx)
        y0, y1 = slab_interval(oy, dy)
        z0, z1 = slab_interval(oz, dz)
        return max(x0, y0, z0), min(x1, y1, z1)
    if shape == _CONE:
        return cone_interval(ox, oy, oz, dx, dy, dz, ratio)
    if abs(dz) < 1e-12:
        return (-FAR, FAR) if oz <= 0 else (1.0, 0.0)
    edge = -oz / dz
    return (-FAR, edge) if dz > 0 else (edge, FAR)


@compiled()
def put_unit(affine: FloatArray, direction: FloatArray, turned: FloatArray) -> None:
    """Put the unit coordinates of a direction into ``turned`` (3,)."""
    for n in range(3):
        turned[n] = affine[n, 0] * direction[0] + affine[n, 1] * direction[1] + affine[n, 2] * direction[2]


@compiled()
def put_unit_place(affine: FloatArray, place: FloatArray, moved: FloatArray) -> None:
    """Put the unit coordinates of a place into ``moved`` (3,)."""
    put_unit(affine, place, moved)
    for n in range(3):
        moved[n] += affine[n, 3]


@compiled()
def along(direction: FloatArray, place: FloatArray, start: FloatArray) -> float:
    """Return how far ``place`` lies from ``start`` along a unit direction."""
    total = 0.0
    for n in range(3):
        total += direction[n] * (place[n] - start[n])
    return total


@compiled()
def visible_segments(
    starts: FloatArray, stops: FloatArray, count: int, edges: FloatArray, owners: NDArray[np.int64]
) -> int:
    """Cut overlapping intervals into segments that belong to the last interval covering them.

    ``starts``/``stops`` hold ``count`` intervals in ascending priority. On return segment ``s`` reaches from
    ``edges[s]`` to ``edges[s + 1]`` and belongs to interval ``owners[s]`` (-1: none). Returns how many there are.
    """
    filled = 0
    for n in range(count):
        for value in (starts[n], stops[n]):
            place = filled
            while place > 0 and edges[place - 1] > value:
                edges[place] = edges[place - 1]
                place -= 1
            edges[place] = value
            filled += 1
    for s in range(filled - 1):
        middle = 0.5 * (edges[s] + edges[s + 1])
        owners[s] = -1
        for n in range(count - 1, -1, -1):
            if starts[n] < middle < stops[n]:
                owners[s] = n
                break
    return max(filled - 1, 0)
