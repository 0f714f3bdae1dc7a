"""Where a ball of the given size may be: edges of a coarse copy of the scan vote for centers.

A voxel on the surface of a bright ball has a gradient that points at the ball's center, one radius away. Every
edge voxel therefore votes for the point one radius up its gradient (the spherical Hough transform by gradient
direction, after Kimme, Ballard & Sklansky, Comm. ACM 18:120, 1975); a ball collects the votes of its whole
surface in one place, whatever its contrast and whatever touches it. Gradients are taken between the voxels' true
places, so tilted and uneven slices vote as straight as any.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.ct.grid import SliceGrid
from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.search.coarse import averaged, blocks, coarse_grid, coarse_voxel_mm
from ronnaplan.localization.search.votes import Ballot, Edges, find_marked, marks_for
from ronnaplan.threads import in_parts

MIN_CONTRAST_HU = 300.0
"""Faintest ball that is looked for, against its surroundings (plastic in air shows about 1,100 HU)."""

SLAB_SLICES = 16
"""So many slices of the coarse copy vote at a time; there never is more of it."""

ALMOST = 0.999
"""Gradients are first taken in single precision, which tells all but those within this of the threshold."""


def detect(volume: CTVolume, diameter_mm: float) -> FloatArray:
    """Return the places (N, 3) in LPS mm where the scan's edges agree on a ball of ``diameter_mm``, strongest first.

    They are looked for in a copy of coarser voxels (`coarse_voxel_mm`), of which there is only a part at a time.
    """
    by = blocks(volume, coarse_voxel_mm(diameter_mm))
    grid = coarse_grid(volume, by)
    return _search(grid, lambda first, end: averaged(volume, by, first, end), (diameter_mm,))[0]


def detect_in(coarse: CTVolume, diameters_mm: Sequence[float]) -> list[FloatArray]:
    """Return, for each of ``diameters_mm``, the places (N, 3) where edges of a ``coarse`` copy agree on a ball."""
    voxels_hu = coarse.voxels_hu.astype(np.int16, copy=False)
    return _search(coarse.grid, lambda first, end: voxels_hu[first:end], diameters_mm)


def _search(
    grid: SliceGrid, slab: Callable[[int, int], NDArray[np.int16]], diameters_mm: Sequence[float]
) -> list[FloatArray]:
    """Find balls in a copy on ``grid``, of which ``slab`` gives the slices from the first to before the end.

    Its edges are looked for once, and vote for each of the diameters.
    """
    axes, steps = grid.axes, grid.steps_mm
    origins = grid.origins_mm @ axes.T
    rows, columns = slab(0, 1).shape[1:]
    extent = np.array([steps[0] * (columns - 1), steps[1] * (rows - 1), 0.0])
    low, high = origins.min(axis=0), origins.max(axis=0) + extent
    ballots = [Ballot.over(low, high, diameter_mm, float(steps.min())) for diameter_mm in diameters_mm]
    edge_mm = float(np.mean([*steps, grid.typical_gap_mm]))
    threshold = MIN_CONTRAST_HU / (4.0 * edge_mm)
    for first in range(0, max(len(origins) - 2, 0), SLAB_SLICES):
        part = slice(first, min(first + SLAB_SLICES + 2, len(origins)))
        _let_vote(slab(part.start, part.stop), origins[part], steps, threshold, ballots)
    voxels_per_mm2 = 2.0 * edge_mm / (steps.prod() * grid.typical_gap_mm)
    return [ballot.counted(float(voxels_per_mm2), axes) for ballot in ballots]


def _let_vote(
    voxels: NDArray[np.int16], origins: FloatArray, steps: FloatArray, threshold: float, ballots: Sequence[Ballot]
) -> None:
    """Let the voxels of a slab whose gradient exceeds ``threshold`` (HU/mm) vote on all ``ballots``.

    ``origins`` (K, 3) are those of the slices along u, v, w, ``steps`` (2,) the distances of columns and rows.
    """
    edges = in_parts(
        lambda first, end: _find_edges(voxels, origins, steps, threshold, first + 1, end + 1), len(voxels) - 2
    )
    for ballot in ballots:
        ballot.count(edges)


@njit(cache=True, nogil=True, error_model="numpy")
def _find_edges(
    voxels: NDArray[np.int16], origins: FloatArray, steps: FloatArray, threshold: float, first: int, end: int
) -> Edges:
    """Return the edges of the slices ``first`` to ``end``."""
    _, rows, columns = voxels.shape
    per_u, per_v, least = 0.5 / steps[0], 0.5 / steps[1], threshold * threshold
    almost, is_steep = np.float32(ALMOST * least), marks_for(columns)
    at = np.empty(len(is_steep), dtype=np.intp)
    edges, count = np.empty((6, rows * columns), dtype=np.float32), 0
    for k in range(first, end):
        slant = origins[k + 1] - origins[k - 1]
        slant_u, slant_v, per_w = slant[0], slant[1], 1.0 / slant[2]
        for j in range(1, rows - 1):
            if count + columns > edges.shape[1]:
                edges = _held(edges, count, 2 * edges.shape[1])
            _mark_steep(voxels, k, j, per_u, per_v, per_w, slant_u, slant_v, almost, is_steep[:columns])
            for i in at[: find_marked(is_steep, at)]:
                gu = per_u * (float(voxels[k, j, i + 1]) - float(voxels[k, j, i - 1]))
                gv = per_v * (float(voxels[k, j + 1, i]) - float(voxels[k, j - 1, i]))
                gw = per_w * (
                    float(voxels[k + 1, j, i]) - float(voxels[k - 1, j, i]) - gu * slant_u - gv * slant_v
                )
                square = gu * gu + gv * gv + gw * gw
                if square < least:
                    continue
                per_rise = 1.0 / math.sqrt(square)
                edges[0, count] = origins[k, 0] + i * steps[0]
                edges[1, count] = origins[k, 1] + j * steps[1]
                edges[2, count] = origins[k, 2]
                edges[3, count], edges[4, count], edges[5, count] = per_rise * gu, per_rise * gv, per_rise * gw
                count += 1
    return _held(edges, count, count)


@njit(cache=True, nogil=True)
def _held(edges: Edges, count: int, room: int) -> Edges:
    """Return the first so many of the ``edges`` with ``room`` for others."""
    held = np.empty((6, room), dtype=np.float32)
    for row in range(6):
        for n in range(count):
            held[row, n] = edges[row, n]
    return held


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _mark_steep(
    voxels: NDArray[np.int16],
    k: int,
    j: int,
    per_u: float,
    per_v: float,
    per_w: float,
    slant_u: float,
    slant_v: float,
    least: np.float32,
    is_steep: NDArray[np.bool_],
) -> None:
    """Mark where in a row the squared gradient reaches the ``least``, many at once and nearly exactly."""
    row, above, below = voxels[k, j], voxels[k, j - 1], voxels[k, j + 1]
    before, behind = voxels[k - 1, j], voxels[k + 1, j]
    u, v, w = np.float32(per_u), np.float32(per_v), np.float32(per_w)
    su, sv = np.float32(slant_u), np.float32(slant_v)
    for i in range(1, len(row) - 1):
        gu = u * (np.float32(row[i + 1]) - np.float32(row[i - 1]))
        gv = v * (np.float32(below[i]) - np.float32(above[i]))
        gw = w * ((np.float32(behind[i]) - np.float32(before[i])) - gu * su - gv * sv)
        is_steep[i] = gu * gu + gv * gv + gw * gw >= least
