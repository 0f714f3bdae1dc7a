"""The ellipsoid at a place, whatever it is: along each direction its edge is where the image falls to half its level.

Of a ball whose voxels are not where their header puts them this tells what a fitted ball cannot: along which of the
grid's axes it is too long, or how far it leans.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.sampling import sampled
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.cells import BACKGROUND_QUANTILE, CELL_COUNT, cell_directions
from ronnaplan.localization.scanner.scan import Scan

REACH, STEP = 2.6, 0.1
"""Edges are looked for as far as so many radii, in such steps."""

INNER, OUTER, LEVEL_SHARE = 0.3, 0.7, 0.25
"""The level is what this share of what lies between so many radii reaches at most: in the middle may be an insert, and
its blur, and of a ball that seems flat to the half little of this lies outside."""

CLIPPED_SHARE = 0.7
"""Where the scale clips an ellipsoid, half of its level is at about this share of what is seen of it: balls of ceramic
and of metal are brighter than the scale's end by 1.1 to 2.5 times."""

CENTERINGS, CENTERED, TRIMMINGS = 3, 0.02, 6
"""So often a center is told anew, unless it stays within this share of the radius, and what does not lie on the
ellipsoid left out each time: posts, what stands by."""

OFF_RATIO, OFF_SHARE = 2.0, 0.02
"""An edge is left out that lies off by more than so many times the median, and than this share of the ellipsoid."""

LEAST_SHARE, MOST_OFF = 0.6, 0.04
"""An ellipsoid is what shows its edge in this share of the directions, off by no more (RMS) than this share of it."""

LOOSE_VOXELS, LOOSE_CLIPPED_MM = 0.3, 0.3
"""A blur of another width along each axis makes a sphere longer along one of them by less than so many squares of the
widest voxel's share of the radius; what the scale clips by so much besides, as nobody knows where half its level is."""


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid about ``center_mm`` (3,) in LPS: of a ball of radius r that was mapped by M ``shape`` is M M^T.

    ``shape`` (3, 3) is along u, v and w, its square roots the semi-axes as shares of the radius that was looked for.
    They are told to the share ``loose``.
    """

    center_mm: FloatArray
    shape: FloatArray
    loose: float


def ellipsoid_at(scan: Scan, place_mm: FloatArray, radius_mm: float) -> Ellipsoid | None:
    """Return the ellipsoid about a place (3,) in LPS, of about this radius; None where there is none."""
    center_mm, grid = place_mm, scan.volume.grid
    shape, is_clipped = np.eye(3), False
    for _ in range(CENTERINGS):
        reaches, is_clipped = _reaches(scan, center_mm, radius_mm)
        seen = np.isfinite(reaches)
        fitted = _through(reaches[seen, np.newaxis] * cell_directions()[seen])
        if fitted is None:
            return None
        moved, shape = fitted
        center_mm = center_mm + radius_mm * moved @ grid.axes
        if np.linalg.norm(moved) < CENTERED:
            break
    height_mm = radius_mm * float(np.sqrt(shape[2, 2]))
    if not is_clipped:
        # Half of the level lies farther in by half of the variance across over the radius (the equation of heat): here
        # that of slices which touch, and of straight lines between them.
        wider = np.exp([grid.typical_gap_mm**2 / (8.0 * height_mm**2)] * 2 + [0.0])
        shape = wider[:, np.newaxis] * shape * wider
    voxel = max(grid.pixel_mm / radius_mm, grid.typical_gap_mm / height_mm)
    return Ellipsoid(center_mm, shape, LOOSE_VOXELS * voxel**2 + is_clipped * LOOSE_CLIPPED_MM / radius_mm)


def _reaches(scan: Scan, center_mm: FloatArray, radius_mm: float) -> tuple[FloatArray, bool]:
    """How far (cells,) the edge is from a center (3,) along each direction, in radii, and whether the scale clips it.

    NaN where no edge is seen.
    """
    volume, along = scan.volume, np.arange(0.0, REACH, STEP)
    steps_mm = radius_mm * along[:, np.newaxis] * (cell_directions() @ volume.grid.axes)[:, np.newaxis]
    values_hu = sampled(volume.voxels_hu, volume.grid.indices(center_mm + steps_mm), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # beyond the scan nothing is seen
        level_hu = np.nanquantile(values_hu[:, (along >= INNER) & (along <= OUTER)], LEVEL_SHARE)
        around_hu = np.nanquantile(np.nanmin(values_hu, axis=1), BACKGROUND_QUANTILE)
    is_clipped = bool(level_hu >= scan.ceiling_hu)
    edge_hu = around_hu + (CLIPPED_SHARE if is_clipped else 0.5) * (level_hu - around_hu)
    is_below = (values_hu < edge_hu) & (along >= INNER)
    first = is_below.argmax(axis=1)
    cells = np.arange(CELL_COUNT)
    before_hu, behind_hu = values_hu[cells, first - 1], values_hu[cells, first]
    with np.errstate(divide="ignore", invalid="ignore"):
        reaches = along[first] - STEP * (edge_hu - behind_hu) / (before_hu - behind_hu)
    return np.where(first > 0, reaches, np.nan), is_clipped


def _through(places: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return center (3,) and shape (3, 3) of the ellipsoid through most of the ``places`` (N, 3), if there is one."""
    if len(places) < LEAST_SHARE * CELL_COUNT:
        return None
    kept: NDArray[np.bool_] = np.ones(len(places), dtype=np.bool_)
    center: FloatArray = np.zeros(3)
    shape: FloatArray = np.eye(3)
    off: FloatArray = np.zeros(len(places))
    for _ in range(TRIMMINGS):
        try:
            center, inverse = _quadric(places[kept])
        except np.linalg.LinAlgError:
            return None
        if np.linalg.eigvalsh(inverse)[0] <= 0.0:
            return None
        apart = places - center
        off = np.abs(np.sqrt(np.einsum("ni,ij,nj->n", apart, inverse, apart)) - 1.0)
        kept = off <= max(OFF_RATIO * float(np.median(off)), OFF_SHARE)
        shape = np.asarray(np.linalg.inv(inverse))
    is_one = kept.sum() >= LEAST_SHARE * CELL_COUNT and np.sqrt(np.mean(off[kept] ** 2)) <= MOST_OFF
    return (center, shape) if is_one else None


def _quadric(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return center (3,) and matrix (3, 3) of the quadric (x - c)^T A (x - c) = 1 nearest to the ``places`` (N, 3)."""
    x, y, z = places.T
    terms = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=1)
    xx, yy, zz, xy, xz, yz, *linear = np.linalg.lstsq(terms, np.ones(len(places)), rcond=None)[0]
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    center = -np.linalg.solve(matrix, np.array(linear))
    return center, matrix / (1.0 + center @ matrix @ center)
