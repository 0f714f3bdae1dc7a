"""The sphere on which the image falls off around a place, found from nearest voxels in all directions."""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.cells import cell_directions
from ronnaplan.localization.look import Lookup, fill_nearest, lookup_of
from ronnaplan.localization.parts import in_parts

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

SURROUNDINGS_SHARE = 0.3
"""The surroundings' level is what this share of the directions reach at most."""


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
        _look(found[first:end], directions, build.wall_mm > 0.0, voxel_mm, lookup)

    in_parts(look, len(found))
    return found[:, :3] @ axes, found[:, 3], found[:, 4]


@njit(cache=True, nogil=True)
def _look(found: FloatArray, directions: FloatArray, is_hollow: bool, voxel_mm: float, lookup: Lookup) -> None:
    """Turn places and diameters (N, 5) along u, v, w into spheres, each with its share of the surface or 0."""
    for n in range(len(found)):
        center, diameter = found[n, :3].copy(), found[n, 3]
        falls = np.empty((0, 3))
        is_one = True
        for _ in range(2):  # the second time from the sphere's own center
            falls = _falls(center, diameter / 2.0, directions, is_hollow, lookup)
            is_one = len(falls) >= LEAST_SHOWN * len(directions)
            if not is_one:
                break
            aside, radius = _sphere_through(falls)
            is_one = SAME_RATIO[0] < 2.0 * radius / diameter < SAME_RATIO[1]
            if not is_one:
                break
            falls -= aside
            center, diameter = center + aside, 2.0 * radius
        if not is_one:
            continue
        near_mm = max(NEAR_SHARE * diameter / 2.0, NEAR_VOXELS * voxel_mm)
        off_mm = np.abs(np.sqrt((falls**2).sum(axis=1)) - diameter / 2.0)
        share = np.sum(off_mm <= near_mm) / len(directions)
        if share >= LEAST_ROUND:
            found[n, :3], found[n, 3], found[n, 4] = center, diameter, share


@njit(cache=True, nogil=True)
def _falls(
    center: FloatArray, radius: float, directions: FloatArray, is_hollow: bool, lookup: Lookup
) -> FloatArray:
    """Return, from the center, the places (N, 3) at which the image first falls to half its step, where it does."""
    reach = np.linspace(0.3, 1.8, BALL_RADII) * radius
    values = np.empty((BALL_RADII, len(directions)))
    for r in range(BALL_RADII):
        fill_nearest(center, reach[r] * directions, *lookup, values[r])
    start = 0
    if is_hollow:  # what is hollow is dark within
        usual = np.array([_quantile(values[r], 0.5) for r in range(BALL_RADII)])
        start = int(np.argmax(np.where(np.isnan(usual), -np.inf, usual)))
    level = (_quantile(values[start], 0.5) + _quantile(values[-1], SURROUNDINGS_SHARE)) / 2.0
    falls, count = np.empty_like(directions), 0
    for n in range(len(directions)):
        first = start
        while first < BALL_RADII and not values[first, n] < level:
            first += 1
        if start < first < BALL_RADII:
            falls[count] = (reach[first] - (reach[1] - reach[0]) / 2.0) * directions[n]
            count += 1
    return falls[:count].copy()


@njit(cache=True, nogil=True)
def _quantile(values: FloatArray, share: float) -> float:
    """What this ``share`` of the known values (N,) reach at most; NaN where none is known."""
    known = np.sort(values[~np.isnan(values)])
    if len(known) == 0:
        return math.nan
    place = share * (len(known) - 1)
    below = int(place)
    return float(known[below] + (place - below) * (known[min(below + 1, len(known) - 1)] - known[below]))


@njit(cache=True, nogil=True)
def _sphere_through(points: FloatArray) -> tuple[FloatArray, float]:
    """Return center and radius of the sphere through most points (N, 3).

    Least squares of |p|^2 = 2 c . p + r^2 - |c|^2, twice, the second time without what lies off the first sphere.
    """
    used, center, radius = points, np.zeros(3), 0.0
    for _ in range(2):
        design = np.ones((len(used), 4))
        design[:, :3] = 2.0 * used
        solved = np.linalg.lstsq(design, (used**2).sum(axis=1))[0]
        center, radius = solved[:3], math.sqrt(max(solved[3] + (solved[:3] ** 2).sum(), 1e-12))
        off = np.abs(np.sqrt(((points - center) ** 2).sum(axis=1)) - radius)
        used = points[off <= 2.0 * np.median(off)]
    return center, radius
