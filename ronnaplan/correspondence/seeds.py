"""Kernels of the search in large sets: seed triangles, looked up by distance and verified on the other points."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

MOST_POSES = 64
"""Poses that one seed triangle may hand on."""

MOST_TRIANGLES = 300_000
"""Triangles that one seed may be compared with; more only in very regular sets."""


@njit(cache=True, nogil=True, error_model="numpy")
def triangle_frame(a, b, c):  # type: ignore[no-untyped-def]
    """Return the right-handed axes (columns) of a triangle, the first along its first side."""
    frame = np.empty((3, 3))
    x, y, z = b - a, np.empty(3), np.empty(3)
    x = x / math.sqrt((x * x).sum())
    w = c - a
    y = w - (w * x).sum() * x
    y = y / max(math.sqrt((y * y).sum()), 1e-12)
    z[0], z[1], z[2] = x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]
    frame[:, 0], frame[:, 1], frame[:, 2] = x, y, z
    return frame


@njit(cache=True, nogil=True, error_model="numpy")
def fill_grid(points, low, cell, shape):  # type: ignore[no-untyped-def]
    """Sort points into cubic cells: the start of each cell's points, and the points in that order."""
    count = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    home = np.empty(len(points), np.int64)
    for p in range(len(points)):
        a, b, c = (
            int((points[p, 0] - low[0]) / cell),
            int((points[p, 1] - low[1]) / cell),
            int((points[p, 2] - low[2]) / cell),
        )
        home[p] = (a * shape[1] + b) * shape[2] + c
        count[home[p] + 1] += 1
    start = np.cumsum(count)
    return start, np.argsort(home, kind="mergesort")


@njit(cache=True, nogil=True, error_model="numpy")
def nearest(grid, points, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Return the point nearest to (x, y, z) and its squared distance, -1 when none lies within ``radius``."""
    start, order, low, cell, shape = grid
    best, square = -1, radius * radius
    a0, a1 = max(int((x - radius - low[0]) / cell), 0), min(int((x + radius - low[0]) / cell), shape[0] - 1)
    b0, b1 = max(int((y - radius - low[1]) / cell), 0), min(int((y + radius - low[1]) / cell), shape[1] - 1)
    c0, c1 = max(int((z - radius - low[2]) / cell), 0), min(int((z + radius - low[2]) / cell), shape[2] - 1)
    for a in range(a0, a1 + 1):
        for b in range(b0, b1 + 1):
            first = (a * shape[1] + b) * shape[2]
            for q in range(start[first + c0], start[first + c1 + 1] if c1 >= c0 else start[first + c0]):
                p = order[q]
                d = (points[p, 0] - x) ** 2 + (points[p, 1] - y) ** 2 + (points[p, 2] - z) ** 2
                if d < square:
                    best, square = p, d
    return best, square


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_moved(ct, ots, grid, pose, i, radius):  # type: ignore[no-untyped-def]
    """Return the OTS point nearest to CT point i under a pose (3, 4), as `nearest` does."""
    p = ct[i]
    x = pose[0, 0] * p[0] + pose[0, 1] * p[1] + pose[0, 2] * p[2] + pose[0, 3]
    y = pose[1, 0] * p[0] + pose[1, 1] * p[1] + pose[1, 2] * p[2] + pose[1, 3]
    z = pose[2, 0] * p[0] + pose[2, 1] * p[1] + pose[2, 2] * p[2] + pose[2, 3]
    return nearest(grid, ots, x, y, z, radius)


@njit(cache=True, nogil=True, error_model="numpy")
def is_promising(ct, ots, grid, pose, trial, needed, radius):  # type: ignore[no-untyped-def]
    """Tell whether ``needed`` of the trial CT points meet an OTS point under a pose."""
    hits = 0
    for position in range(len(trial)):
        if hits + len(trial) - position < needed:
            return False
        if nearest_moved(ct, ots, grid, pose, trial[position], radius)[0] >= 0:
            hits += 1
            if hits == needed:
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def poses_of_seed(ct, ots, grid, seed, trial, needed, table, tolerance, radius):  # type: ignore[no-untyped-def]
    """Return promising poses (P, 3, 4) that map a CT triangle onto an OTS triangle, and if all were tried.

    ``seed``: the triangle's CT points; ``table``: see `large.distance_table`.
    """
    d_ots, row_order, row_sorted, pairs, pair_distance = table
    a, b, c = ct[seed[0]], ct[seed[1]], ct[seed[2]]
    ab, ac, bc = (
        math.sqrt(((a - b) ** 2).sum()),
        math.sqrt(((a - c) ** 2).sum()),
        math.sqrt(((b - c) ** 2).sum()),
    )
    frame, centre = triangle_frame(a, b, c), (a + b + c) / 3.0
    poses, found, tried = np.empty((MOST_POSES + 1, 3, 4)), 0, 0
    first = np.searchsorted(pair_distance, ab - tolerance)
    last = np.searchsorted(pair_distance, ab + tolerance)
    for entry in range(2 * first, 2 * last):
        p, q = pairs[entry >> 1, entry & 1], pairs[entry >> 1, 1 - (entry & 1)]
        begin = np.searchsorted(row_sorted[p], ac - tolerance)
        end = np.searchsorted(row_sorted[p], ac + tolerance)
        for position in range(begin, end):
            r = row_order[p, position]
            if r in (p, q) or abs(d_ots[q, r] - bc) > tolerance:
                continue
            tried += 1
            rotation = triangle_frame(ots[p], ots[q], ots[r]) @ frame.T
            poses[found, :, :3] = rotation
            poses[found, :, 3] = (ots[p] + ots[q] + ots[r]) / 3.0 - rotation @ centre
            if is_promising(ct, ots, grid, poses[found], trial, needed, radius):
                found += 1
            if found == MOST_POSES or tried == MOST_TRIANGLES:
                return poses[:found], False
    return poses[:found], True


@njit(cache=True, nogil=True, error_model="numpy")
def partners_under(ct, ots, grid, pose, radius):  # type: ignore[no-untyped-def]
    """Return the nearest OTS point of each CT point under a pose, -1 when none is within ``radius``.

    An OTS point goes to the nearest CT point.
    """
    partner, taken_by, square = np.full(len(ct), -1), np.full(len(ots), -1), np.full(len(ots), np.inf)
    for i in range(len(ct)):
        j, d = nearest_moved(ct, ots, grid, pose, i, radius)
        if j >= 0 and d < square[j]:
            if taken_by[j] >= 0:
                partner[taken_by[j]] = -1
            partner[i], taken_by[j], square[j] = j, i, d
    return partner
