"""The smooth surface behind a label's voxels, near one of them, and how far it is known.

A label tells of each voxel center only on which side of the surface it lies. In a window about one voxel a bent
quadric is fitted that leaves the centers on their sides. How far the surface may be elsewhere is asked of all bent
quadrics that leave them there, by linear programming about the fitted one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.grid import SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.planning.quadric import COEFFICIENTS, PARAMETERS, PRIOR, evaluate, fit
from ronnaplan.planning.segments import along_segments, point_distances

WINDOWS = (12.0, 8.0, 6.0)
"""Radii of the windows in voxels (of the mean of the three spacings): the first in which a surface is found counts."""

COVERED = 0.6
"""Share of the window's radius within which the fitted surface is used."""

BAND = 1.7
"""Centers within this many voxels of one on the other side tell where the surface is."""

BLUR = 0.03
"""Width of the probit in voxels: softens a center's side where no surface of the family does them all justice."""

WRONG = 0.02
"""A center may lie on the wrong side of the fit by this, in voxels; else the surface is no bent quadric."""

MARGIN = 0.05
"""Added to the doubt, in voxels: linear programming sees the first order, and a real vessel is bent otherwise too."""

KNOWN = 0.4
"""Where the place is known no better than to this, in voxels at their finest, there is no estimate."""

FEWEST = 30
"""A window with fewer centers next to the surface tells nothing."""

Has = Callable[[NDArray[np.intp]], NDArray[np.bool_]]
"""Tells of voxels (k, j, i) (..., 3) whether the label has them."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A piece of smooth surface: ``parameters`` (12,) along the rows of ``axes`` (3, 3) about ``center_mm`` (3,).

    ``cloud_mm`` (N, 3) are places on it, in the part of the window where it is used. ``rows`` (M, 12) and ``room``
    (M,) bound a change of the parameters that still leaves every center on its side: ``rows @ change <= room``.
    """

    center_mm: FloatArray
    axes: FloatArray
    scale_mm: float
    parameters: FloatArray
    voxel_mm: float
    finest_mm: float
    cloud_mm: FloatArray
    rows: FloatArray
    room: FloatArray

    @property
    def reach_mm(self) -> float:
        """Of label voxels within this of ``center_mm`` the surface next to them is known."""
        return COVERED * self.scale_mm - 2.0 * self.voxel_mm

    def at(self, places_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return signed distances (N,), derivatives by the parameters (N, 12) and outward normals (N, 3)."""
        local = (places_mm - self.center_mm) @ self.axes.T / self.scale_mm
        values, jacobian, normals = evaluate(self.parameters, local)
        return values * self.scale_mm, jacobian * self.scale_mm, normals @ self.axes

    def nearest(self, start: FloatArray, stop: FloatArray) -> tuple[float, float, float] | None:
        """Return a segment's distance, what it is at least, and at which share of it; ``start``, ``stop`` (3,), mm.

        None where the surface is not known well enough there.
        """
        place = self._nearest_place(start, stop)
        share = float(along_segments(place, start, stop))
        way = start + share * (stop - start) - place
        _, jacobian, normals = self.at(place[np.newaxis])
        doubt_mm = self._doubt_mm(jacobian[0]) + MARGIN * self.voxel_mm
        if doubt_mm > KNOWN * self.finest_mm:
            return None
        distance = float(np.linalg.norm(way)) if way @ normals[0] > 0 else 0.0
        return distance, max(distance - doubt_mm, 0.0), share

    def _doubt_mm(self, jacobian: FloatArray) -> float:
        """Return by how much the surface may be further out where its derivatives are ``jacobian`` (12,)."""
        from scipy.optimize import linprog

        found = linprog(jacobian / self.scale_mm, self.rows, self.room, bounds=(None, None), method="highs")
        return np.inf if found.fun is None else -float(found.fun) * self.scale_mm

    def _nearest_place(self, start: FloatArray, stop: FloatArray) -> FloatArray:
        """Return the place (3,) of the surface that is nearest to a segment: on finer and finer nets about it."""
        place: FloatArray = self.cloud_mm[point_distances(self.cloud_mm, start, stop).argmin()]
        across = np.stack(np.meshgrid(*[np.arange(-3.0, 4.0)] * 2), axis=-1).reshape(-1, 2)
        for step in (0.4, 0.12, 0.04):
            normal = self.at(place[np.newaxis])[2]
            net = self.project(place + step * self.voxel_mm * across @ np.linalg.svd(normal)[2][1:])
            place = net[point_distances(net, start, stop).argmin()]
        return place

    def project(self, places_mm: FloatArray) -> FloatArray:
        """Return the places (N, 3) of the surface below ``places_mm`` (N, 3), along its normals."""
        for _ in range(4):
            values, _, normals = self.at(places_mm)
            places_mm = places_mm - np.clip(values, -self.voxel_mm, self.voxel_mm)[:, np.newaxis] * normals
        return places_mm


def fit_patch(has: Has, grid: SliceGrid, shape: tuple[int, ...], voxel: NDArray[np.intp]) -> Patch | None:
    """Return the surface of a label on a ``grid`` of ``shape`` about one ``voxel`` of it; None where none can be told.

    That is so where the grid cuts the label, where the label is thin, where no bent quadric leaves the voxel
    centers on their sides (sharp or branching shapes), and where there are too few of them.
    """
    gap = grid.spacings_mm[min(voxel[0], len(grid.spacings_mm) - 1)]
    sizes = np.array([gap, grid.row_spacing_mm, grid.column_spacing_mm])
    voxel_mm, finest_mm = float(np.cbrt(sizes.prod())), float(sizes.min())
    for radius_mm in np.array(WINDOWS) * voxel_mm:
        window = _window(has, grid, shape, voxel, radius_mm)
        patch = window and _fit(window, radius_mm, voxel_mm, finest_mm)
        if patch:
            return patch
    return None


@dataclass(frozen=True, eq=False)
class _Window:
    """Voxel centers (N, 3) in a ball about one of them, and which of them are inside."""

    center_mm: FloatArray
    places_mm: FloatArray
    inside: NDArray[np.bool_]


def _window(
    has: Has, grid: SliceGrid, shape: tuple[int, ...], voxel: NDArray[np.intp], radius_mm: float
) -> _Window | None:
    """Return the centers about ``voxel``; None where the grid cuts the label or the label is thin.

    Other parts of the label than the one that holds ``voxel`` are left out: they are neither in nor out.
    """
    from scipy.ndimage import binary_erosion, label

    center = grid.positions_mm(voxel.astype(np.float64))
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    index = grid.indices(center + radius_mm * signs @ grid.axes)
    low = np.maximum(np.floor(index.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(index.max(axis=0)).astype(int) + 1, shape)
    cells = np.moveaxis(np.indices(tuple(high - low)), 0, -1) + low
    places, part = grid.positions_mm(cells.astype(np.float64)), has(cells)
    ball = np.linalg.norm(places - center, axis=-1) < radius_mm
    parts, _ = label(part & ball, structure=np.ones((3, 3, 3)))
    own = parts == parts[tuple(voxel - low)]
    edge = ((cells == 0) | (cells == np.array(shape) - 1)).any(axis=-1)
    if (own & edge).any() or not binary_erosion(own).any():
        return None
    used = ball & (own | ~part)
    return _Window(center, places[used], own[used])


def _fit(window: _Window, radius_mm: float, voxel_mm: float, finest_mm: float) -> Patch | None:
    depth = _depths(window, BAND * voxel_mm)
    near = np.isfinite(depth)
    if near.sum() < FEWEST:
        return None
    places, sides = window.places_mm[near], np.sign(depth[near])
    local = (places - window.center_mm) / radius_mm
    guess = (depth[near] - sides * voxel_mm / 2) / radius_mm
    axes, parameters = fit(local, sides, guess, BLUR * voxel_mm / radius_mm)
    values, jacobian, _ = evaluate(parameters, local @ axes.T)
    if (sides * values).min() * radius_mm < -WRONG * voxel_mm:
        return None
    close = sides * values * radius_mm < KNOWN * voxel_mm  # others would bind a surface not known well enough
    bounds = _bounds(parameters, sides[close], values[close], jacobian[close])
    patch = Patch(window.center_mm, axes, radius_mm, parameters, voxel_mm, finest_mm, places, *bounds)
    cloud = patch.project(places)
    on = np.abs(patch.at(cloud)[0]) < 0.02 * voxel_mm
    on &= np.linalg.norm(cloud - places, axis=1) < 2.0 * voxel_mm
    on &= np.linalg.norm(cloud - window.center_mm, axis=1) < COVERED * radius_mm
    return replace(patch, cloud_mm=cloud[on]) if on.any() else None


def _depths(window: _Window, most_mm: float) -> FloatArray:
    """Return the distance (N,) of each center to the nearest one on the other side, negative inside.

    Infinite beyond ``most_mm``.
    """
    from scipy.spatial import cKDTree

    places, inside = window.places_mm, window.inside
    depth = np.full(len(inside), np.inf)
    if not inside.all():
        inner, outer = cKDTree(places[inside]), cKDTree(places[~inside])
        depth[inside] = -outer.query(places[inside], distance_upper_bound=most_mm)[0]
        depth[~inside] = inner.query(places[~inside], distance_upper_bound=most_mm)[0]
    return depth


def _bounds(
    parameters: FloatArray, sides: FloatArray, values: FloatArray, jacobian: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``rows @ change <= room``: all centers stay on their sides, no parameter leaves three usual sizes.

    A center that is on the wrong side already may stay where it is. The polynomial's scale, which means nothing,
    is kept.
    """
    usual = np.eye(PARAMETERS) / PRIOR[:, np.newaxis]
    scale = np.concatenate([parameters[COEFFICIENTS], [0.0, 0.0]])
    rows = np.concatenate([-sides[:, np.newaxis] * jacobian, usual, -usual, [scale, -scale]])
    slack = 1e-6
    room = np.concatenate(
        [
            np.maximum(sides * values, 0.0) + slack,
            np.maximum(3.0 - parameters / PRIOR, 0.0),
            np.maximum(3.0 + parameters / PRIOR, 0.0),
            [slack, slack],
        ]
    )
    return rows, room
