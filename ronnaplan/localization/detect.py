"""Where a ball of the given size may be: edges of a coarse copy of the scan vote for centers.

A voxel on the surface of a bright ball has a gradient that points at the ball's center, one radius away. Every
edge voxel therefore votes for the point one radius up its gradient (the spherical Hough transform by gradient
direction, after Kimme, Ballard & Sklansky, Comm. ACM 18:120, 1975); a ball collects the votes of its whole
surface in one place, whatever its contrast and whatever touches it. Gradients are taken between the voxels' true
places, so tilted and uneven slices vote as straight as any.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.ct.grid import SliceGrid
from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.coarse import COARSE_SHARE, Voxels, averaged, blocks, coarse_grid, coarse_voxel_mm
from ronnaplan.localization.parts import in_parts

VOTE_CELLS_PER_DIAMETER = 6
"""Votes are counted in cells of this share of the diameter, but never smaller than a pixel."""

MIN_CONTRAST_HU = 300.0
"""Faintest ball that is looked for, against its surroundings (plastic in air shows about 1,100 HU)."""

SLAB_SLICES = 32
"""So many slices of the coarse copy vote at a time; there never is more of it."""

MIN_VOTE_SHARE = 0.3
"""A candidate has at least this share of the votes of a complete, isolated ball of its size."""

ALMOST = 0.999
"""Gradients are first taken in single precision, which tells all but those within this of the threshold."""


@dataclass(frozen=True)
class Candidates:
    """Places worth a fit: ``centers_mm`` (N, 3) in LPS, strongest first, with their share of a ball's votes."""

    centers_mm: FloatArray
    vote_shares: FloatArray


def detect(volume: CTVolume, diameter_mm: float, coarse_share: float = COARSE_SHARE) -> Candidates:
    """Find the places where the scan's edges agree on a ball of ``diameter_mm``.

    They are looked for in a copy whose voxels are at most ``coarse_share`` of it, of which there is only a part at a
    time.
    """
    by = blocks(volume, coarse_voxel_mm(diameter_mm, coarse_share))
    return _search(coarse_grid(volume, by), lambda first, end: averaged(volume, by, first, end), diameter_mm)


def detect_in(coarse: CTVolume, diameter_mm: float) -> Candidates:
    """Find the places where the edges of a ``coarse`` copy agree on a ball of ``diameter_mm``."""
    return _search(coarse.grid, lambda first, end: coarse.voxels_hu[first:end], diameter_mm)


def _search(grid: SliceGrid, slab: Callable[[int, int], Voxels], diameter_mm: float) -> Candidates:
    """Find balls in a copy on ``grid``, of which ``slab`` gives the slices from the first to before the end."""
    axes = grid.axes
    origins = grid.origins_mm @ axes.T
    steps = np.array([grid.column_spacing_mm, grid.row_spacing_mm])
    cell_mm = max(diameter_mm / VOTE_CELLS_PER_DIAMETER, float(steps.min()))
    rows, columns = slab(0, 1).shape[1:]
    extent = np.array([steps[0] * (columns - 1), steps[1] * (rows - 1), 0.0])
    corner = origins.min(axis=0) - cell_mm
    shape = np.ceil((origins.max(axis=0) + extent - corner) / cell_mm).astype(int) + 2
    edge_mm = float(np.mean([*steps, grid.typical_gap_mm]))
    votes = np.zeros(shape[::-1], dtype=np.uint16)
    threshold = MIN_CONTRAST_HU / (4.0 * edge_mm)
    for first in range(0, max(len(origins) - 2, 0), SLAB_SLICES):
        part = slice(first, min(first + SLAB_SLICES + 2, len(origins)))
        edges = slab(part.start, part.stop), origins[part], steps, diameter_mm / 2.0, threshold
        _share_votes(edges, corner, cell_mm, votes)
    surface_voxels = np.pi * diameter_mm**2 * 2.0 * edge_mm / (steps.prod() * grid.typical_gap_mm)
    centers, shares = _peaks(votes, float(surface_voxels))
    return Candidates((corner + centers * cell_mm) @ axes, shares)


Edges = tuple[Voxels, FloatArray, FloatArray, float, float]
"""A slab's voxels, its slices' origins (K, 3) along u, v, w, the distances of columns and rows, the radius of the
balls, and the gradient (HU/mm) from which on a voxel votes."""


def _share_votes(edges: Edges, corner: FloatArray, cell_mm: float, votes: NDArray[np.uint16]) -> None:
    """Count the votes of one slab's edges, in threads that have layers of cells of their own."""
    _, origins, _, radius_mm, _ = edges
    reached = (np.array([origins[:, 2].min() - radius_mm, origins[:, 2].max() + radius_mm]) - corner[2]) / cell_mm
    low, high = np.clip([int(reached[0]) - 1, int(reached[1]) + 2], 0, len(votes)).tolist()
    in_parts(lambda first, end: _vote(*edges, corner, cell_mm, votes, low + first, low + end), high - low)


@njit(cache=True, nogil=True, error_model="numpy")
def _vote(
    voxels: Voxels,
    origins: FloatArray,
    steps: FloatArray,
    radius: float,
    threshold: float,
    corner: FloatArray,
    cell: float,
    votes: NDArray[np.uint16],
    first: int,
    end: int,
) -> None:
    """Let each voxel whose gradient exceeds ``threshold`` (HU/mm) vote one radius up its gradient.

    Only the votes for the layers ``first`` to ``end`` of cells are counted.
    """
    slices, rows, columns = voxels.shape
    per_u, per_v, least = 0.5 / steps[0], 0.5 / steps[1], threshold * threshold
    squares = np.empty(columns, dtype=np.float32)
    lowest, highest = corner[2] + (first - 1) * cell - radius, corner[2] + end * cell + radius
    for k in range(1, slices - 1):
        if not lowest <= origins[k, 2] <= highest:
            continue
        slant = origins[k + 1] - origins[k - 1]
        slant_u, slant_v, per_w = slant[0], slant[1], 1.0 / slant[2]
        for j in range(1, rows - 1):
            _square_gradients(voxels, k, j, per_u, per_v, per_w, slant_u, slant_v, squares)
            for i in range(1, columns - 1):
                if squares[i] < ALMOST * least:
                    continue
                gu = per_u * (float(voxels[k, j, i + 1]) - float(voxels[k, j, i - 1]))
                gv = per_v * (float(voxels[k, j + 1, i]) - float(voxels[k, j - 1, i]))
                rise = float(voxels[k + 1, j, i]) - float(voxels[k - 1, j, i])
                gw = per_w * (rise - gu * slant_u - gv * slant_v)
                square = gu * gu + gv * gv + gw * gw
                if square < least:
                    continue
                reach = radius / np.sqrt(square)
                x = int((origins[k, 0] + i * steps[0] + reach * gu - corner[0]) / cell + 0.5)
                y = int((origins[k, 1] + j * steps[1] + reach * gv - corner[1]) / cell + 0.5)
                z = int((origins[k, 2] + reach * gw - corner[2]) / cell + 0.5)
                if first <= z < end and 0 <= y < votes.shape[1] and 0 <= x < votes.shape[2]:
                    votes[z, y, x] += 1


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _square_gradients(
    voxels: Voxels,
    k: int,
    j: int,
    per_u: float,
    per_v: float,
    per_w: float,
    slant_u: float,
    slant_v: float,
    squares: NDArray[np.float32],
) -> None:
    """Fill ``squares`` with the squared gradients of a row, many at once and nearly exactly."""
    row, above, below = voxels[k, j], voxels[k, j - 1], voxels[k, j + 1]
    before, behind = voxels[k - 1, j], voxels[k + 1, j]
    u, v, w = np.float32(per_u), np.float32(per_v), np.float32(per_w)
    su, sv = np.float32(slant_u), np.float32(slant_v)
    for i in range(1, len(row) - 1):
        gu = u * (np.float32(row[i + 1]) - np.float32(row[i - 1]))
        gv = v * (np.float32(below[i]) - np.float32(above[i]))
        gw = w * ((np.float32(behind[i]) - np.float32(before[i])) - gu * su - gv * sv)
        squares[i] = gu * gu + gv * gv + gw * gw


def _peaks(votes: NDArray[np.uint16], full_count: float) -> tuple[FloatArray, FloatArray]:
    """Local maxima of the votes gathered over 3 x 3 x 3 cells: cell coordinates (N, 3) = (x, y, z), and shares."""
    parts = in_parts(lambda first, end: _gather_peaks(votes, MIN_VOTE_SHARE * full_count, first, end), len(votes))
    places, strength, centers = (np.concatenate(some) for some in zip(*parts, strict=True))
    best = np.lexsort((*places.T, -strength))
    return centers[best], strength[best] / full_count


@njit(cache=True, nogil=True)
def _gather_peaks(
    votes: NDArray[np.uint16], threshold: float, first: int, end: int
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Cells (N, 3) = (z, y, x) whose 3 x 3 x 3 sum is a local maximum, that sum (N,), and its centroid (x, y, z).

    Of the layers ``first`` to ``end``.
    """
    places = []
    strengths = []
    centers = []
    depth, height, width = votes.shape
    sums = np.empty((3, height, width), dtype=np.int32)  # of three layers, each at its number modulo 3
    begin = max(first, 1)
    if begin < min(end, depth - 1):
        _sum_layer(votes, begin - 1, sums)
        _sum_layer(votes, begin, sums)
    for z in range(begin, min(end, depth - 1)):
        _sum_layer(votes, z + 1, sums)
        for y in range(1, height - 1):
            for x in range(1, width - 1):
                total = sums[z % 3, y, x]
                if total < threshold or not _is_peak(sums, z, y, x):
                    continue
                places.append((z, y, x))
                strengths.append(float(total))
                centers.append(_centroid(votes, z, y, x, float(total)))
    count = len(places)
    place_array = np.empty((count, 3), dtype=np.int64)
    center_array = np.empty((count, 3))
    strength_array = np.empty(count)
    for n in range(count):
        strength_array[n] = strengths[n]
        for axis in range(3):
            place_array[n, axis] = places[n][axis]
            center_array[n, axis] = centers[n][axis]
    return place_array, strength_array, center_array


@njit(cache=True, nogil=True)
def _sum_layer(votes: NDArray[np.uint16], z: int, sums: NDArray[np.int32]) -> None:
    """Fill the layer of ``sums`` with the votes in the 3 x 3 x 3 cells about each cell of layer ``z``.

    Of a cell that nobody voted for 0 is told: between two slices' votes it would gather most, and nobody be the peak.
    """
    depth, height, width = votes.shape
    across = np.empty(width, dtype=np.int32)
    for y in range(height):
        if not votes[z, y].any():
            sums[z % 3, y] = 0
            continue
        across[:] = 0
        for c in range(max(z - 1, 0), min(z + 2, depth)):
            for b in range(max(y - 1, 0), min(y + 2, height)):
                row = votes[c, b]
                for x in range(width):
                    across[x] += row[x]
        into = sums[z % 3, y]
        into[0], into[width - 1] = across[0] + across[1], across[width - 2] + across[width - 1]
        for x in range(1, width - 1):
            into[x] = across[x - 1] + across[x] + across[x + 1]
        for x in range(width):
            into[x] *= votes[z, y, x] != 0


@njit(cache=True, nogil=True)
def _is_peak(sums: NDArray[np.int32], z: int, y: int, x: int) -> bool:
    """Whether no neighbouring cell that was voted for gathers more (of equal ones, the first counts)."""
    total = sums[z % 3, y, x]
    for c in range(z - 1, z + 2):
        for b in range(y - 1, y + 2):
            for a in range(x - 1, x + 2):
                other = sums[c % 3, b, a]
                if other > total or (other == total and (c, b, a) < (z, y, x)):
                    return False
    return True


@njit(cache=True)
def _centroid(votes: NDArray[np.uint16], z: int, y: int, x: int, total: float) -> tuple[float, float, float]:
    sums = np.zeros(3)
    for c in range(z - 1, z + 2):
        for b in range(y - 1, y + 2):
            for a in range(x - 1, x + 2):
                sums[0] += a * float(votes[c, b, a])
                sums[1] += b * float(votes[c, b, a])
                sums[2] += c * float(votes[c, b, a])
    return sums[0] / total, sums[1] / total, sums[2] / total
