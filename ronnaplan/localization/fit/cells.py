"""The directions about a center, sorted into cells: what a ball shows in each is judged by itself."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray

CELLS_PER_EDGE = 4
"""The directions about a center are sorted into the 6 x 4 x 4 cells of a cube, each about 22 degrees wide."""

CELL_COUNT = 6 * CELLS_PER_EDGE**2

BACKGROUND_QUANTILE = 0.3
"""The background is what this share of the directions reach at most: most markers are touched, some lie on skin."""

_BOUNDS = tuple(math.tan((n / CELLS_PER_EDGE - 0.5) * math.pi / 2) for n in range(1, CELLS_PER_EDGE))
"""Tangents of the angles between the cells of an edge."""


@njit(cache=True, nogil=True)
def direction_cell(u: float, v: float, w: float) -> int:
    """Number of the cell, 0 to `CELL_COUNT` - 1, in which an offset points (equal-angle cube)."""
    axis, main, one, other = 0, u, v, w
    if abs(v) > abs(main):
        axis, main, one, other = 1, v, w, u
    if abs(w) > abs(main):
        axis, main, one, other = 2, w, u, v
    cell = 2 * axis + (1 if main < 0.0 else 0)
    for across in (one, other):
        cell *= CELLS_PER_EDGE
        for bound in _BOUNDS:
            if across >= bound * abs(main):
                cell += 1
    return cell


@njit(cache=True, nogil=True)
def direction_cells(offsets_mm: FloatArray) -> NDArray[np.intp]:
    """Number of the cell (N,) in which each offset (N, 3) points."""
    cells = np.empty(len(offsets_mm), dtype=np.intp)
    for n in range(len(offsets_mm)):
        cells[n] = direction_cell(offsets_mm[n, 0], offsets_mm[n, 1], offsets_mm[n, 2])
    return cells


@njit(cache=True, nogil=True)
def cell_means(values: FloatArray, cells: NDArray[np.intp], chosen: NDArray[np.bool_]) -> FloatArray:
    """Mean of the ``chosen`` values in each cell (cells,); NaN where there is none."""
    sums, counts = np.zeros(CELL_COUNT), np.zeros(CELL_COUNT)
    for n in range(len(values)):
        if chosen[n]:
            sums[cells[n]] += values[n]
            counts[cells[n]] += 1.0
    for cell in range(CELL_COUNT):
        sums[cell] = sums[cell] / counts[cell] if counts[cell] > 0.0 else np.nan
    return sums


@cache
def cell_directions() -> FloatArray:
    """Unit vectors (`CELL_COUNT`, 3) through the middle of each cell; not to be written to."""
    centers = np.tan(((np.arange(CELLS_PER_EDGE) + 0.5) / CELLS_PER_EDGE - 0.5) * np.pi / 2)
    directions = np.empty((3, 2, CELLS_PER_EDGE, CELLS_PER_EDGE, 3))
    for axis in range(3):
        for side in range(2):
            directions[axis, side, ..., axis] = 1.0 - 2.0 * side
            directions[axis, side, ..., (axis + 1) % 3] = centers[:, np.newaxis]
            directions[axis, side, ..., (axis + 2) % 3] = centers[np.newaxis, :]
    flat = directions.reshape(-1, 3)
    unit_vectors: FloatArray = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    unit_vectors.setflags(write=False)
    return unit_vectors
