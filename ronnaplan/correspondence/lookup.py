"""Points looked up by their place and by their distances from each other, in kernels that numba compiles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.correspondence.graph import distances
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.geometry import FloatArray

Grid = tuple[NDArray[np.int32], IntArray, NDArray[np.int16], FloatArray, FloatArray]
"""Points sorted into cells, see `point_grid`.  Kernels hand its parts on one by one: to unpack it takes as long as
to look a point up."""

Table = tuple[Any, ...]
"""Points by distance, see `distance_table`."""

STEP_SIGMAS, MOST_STEPS = 0.5, 2048
"""Each point's neighbours, sorted by distance, are entered at steps of so many standard deviations, or at larger ones
that so many reach the longest distance."""

FAR_MM = 1e9
"""Where the point stands that is no point."""

ROUNDING_MM = 1e-6
"""What is as near as a point that is known is looked for so much farther."""

LEAST_CELL_SIGMAS = 2.5
"""No cell for `nearest` is smaller than so many standard deviations."""
CELLS_PER_AXIS, MOST_CELLS_PER_AXIS = 12.0, 96
"""Cells along the longest axis at most: so many times the cube root of the number of points, and never more."""


@njit(cache=True, nogil=True, error_model="numpy")
def side(points: FloatArray, a: int, b: int) -> float:
    """Return the distance of two of the points (n, 3)."""
    x, y, z = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True, error_model="numpy")
def square_to(points: FloatArray, p: int | np.integer, x: float, y: float, z: float) -> float:
    """Return the squared distance of point p from (x, y, z)."""
    u, v, w = points[p, 0] - x, points[p, 1] - y, points[p, 2] - z
    square: float = u * u + v * v + w * w
    return square


def distance_table(points: FloatArray, sigma_mm: float) -> Table:
    """Return what triangles are looked up in.

    Each point's others by distance (m, m), those distances, where these reach each step, and the step.
    """
    d = distances(points)
    row_order = np.argsort(d, axis=1).astype(np.int32)
    row_sorted = np.take_along_axis(d, row_order, axis=1)
    step = max(STEP_SIGMAS * sigma_mm, float(row_sorted[:, -1].max()) / MOST_STEPS)
    return row_order, row_sorted, row_starts(row_sorted, step), step


@njit(cache=True, nogil=True, error_model="numpy")
def row_starts(row_sorted: FloatArray, step: float) -> NDArray[np.int16]:
    """Return where the distances of each row (m, m) reach each multiple of ``step``, and the end of the row."""
    steps = int(row_sorted[:, -1].max() / step) + 1
    start = np.empty((len(row_sorted), steps + 1), np.int16)
    for p in range(len(row_sorted)):
        position = 0
        for at in range(steps):
            while position < len(row_sorted) and row_sorted[p, position] < at * step:
                position += 1
            start[p, at] = position
        start[p, steps] = len(row_sorted)
    return start


def point_grid(points: FloatArray, sigma_mm: float, reach_mm: float, farthest_mm: float) -> Grid:
    """Return points (m, 3) sorted into cells for `nearest`, and who is within ``reach_mm`` of each cell.

    Each cell's start, the points in that order, who is near each cell, the points and one that is far away, and the
    cells: where they begin (x, y, z), how large they are, their numbers along the axes, and ``farthest_mm``, within
    which of a cell nobody is where no one is near it.
    """
    low = points.min(axis=0) - reach_mm
    extent = np.ptp(points, axis=0) + 2.0 * reach_mm
    most = min(CELLS_PER_AXIS * len(points) ** (1.0 / 3.0), MOST_CELLS_PER_AXIS)
    cell = max(LEAST_CELL_SIGMAS * sigma_mm, float(extent.max()) / most)
    shape = (extent / cell).astype(np.int64) + 1
    start, order, near = fill_grid(points, low, cell, shape, reach_mm)
    add_farther(points, low, cell, near, farthest_mm)
    cells = np.array([*low, cell, *shape, farthest_mm])
    return start, order, near.ravel(), np.vstack((points, np.full(3, FAR_MM))), cells


@njit(cache=True, nogil=True, error_model="numpy")
def fill_grid(
    points: FloatArray, low: FloatArray, cell: float, shape: IntArray, reach: float
) -> tuple[NDArray[np.int32], IntArray, NDArray[np.int16]]:
    """Sort points into cubic cells: each cell's start, the points in that order, and who is near each cell.

    The last is the point nearest to the cell's middle, the number of points where none comes within ``reach`` of it.
    """
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int32)
    near = np.full((shape[0], shape[1], shape[2]), len(points), np.int16)
    home, first, last = np.empty(len(points), np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    for p in range(len(points)):
        cells_within(points[p], low, cell, near.shape, reach, first, last)
        for a in range(first[0], last[0] + 1):
            for b in range(first[1], last[1] + 1):
                for c in range(first[2], last[2] + 1):
                    x, y, z = low[0] + (a + 0.5) * cell, low[1] + (b + 0.5) * cell, low[2] + (c + 0.5) * cell
                    q = near[a, b, c]
                    if q == len(points) or square_to(points, p, x, y, z) < square_to(points, q, x, y, z):
                        near[a, b, c] = p
        cells_within(points[p], low, cell, near.shape, 0.0, first, last)
        home[p] = (first[0] * shape[1] + first[1]) * shape[2] + first[2]
        start[home[p] + 1] += 1
    for at in range(1, len(start)):
        start[at] += start[at - 1]
    return start, np.argsort(home, kind="mergesort"), near


@njit(cache=True, nogil=True, error_model="numpy")
def cells_within(
    point: FloatArray,
    low: FloatArray,
    cell: float,
    shape: tuple[int, int, int],
    reach: float,
    first: IntArray,
    last: IntArray,
) -> None:
    """Enter the ``first`` and the ``last`` (3,) of the cells that come within ``reach`` of a point along each axis."""
    for d in range(3):
        place = point[d] - low[d]
        first[d] = max(int((place - reach) / cell), 0)
        last[d] = min(int((place + reach) / cell), shape[d] - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def add_farther(
    points: FloatArray, low: FloatArray, cell: float, near: NDArray[np.int16], farthest: float
) -> None:
    """Enter who comes within ``farthest`` of the cells that nobody is ``near``: they are looked into, but never hit."""
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for p in range(len(points)):
        cells_within(points[p], low, cell, near.shape, farthest, first, last)
        for a in range(first[0], last[0] + 1):
            for b in range(first[1], last[1] + 1):
                for c in range(first[2], last[2] + 1):
                    if near[a, b, c] == len(points):
                        near[a, b, c] = p


@njit(cache=True, nogil=True, error_model="numpy")
def nearest(
    start: NDArray[np.int32],
    order: IntArray,
    near: NDArray[np.int16],
    places: FloatArray,
    cells: FloatArray,
    x: float,
    y: float,
    z: float,
    radius: float,
) -> tuple[int, float]:
    """Return the point nearest to (x, y, z) and its squared distance, -1 when none lies within ``radius``.

    The first are of a `point_grid`.  No farther is looked than to the point that is nearest to the middle of the cell.
    """
    best, square, step = -1, radius * radius, 1.0 / cells[3]
    u, v, w = x - cells[0], y - cells[1], z - cells[2]
    last_a, last_b, last_c = int(cells[4]) - 1, int(cells[5]) - 1, int(cells[6]) - 1
    a, b, c = int(u * step), int(v * step), int(w * step)
    if min(u, v, w) >= 0.0 and a <= last_a and b <= last_b and c <= last_c:
        p = np.int64(near[(a * (last_b + 1) + b) * (last_c + 1) + c])
        if p == len(places) - 1 and radius <= cells[7]:
            return best, square
        radius = min(math.sqrt(square_to(places, p, x, y, z)) + ROUNDING_MM, radius)
        square = radius * radius
    a0, a1 = max(int((u - radius) * step), 0), min(int((u + radius) * step), last_a)
    b0, b1 = max(int((v - radius) * step), 0), min(int((v + radius) * step), last_b)
    c0, c1 = max(int((w - radius) * step), 0), min(int((w + radius) * step), last_c)
    if c1 < c0:
        return best, square
    for a in range(a0, a1 + 1):
        for b in range(b0, b1 + 1):
            first = (a * (last_b + 1) + b) * (last_c + 1)
            for q in range(start[first + c0], start[first + c1 + 1]):
                p = order[q]
                d = square_to(places, p, x, y, z)
                if d < square:
                    best, square = p, d
    return best, square
