"""Where rows of rays are inside solids: many rays at a time, each in closed form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantoms.compiled import compiled
from phantoms.rays import PackedSolids, unit_interval
from phantoms.solids import FloatArray, Shape

THIN_RAY = 20.0
"""A ball this many times larger than a ray's height is crossed by a line; a smaller one is averaged exactly."""

_BALL, _CYLINDER = int(Shape.BALL), int(Shape.CYLINDER)


class Row(NamedTuple):
    """Solids that a row of rays may meet, each between two places (mm) along the row, and how the rays run.

    In a solid's unit coordinates the ray at ``u`` mm is ``origins + u origins_by_mm`` plus any multiple of
    ``directions + u directions_by_mm``; a step along ``up`` is a mm square to row and rays.
    """

    solids: NDArray[np.int64]
    low_mm: FloatArray
    high_mm: FloatArray
    origins: FloatArray
    origins_by_mm: FloatArray
    directions: FloatArray
    directions_by_mm: FloatArray
    up: FloatArray


class Rays(NamedTuple):
    """The rays of a row at ``first + n step`` mm: where each begins and ends (U,), in steps of so many mm (U,)."""

    first_mm: float
    step_mm: float
    starts: FloatArray
    stops: FloatArray
    lengths_mm: FloatArray
    half_height_mm: float
    """Balls are averaged over this much to either side; 0: not at all."""


@compiled()
def room_for(parts: int) -> Row:
    """Return storage for so many solids."""
    return Row(
        np.empty(parts, np.int64),
        np.empty(parts),
        np.empty(parts),
        np.zeros((parts, 3)),
        np.zeros((parts, 3)),
        np.zeros((parts, 3)),
        np.zeros((parts, 3)),
        np.zeros((parts, 3)),
    )


@compiled()
def mark_between(low_mm: float, high_mm: float, first_mm: float, bin_mm: float, marks: NDArray[np.bool_]) -> None:
    """Mark the elements that see something between two places (mm) of a row, and their neighbours."""
    first = max(0, int((low_mm - first_mm) / bin_mm - 0.5))
    last = min(len(marks) - 1, int((high_mm - first_mm) / bin_mm + 1.5))
    marks[first : last + 1] = True


@compiled()
def intervals(
    solids: PackedSolids,
    row: Row,
    c: int,
    rays: Rays,
    first: int,
    last: int,
    starts: FloatArray,
    stops: FloatArray,
) -> None:
    """Find where the rays from ``first`` to ``last`` are inside one solid (an empty interval: nowhere).

    Balls and cylinders are worked out without branches, which the compiler turns into vector instructions.
    """
    n, half = row.solids[c], rays.half_height_mm
    ox, oy, oz = row.origins[c, 0], row.origins[c, 1], row.origins[c, 2]
    ax, ay, az = row.origins_by_mm[c, 0], row.origins_by_mm[c, 1], row.origins_by_mm[c, 2]
    dx, dy, dz = row.directions[c, 0], row.directions[c, 1], row.directions[c, 2]
    bx, by, bz = row.directions_by_mm[c, 0], row.directions_by_mm[c, 1], row.directions_by_mm[c, 2]
    shape, ratio, count = solids.shapes[n], solids.top_ratios[n], last - first
    u0, step = rays.first_mm + first * rays.step_mm, rays.step_mm
    if shape == _BALL and half == 0.0:
        for i in range(count):
            u = u0 + i * step
            x, y, z = ox + u * ax, oy + u * ay, oz + u * az
            p, q, r = dx + u * bx, dy + u * by, dz + u * bz
            a, b = p * p + q * q + r * r, x * p + y * q + z * r
            root = np.sqrt(max(b * b - a * (x * x + y * y + z * z - 1), 0.0))
            starts[i], stops[i] = (-b - root) / a, (-b + root) / a
    elif shape == _BALL:
        _flat_intervals(row, c, u0, step, half, starts[:count], stops[:count])
    elif shape == _CYLINDER:
        for i in range(count):
            u = u0 + i * step
            x, y, z = ox + u * ax, oy + u * ay, oz + u * az
            p, q, r = dx + u * bx, dy + u * by, dz + u * bz
            a, b = max(p * p + q * q, 1e-18), x * p + y * q
            root = np.sqrt(max(b * b - a * (x * x + y * y - 1), 0.0))
            rise = r if abs(r) > 1e-12 else 1e-12
            t0, t1 = (-1 - z) / rise, (1 - z) / rise
            starts[i] = max((-b - root) / a, min(t0, t1))
            stops[i] = min((-b + root) / a, max(t0, t1))
    else:
        for i in range(count):
            u = u0 + i * step
            starts[i], stops[i] = unit_interval(
                shape, ox + u * ax, oy + u * ay, oz + u * az, dx + u * bx, dy + u * by, dz + u * bz, ratio
            )


@compiled()
def _flat_intervals(
    row: Row, c: int, first_mm: float, step_mm: float, half: float, starts: FloatArray, stops: FloatArray
) -> None:
    """Find where flat parallel rays, ``half`` mm to either side, are inside a ball on average.

    The half chord at height z is sqrt(q(z)) / a with q(z) = (S^2 - (z - z0)^2) A, so its average is closed-form.
    Where S is many times ``half`` the chord in the middle will do.
    """
    ox, oy, oz = row.origins[c, 0], row.origins[c, 1], row.origins[c, 2]
    ax, ay, az = row.origins_by_mm[c, 0], row.origins_by_mm[c, 1], row.origins_by_mm[c, 2]
    dx, dy, dz = row.directions[c, 0], row.directions[c, 1], row.directions[c, 2]
    mx, my, mz = row.up[c, 0], row.up[c, 1], row.up[c, 2]
    a, b1 = dx * dx + dy * dy + dz * dz, mx * dx + my * dy + mz * dz
    curvature = a * (mx * mx + my * my + mz * mz) - b1 * b1
    thick = False
    for i in range(len(starts)):
        u = first_mm + i * step_mm
        x, y, z = ox + u * ax, oy + u * ay, oz + u * az
        b0, at_zero, center, peak = _section(x, y, z, dx, dy, dz, mx, my, mz, a, b1, curvature)
        root = np.sqrt(max(at_zero, 0.0))
        starts[i], stops[i] = (-b0 - root) / a, (-b0 + root) / a
        thick |= (peak > 0) & (peak < curvature * max((THIN_RAY * half) ** 2, 2 * center * center))
    if not thick:
        return
    for i in range(len(starts)):
        u = first_mm + i * step_mm
        x, y, z = ox + u * ax, oy + u * ay, oz + u * az
        b0, _, center, peak = _section(x, y, z, dx, dy, dz, mx, my, mz, a, b1, curvature)
        if peak <= 0 or peak >= curvature * max((THIN_RAY * half) ** 2, 2 * center * center):
            continue
        reach = np.sqrt(peak / curvature)
        low, high = max(-half, center - reach), min(half, center + reach)
        starts[i], stops[i] = 1.0, 0.0
        if low < high:
            area = _under_circle(high - center, reach) - _under_circle(low - center, reach)
            chord = np.sqrt(curvature) * area / (2 * half * a)
            middle = -(b0 + b1 * 0.5 * (low + high)) / a
            starts[i], stops[i] = middle - chord, middle + chord


@compiled()
def _section(
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    mx: float,
    my: float,
    mz: float,
    a: float,
    b1: float,
    curvature: float,
) -> tuple[float, float, float, float]:
    """Return b0 and q at height 0, and where q is largest and how large it is there."""
    b0 = x * dx + y * dy + z * dz
    at_zero = b0 * b0 - a * (x * x + y * y + z * z - 1)
    center = (b0 * b1 - a * (x * mx + y * my + z * mz)) / curvature
    return b0, at_zero, center, at_zero + curvature * center * center


@compiled()
def _under_circle(x: float, radius: float) -> float:
    """Integral of ``sqrt(radius^2 - x^2)`` from 0 to ``x``."""
    ratio = min(1.0, max(-1.0, x / radius))
    area: float = 0.5 * radius * radius * (ratio * np.sqrt(1 - ratio * ratio) + np.arcsin(ratio))
    return area
