"""The sphere on which the image falls off around a place, found from nearest voxels in all directions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.fit.algebra import quantile, solve
from ronnaplan.localization.fit.cells import BACKGROUND_QUANTILE, cell_directions
from ronnaplan.localization.search.nearest import Lookup, fill_nearest, lookup_of
from ronnaplan.threads import in_parts

LEAST_SHOWN = 0.6
"""A ball falls to its surroundings somewhere in at least this share of the directions ..."""

LEAST_ROUND = 0.72
NEAR_SHARE, NEAR_VOXELS = 0.1, 0.4
"""... and in this share of them within so much of its radius, or so many voxels, from one sphere: balls on posts do so
in 0.95 of them, posts alone in 0.4 to 0.7."""

BALL_RADII = 28
"""Distances from the center at which the image is looked at, up to 1.8 radii."""

SAME_RATIO = (0.6, 1.7)
"""A sphere of another size than these shares of what was looked for is looked for at that size."""


def spheres_at(
    volume: CTVolume, places_mm: FloatArray, diameters_mm: FloatArray, build: Build
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centers (N, 3), diameters (N,) and shares (N,) of the surfaces of the spheres about ``places_mm`` (N, 3).

    The share is 0 where there is no such sphere of about one of ``diameters_mm`` (N,).
    """
    axes = volume.grid.axes
    directions = np.ascontiguousarray(cell_directions() @ axes.T)
    voxel_mm = max(volume.grid.row_spacing_mm, volume.grid.typical_gap_mm)
    found = np.column_stack([places_mm @ axes.T, diameters_mm, np.zeros(len(places_mm))])
    lookup = lookup_of(volume)

    def look(first: int, end: int) -> None:
        _see_spheres(found[first:end], directions, build.wall_mm > 0.0, voxel_mm, lookup)

    in_parts(look, len(found))
    return found[:, :3] @ axes, found[:, 3], found[:, 4]


@njit(cache=True, nogil=True)
def _see_spheres(
    found: FloatArray, directions: FloatArray, is_hollow: bool, voxel_mm: float, lookup: Lookup
) -> None:
    """Turn places and diameters (N, 5) along u, v, w into spheres, each with its share of the surface or 0.

    Written out, as all below: what numba makes of whole arrays' arithmetic takes it many seconds to compile.
    """
    for n in range(len(found)):
        center, diameter, share = found[n, :3].copy(), found[n, 3], 1.0
        for _ in range(2):  # the second time from the sphere's own center
            if share > 0.0:
                diameter, share = _closer(center, diameter, directions, is_hollow, voxel_mm, lookup)
        if share >= LEAST_ROUND:
            for a in range(3):
                found[n, a] = center[a]
            found[n, 3], found[n, 4] = diameter, share


@njit(cache=True, nogil=True)
def _closer(
    center: FloatArray, diameter: float, directions: FloatArray, is_hollow: bool, voxel_mm: float, lookup: Lookup
) -> tuple[float, float]:
    """Move ``center`` (3,) to that of the sphere that is seen from it; return its diameter and share, or 0 for none."""
    falls = _falls(center, diameter / 2.0, directions, is_hollow, lookup)
    if len(falls) < LEAST_SHOWN * len(directions):
        return diameter, 0.0
    aside, radius, off_mm = _sphere_through(falls)
    if not SAME_RATIO[0] < 2.0 * radius / diameter < SAME_RATIO[1]:
        return diameter, 0.0
    near_mm, near = max(NEAR_SHARE * radius, NEAR_VOXELS * voxel_mm), 0
    for n in range(len(off_mm)):
        near += off_mm[n] <= near_mm
    for a in range(3):
        center[a] += aside[a]
    return 2.0 * radius, near / len(directions)


@njit(cache=True, nogil=True)
def _falls(
    center: FloatArray, radius: float, directions: FloatArray, is_hollow: bool, lookup: Lookup
) -> FloatArray:
    """Return, from the center, the places (N, 3) at which the image first falls to half its step, where it does."""
    reach, values = np.linspace(0.3, 1.8, BALL_RADII), np.empty((BALL_RADII, len(directions)))
    start, highest, last, left = 0, -np.inf, BALL_RADII - 1, np.arange(len(directions))
    for r in range(BALL_RADII):
        reach[r] *= radius
        if is_hollow or r in (0, last):
            _look(center, directions, reach[r], left, lookup, values[r])
        usual = quantile(values[r], 0.5) if is_hollow else -np.inf
        if usual > highest:  # what is hollow is dark within
            start, highest = r, usual
    level = (quantile(values[start], 0.5) + quantile(values[last], BACKGROUND_QUANTILE)) / 2.0
    fallen = np.zeros(len(directions), np.intp)
    for r in range(start, BALL_RADII):
        if not is_hollow and 0 < r < last:  # farther out only where it has not fallen yet
            _look(center, directions, reach[r], left, lookup, values[r])
        count = 0
        for way in left:
            if values[r, way] < level:
                fallen[way] = r
            else:
                left[count] = way
                count += 1
        left = left[:count]
    places, count = np.empty_like(directions), 0
    for n in range(len(directions)):
        if fallen[n] > start:
            _go(directions[n], reach[fallen[n]] - (reach[1] - reach[0]) / 2.0, places[count])
            count += 1
    return places[:count].copy()


@njit(cache=True, nogil=True)
def _look(
    center: FloatArray,
    directions: FloatArray,
    far: float,
    some: NDArray[np.intp],
    lookup: Lookup,
    values: FloatArray,
) -> None:
    """Fill ``values`` (N,) with what is seen so far from the center in ``some`` (M,) of the directions (N, 3)."""
    places, seen = np.empty((len(some), 3)), np.empty(len(some))
    for m in range(len(some)):
        _go(directions[some[m]], far, places[m])
    fill_nearest(center, places, *lookup, seen)
    for m in range(len(some)):
        values[some[m]] = seen[m]


@njit(cache=True, nogil=True)
def _go(direction: FloatArray, far: float, place: FloatArray) -> None:
    """Fill ``place`` (3,) with what lies so far in a direction (3,)."""
    for a in range(3):
        place[a] = far * direction[a]


@njit(cache=True, nogil=True)
def _off_sphere(points: FloatArray, center: FloatArray, radius: float) -> FloatArray:
    """Return how far each of the points (N, 3) lies from a sphere."""
    off = np.empty(len(points))
    for n in range(len(points)):
        x, y, z = points[n, 0] - center[0], points[n, 1] - center[1], points[n, 2] - center[2]
        off[n] = abs(math.sqrt(x * x + y * y + z * z) - radius)
    return off


@njit(cache=True, nogil=True)
def _sphere_through(points: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Return center and radius of the sphere through most points (N, 3), and how far off it each of them (N,) is.

    Least squares of |p|^2 = 2 c . p + r^2 - |c|^2, twice, the second time without what lies off the first sphere.
    """
    solved, radius, off, most = np.zeros(4), 0.0, np.zeros(len(points)), 0.0
    for _ in range(2):
        normal, row = np.zeros((4, 5)), np.ones(5)
        for n in range(len(points)):
            if off[n] <= most:
                x, y, z = points[n, 0], points[n, 1], points[n, 2]
                row[0], row[1], row[2], row[4] = 2.0 * x, 2.0 * y, 2.0 * z, x * x + y * y + z * z
                for a in range(4):
                    for b in range(5):
                        normal[a, b] += row[a] * row[b]
        solve(normal, solved)
        radius = math.sqrt(max(solved[3] + solved[0] ** 2 + solved[1] ** 2 + solved[2] ** 2, 1e-12))
        off = _off_sphere(points, solved, radius)
        most = 2.0 * quantile(off, 0.5)
    return solved[:3].copy(), radius, off
