"""The smooth surface behind a label's voxels, near one of them, and how far it is known.

A label tells of each voxel centre only on which side of the surface it lies. In a window about one voxel a bent
quadric is fitted that leaves the centres on their sides (a probit fit; Taubin's distance). How far the surface may
be elsewhere is asked of all bent quadrics that leave them there, by linear programming about the fitted one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.volume import SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.planning.quadric import PARAMETERS, evaluate, monomials, unlikelihood
from ronnaplan.planning.segments import along_segments

WINDOWS = (8.0, 6.0)
"""Radii of the window that are tried, in voxels (of the mean of the three spacings)."""

COVERED = 0.6
"""Share of the window's radius within which the fitted surface is used."""

BLUR = 0.2
"""Width of the probit in voxels: softens a centre's side where no surface of the family does them all justice."""

WRONG = 0.2
"""A centre may lie on the wrong side of the fit by this, in voxels; else the surface is no bent quadric."""

KNOWN = 0.4
"""Where the place is known no better than to this, in voxels at their finest, there is no estimate."""

PRIOR = np.array([100.0] * 4 + [5.0] * 6 + [0.25] * 2)
"""Usual size of the parameters; lengths in units of the window's radius."""

FEWEST = 30
"""A window with fewer centres next to the surface tells nothing."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A piece of smooth surface: ``parameters`` (12,) along the rows of ``axes`` (3, 3) about ``centre_mm`` (3,).

    ``cloud_mm`` (N, 3) are places on it, in the part of the window where it is used. ``rows`` (M, 12) and ``room``
    (M,) bound a change of the parameters that still leaves every centre on its side: ``rows @ change <= room``.
    """

    centre_mm: FloatArray
    axes: FloatArray
    scale_mm: float
    parameters: FloatArray
    voxel_mm: float
    finest_mm: float
    cloud_mm: FloatArray
    rows: FloatArray
    room: FloatArray

    def at(self, places_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return signed distances (N,), derivatives by the parameters (N, 12) and outward normals (N, 3)."""
        local = (places_mm - self.centre_mm) @ self.axes.T / self.scale_mm
        values, jacobian, normals = evaluate(self.parameters, local)
        return values * self.scale_mm, jacobian * self.scale_mm, normals @ self.axes

    def nearest(self, start: FloatArray, stop: FloatArray) -> tuple[float, float, float] | None:
        """Return a segment's distance, what it is at least, and the share of the segment where it is nearest.

        None where the surface is not known well enough there.
        """
        place = self._nearest_place(start, stop)
        share = float(along_segments(place, start, stop))
        way = start + share * (stop - start) - place
        _, jacobian, normals = self.at(place[np.newaxis])
        doubt_mm = self._doubt_mm(jacobian[0])
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
        """Return the place (3,) of the surface that is nearest to a segment: Newton's method from the cloud."""
        place: FloatArray = self.cloud_mm[_to_segment(self.cloud_mm, start, stop).argmin()]
        step = 0.2 * self.voxel_mm
        for _ in range(8):
            normal = self.at(place[np.newaxis])[2][0]
            tangents = np.linalg.svd(normal[np.newaxis])[2][1:]
            around = step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1]])
            here, east, west, north, south, both, none = _to_segment(
                self.project(place + around @ tangents), start, stop
            )
            slope = np.array([east - west, north - south]) / (2 * step)
            mixed = (both + none - east - west - north - south + 2 * here) / 2
            curvature = np.array([[east + west - 2 * here, mixed], [mixed, north + south - 2 * here]]) / step**2
            sizes, ways = np.linalg.eigh(curvature)
            move = -ways @ (ways.T @ slope / np.maximum(np.abs(sizes), 0.01))
            move *= min(1.0, self.voxel_mm / max(float(np.linalg.norm(move)), 1e-12))
            moved = self.project((place + move @ tangents)[np.newaxis])
            if _to_segment(moved, start, stop)[0] >= here - 1e-6:
                break
            place = moved[0]
        return place

    def project(self, places_mm: FloatArray) -> FloatArray:
        """Return the places (N, 3) of the surface below ``places_mm`` (N, 3), along its normals."""
        for _ in range(5):
            values, _, normals = self.at(places_mm)
            places_mm = places_mm - np.clip(values, -self.voxel_mm, self.voxel_mm)[:, np.newaxis] * normals
        return places_mm


Has = Callable[[NDArray[np.intp]], NDArray[np.bool_]]
"""Tells of voxels (k, j, i) (..., 3) whether the label has them."""


def fit_patch(has: Has, grid: SliceGrid, shape: tuple[int, ...], voxel: tuple[int, ...]) -> Patch | None:
    """Return the surface of a label on a ``grid`` of ``shape`` about a ``voxel`` of it; None where none can be told.

    That is so where the grid cuts the label, where no bent quadric leaves the voxel centres on their sides (sharp
    or branching shapes), and where there are too few of them.
    """
    gap = grid.spacings_mm[max(min(voxel[0], len(grid.spacings_mm) - 1), 0)]
    sizes = np.array([gap, grid.row_spacing_mm, grid.column_spacing_mm])
    voxel_mm, finest_mm = float(np.cbrt(sizes.prod())), float(sizes.min())
    for window in WINDOWS:
        found = _window(has, grid, shape, voxel, window * voxel_mm)
        if found is None:
            continue
        patch = _fit(*found, grid.positions_mm(np.array(voxel, dtype=np.float64)), window * voxel_mm, voxel_mm)
        if patch is not None:
            return replace(patch, finest_mm=finest_mm)
    return None


def _window(
    has: Has, grid: SliceGrid, shape: tuple[int, ...], voxel: tuple[int, ...], radius_mm: float
) -> tuple[FloatArray, NDArray[np.bool_]] | None:
    """Return the voxel centres (N, 3) in a ball and which of them are inside; None where the grid cuts the label.

    Other parts of the label than the one that holds ``voxel`` are left out: they are neither in nor out.
    """
    from scipy.ndimage import label

    centre = grid.positions_mm(np.array(voxel, dtype=np.float64))
    corners = (
        radius_mm * np.sqrt(3.0) * np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), -1).reshape(-1, 3)
    )
    index = grid.indices(centre + corners)
    low = np.clip(np.floor(index.min(axis=0)).astype(int), 0, None)
    high = np.minimum(np.ceil(index.max(axis=0)).astype(int) + 1, shape)
    cells = np.moveaxis(np.indices(tuple(high - low)), 0, -1) + low
    part = has(cells)
    places = grid.positions_mm(cells.astype(np.float64))
    ball = np.linalg.norm(places - centre, axis=-1) < radius_mm
    parts, _ = label(part & ball, structure=np.ones((3, 3, 3)))
    own = parts == parts[tuple(np.array(voxel) - low)]
    edge = ((cells == 0) | (cells == np.array(shape) - 1)).any(axis=-1)
    if (own & edge).any():
        return None
    used = ball & (own | ~part)
    return places[used], own[used]


def _fit(
    places_mm: FloatArray, inside: NDArray[np.bool_], centre_mm: FloatArray, radius_mm: float, voxel_mm: float
) -> Patch | None:
    from scipy.spatial import cKDTree

    if not 0 < inside.sum() < len(inside):
        return None
    depth = np.where(inside, -1.0, 1.0)
    depth[inside] *= cKDTree(places_mm[~inside]).query(places_mm[inside])[0]
    depth[~inside] *= cKDTree(places_mm[inside]).query(places_mm[~inside])[0]
    near = np.abs(depth) < 1.7 * voxel_mm
    if near.sum() < FEWEST:
        return None
    guess = (depth[near] - np.sign(depth[near]) * voxel_mm / 2) / radius_mm
    sides = np.sign(depth[near])
    local = (places_mm[near] - centre_mm) / radius_mm
    axes = _axes(_quadric(local, guess))
    local = local @ axes.T
    first = np.concatenate([_quadric(local, guess), [0.0, 0.0]])
    parameters = _solve(first, local, sides, BLUR * voxel_mm / radius_mm)
    values, jacobian, _ = evaluate(parameters, local)
    if (sides * values).min() * radius_mm < -WRONG * voxel_mm:
        return None
    rows, room = _bounds(parameters, sides, values, jacobian)
    patch = Patch(centre_mm, axes, radius_mm, parameters, voxel_mm, voxel_mm, places_mm[near], rows, room)
    cloud = patch.project(places_mm[near])
    on = np.abs(patch.at(cloud)[0]) < 0.02 * voxel_mm
    on &= np.linalg.norm(cloud - places_mm[near], axis=1) < 2.0 * voxel_mm
    on &= np.linalg.norm(cloud - centre_mm, axis=1) < COVERED * radius_mm
    if not on.any():
        return None
    return replace(patch, cloud_mm=cloud[on])


def _axes(quadric: FloatArray) -> FloatArray:
    """Return rows x, y, z with z along the axis of a quadric (10,): where it is curved least."""
    _, _, _, _, xx, yy, zz, xy, xz, yz = quadric
    sizes, ways = np.linalg.eigh(np.array([[2 * xx, xy, xz], [xy, 2 * yy, yz], [xz, yz, 2 * zz]]))
    least = int(np.abs(sizes).argmin())
    axes: FloatArray = ways.T[[(least + 1) % 3, (least + 2) % 3, least]]
    return axes


def _quadric(local: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the polynomial (10,) that comes nearest to ``distances`` (N,) at ``local`` (N, 3)."""
    found = np.linalg.lstsq(np.column_stack(monomials(*local.T)), distances, rcond=None)[0]
    return np.asarray(found, dtype=np.float64)


def _solve(parameters: FloatArray, local: FloatArray, sides: FloatArray, blur: float) -> FloatArray:
    """Return the most probable parameters (12,): Newton's method with Levenberg's damping."""

    def cost(tried: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        values, jacobian, _ = evaluate(tried, local)
        unlikely, slopes, weights = unlikelihood(values, sides, blur)
        gradient = jacobian.T @ slopes + tried / PRIOR**2
        hessian = (jacobian * weights[:, np.newaxis]).T @ jacobian + np.diag(PRIOR**-2)
        return unlikely + 0.5 * float(((tried / PRIOR) ** 2).sum()), gradient, hessian

    least, gradient, hessian = cost(parameters)
    damping = 1e-3
    for _ in range(100):
        tried = parameters - np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
        now, *there = cost(tried)
        if now >= least:
            damping *= 5.0
            if damping > 1e6:
                break
            continue
        gained, least, parameters, (gradient, hessian) = least - now, now, tried, there
        damping = max(damping / 5.0, 1e-7)
        if gained < 1e-3:
            break
    return parameters


def _bounds(
    parameters: FloatArray, sides: FloatArray, values: FloatArray, jacobian: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``rows @ change <= room``: all centres stay on their sides, no parameter leaves three usual sizes.

    A centre that is on the wrong side already may stay where it is. The polynomial's scale, which means nothing,
    is kept.
    """
    usual = np.eye(PARAMETERS) / PRIOR[:, np.newaxis]
    scale = np.concatenate([parameters[:10], [0.0, 0.0]])
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


def _to_segment(places_mm: FloatArray, start: FloatArray, stop: FloatArray) -> FloatArray:
    nearest = start + along_segments(places_mm, start, stop)[:, np.newaxis] * (stop - start)
    distances: FloatArray = np.linalg.norm(places_mm - nearest, axis=1)
    return distances
