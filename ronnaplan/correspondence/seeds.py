"""Seeds of the pose search: triangles drawn and looked up by their sides; the poses they give tried on more points.

A seed is a triangle of CT points.  Every OTS triangle with the same sides gives a pose; the pose is tried on other
CT points, those first whose place it predicts well, and the poses that bring the most of them onto OTS points are
handed on.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.correspondence.lookup import Grid, Row, Table, row_range, side, square_to
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.geometry import FloatArray

Corners = tuple[int, int, int]

MOST_TRIANGLES = 8_000
"""Sets with no more triangles than this have them all drawn."""

MOST_POSES = 3
"""Poses that one seed hands on: those with the most hits."""

REACH_SIGMAS = 3.2
"""A trial point meets an OTS point within this many standard deviations of its predicted place."""

WIDEST_REACH_SIGMAS = 8.0
"""Trial points whose place a seed predicts so poorly that they need a wider reach are not tried."""

FIRST_TRIALS = 24
"""A pose that brings none of the first so many trial points onto an OTS point is left at once."""


SCAN_WORK, ROW_WORK, POSE_WORK, TRIAL_WORK, POINT_WORK = 2, 25, 120, 10, 25
"""Work of looking at a distance, of entering a row, of making a pose, of carrying a trial point, and of preparing
one: about nanoseconds."""


def seed_stream(rng: np.random.Generator, count: int) -> Callable[[int], IntArray]:
    """Return what gives the next so many triangles (S, 3) of ``count`` points, fewer or none when all were given.

    All come in a random order if there are few; else they are drawn at random.
    """
    every = rng.permutation(all_triangles(count)) if math.comb(count, 3) <= MOST_TRIANGLES else None
    given = 0

    def draw(size: int) -> IntArray:
        nonlocal given
        given += size
        if every is not None:
            return np.asarray(every[given - size : given])
        drawn = rng.integers(count, size=(2 * size, 3))
        distinct = (drawn[:, 0] != drawn[:, 1]) & (drawn[:, 0] != drawn[:, 2]) & (drawn[:, 1] != drawn[:, 2])
        return np.asarray(drawn[distinct][:size], dtype=np.int64)

    return draw


@lru_cache(maxsize=40)
def all_triangles(count: int) -> IntArray:
    """Return every triangle (S, 3) of ``count`` points."""
    return np.array(list(combinations(range(count), 3)), dtype=np.int64).reshape(-1, 3)


@njit(cache=True, nogil=True, error_model="numpy")
def triangle_frame(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return the right-handed axes (columns) of a triangle, the first along its first side."""
    frame = np.empty((3, 3))
    x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    norm = 1.0 / max(math.sqrt(x0 * x0 + x1 * x1 + x2 * x2), 1e-12)
    x0, x1, x2 = x0 * norm, x1 * norm, x2 * norm
    w0, w1, w2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    along = w0 * x0 + w1 * x1 + w2 * x2
    y0, y1, y2 = w0 - along * x0, w1 - along * x1, w2 - along * x2
    norm = 1.0 / max(math.sqrt(y0 * y0 + y1 * y1 + y2 * y2), 1e-12)
    y0, y1, y2 = y0 * norm, y1 * norm, y2 * norm
    frame[0, 0], frame[1, 0], frame[2, 0] = x0, x1, x2
    frame[0, 1], frame[1, 1], frame[2, 1] = y0, y1, y2
    frame[0, 2], frame[1, 2], frame[2, 2] = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    return frame


@njit(cache=True, nogil=True, error_model="numpy")
def longest_side_first(points: FloatArray, seed: IntArray) -> tuple[int, int, int, float, float, float]:
    """Return a triangle's corners so that the sides (ab, ac, bc), which follow, fall in length."""
    a, b, c = seed[0], seed[1], seed[2]
    ab, ac, bc = side(points, a, b), side(points, a, c), side(points, b, c)
    if ac > ab:
        b, c, ab, ac = c, b, ac, ab
    if bc > ab:
        a, b, c, ab, ac, bc = b, c, a, bc, ab, ac
    elif bc > ac:
        a, b, ac, bc = b, a, bc, ac
    return a, b, c, ab, ac, bc


@njit(cache=True, nogil=True, error_model="numpy")
def trial_points(
    ct: FloatArray, corners: Corners, frame: FloatArray, trial: IntArray, sigma: float, local: FloatArray
) -> int:
    """Enter (T, 4) the places in a seed's frame of the CT points to try, and how near they have to come; return T.

    A seed with the longest side l and the height h over it predicts a point at (x, y, z) from its centroid with
    the variance (1/3 + (y^2 + z^2) / (2/3 h^2) + r^2 / (l^2 / 2)) of a pair's, at most.
    """
    a, b, c = corners
    found = 0
    long2 = max(side(ct, a, b) ** 2, 1e-12)
    height = 0.0
    for d in range(3):
        height += frame[d, 1] * (ct[c, d] - ct[a, d])
    high2 = max(height * height, 1e-12)
    for i in trial:
        if i in (a, b, c):
            continue
        u0 = ct[i, 0] - (ct[a, 0] + ct[b, 0] + ct[c, 0]) / 3.0
        u1 = ct[i, 1] - (ct[a, 1] + ct[b, 1] + ct[c, 1]) / 3.0
        u2 = ct[i, 2] - (ct[a, 2] + ct[b, 2] + ct[c, 2]) / 3.0
        x = frame[0, 0] * u0 + frame[1, 0] * u1 + frame[2, 0] * u2
        y = frame[0, 1] * u0 + frame[1, 1] * u1 + frame[2, 1] * u2
        z = frame[0, 2] * u0 + frame[1, 2] * u1 + frame[2, 2] * u2
        aside2 = y * y + z * z
        reach = REACH_SIGMAS * math.sqrt(4.0 / 3.0 + 1.5 * aside2 / high2 + 2.0 * (x * x + aside2) / long2)
        if reach <= WIDEST_REACH_SIGMAS:
            local[found, 0], local[found, 1], local[found, 2], local[found, 3] = x, y, z, reach * sigma
            found += 1
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def count_hits(
    ots: FloatArray, grid: Grid, frame: FloatArray, center: FloatArray, local: FloatArray, total: int, least: int
) -> tuple[int, int]:
    """Return how many of ``total`` trial points meet an OTS point, -1 once ``least`` is out of reach; and the work."""
    near, low, cell, shape = grid[2], grid[3], grid[4], grid[5]
    hits = 0
    step = 1.0 / cell
    for t in range(total):
        if hits + total - t < least or (t == FIRST_TRIALS and hits == 0):
            return -1, TRIAL_WORK * t
        u, v, w = local[t, 0], local[t, 1], local[t, 2]
        x = center[0] + frame[0, 0] * u + frame[0, 1] * v + frame[0, 2] * w
        y = center[1] + frame[1, 0] * u + frame[1, 1] * v + frame[1, 2] * w
        z = center[2] + frame[2, 0] * u + frame[2, 1] * v + frame[2, 2] * w
        a, b, c = int((x - low[0]) * step), int((y - low[1]) * step), int((z - low[2]) * step)
        if not (0 <= a < shape[0] and 0 <= b < shape[1] and 0 <= c < shape[2]):
            continue
        q = near[a, b, c]
        if q >= 0 and square_to(ots, q, x, y, z) < local[t, 3] * local[t, 3]:
            hits += 1
    return hits, TRIAL_WORK * total


@njit(cache=True, nogil=True, error_model="numpy")
def is_known(known: IntArray, a: int, b: int, c: int, p: int, q: int, r: int) -> bool:
    """Tell whether a pose that was found before (its partners, (P, n)) pairs these corners already."""
    found = False
    for pose in range(len(known)):
        found |= known[pose, a] == p and known[pose, b] == q and known[pose, c] == r
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def prepare_seeds(
    ct: FloatArray, seeds: IntArray, trials: IntArray, sigma: float
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, IntArray]:
    """Return each seed's corners (S, 3), sides (S, 3), frame (S, 3, 3), trial points (S, T, 4) and their number."""
    corners, sides = np.empty((len(seeds), 3), np.int64), np.empty((len(seeds), 3))
    frames, local = np.empty((len(seeds), 3, 3)), np.empty((len(seeds), trials.shape[1], 4))
    tried = np.empty(len(seeds), np.int64)
    for s in range(len(seeds)):
        a, b, c, ab, ac, bc = longest_side_first(ct, seeds[s])
        corners[s, 0], corners[s, 1], corners[s, 2] = a, b, c
        sides[s, 0], sides[s, 1], sides[s, 2] = ab, ac, bc
        frames[s] = triangle_frame(ct[a], ct[b], ct[c])
        tried[s] = trial_points(ct, (a, b, c), frames[s], trials[s % len(trials)], sigma, local[s])
    return corners, sides, frames, local, tried


@njit(cache=True, nogil=True, error_model="numpy")
def triangles_at(
    ots: FloatArray, row: Row, sides: FloatArray, limit: float, found: NDArray[np.int32]
) -> tuple[int, int]:
    """Enter (q, r) of the OTS triangles (p, q, r) with these sides into ``found``; return their number and the work.

    ``row``: p's others by distance, those distances, and where these reach each step.
    """
    order, between, start = row
    ab, ac, bc = sides
    widest, count = math.sqrt(limit), 0
    first_q, last_q = row_range(between, start, ab - widest, ab + widest)
    if first_q == last_q:
        return 0, ROW_WORK
    first_r, last_r = row_range(between, start, ac - widest, ac + widest)
    least, most = max(bc - widest, 0.0) ** 2, (bc + widest) ** 2
    for at_q in range(first_q, last_q):
        q, left_q = order[at_q], limit - (between[at_q] - ab) ** 2
        x, y, z = ots[q]
        for at_r in range(first_r, last_r):
            r = order[at_r]
            square = square_to(ots, r, x, y, z)
            if not least <= square <= most or r == q:
                continue
            if (math.sqrt(square) - bc) ** 2 <= left_q - (between[at_r] - ac) ** 2:
                found[count, 0], found[count, 1] = q, r
                count += 1
    return count, ROW_WORK + SCAN_WORK * (last_q - first_q) * (last_r - first_r)


@njit(cache=True, nogil=True, error_model="numpy")
def try_triangle(
    ct: FloatArray,
    ots: FloatArray,
    grid: Grid,
    corners: Corners,
    met: Corners,
    frame: FloatArray,
    local: FloatArray,
    needed: tuple[int, int],
    sigma: float,
    poses: FloatArray,
    hits: IntArray,
) -> int:
    """Enter the pose that brings ``corners`` onto the points ``met`` if it brings enough others; return the work."""
    a, b, c = corners
    p, q, r = met
    turned, center = triangle_frame(ots[p], ots[q], ots[r]), (ots[p] + ots[q] + ots[r]) / 3.0
    count, work = count_hits(ots, grid, turned, center, local, len(local), needed[0])
    if count < needed[0]:
        return POSE_WORK + work
    everyone = np.empty((len(ct), 4))
    total = trial_points(ct, (a, b, c), frame, np.arange(len(ct)), sigma, everyone)
    lowest = np.argmin(hits)
    least = max(needed[1], hits[lowest] + 1)
    count, more = count_hits(ots, grid, turned, center, everyone, total, least)
    if count >= least or (total == 0 and needed[1] == 0):
        hits[lowest] = max(count, 1)
        rotation = turned @ frame.T
        poses[lowest, :, :3] = rotation
        poses[lowest, :, 3] = center - rotation @ ((ct[a] + ct[b] + ct[c]) / 3.0)
    return POSE_WORK + work + more + POINT_WORK * len(ct)


@njit(cache=True, nogil=True, error_model="numpy")
def poses_of_seeds(
    ct: FloatArray,
    ots: FloatArray,
    grid: Grid,
    seeds: IntArray,
    trials: IntArray,
    needed: tuple[int, int],
    table: Table,
    sigma: float,
    sides_chi2: float,
    known: IntArray,
    most_work: float,
) -> tuple[FloatArray, IntArray, float, bool]:
    """Return the poses (S, MOST_POSES, 3, 4) of seeds (S, 3) that meet the most points, their hits, and the work.

    ``needed``: hits among the ``trials`` and among all points at least.  ``sides_chi2``: sum of squared differences
    of the three sides, in variances of a side's difference, up to which triangles agree.  ``table``: see
    `lookup.distance_table`.  ``hits`` (S, MOST_POSES) is 0 where no pose was entered.  The fourth result tells
    whether the seeds were looked up in all of the OTS points, before ``most_work`` was done.
    """
    poses, hits = np.empty((len(seeds), MOST_POSES, 3, 4)), np.zeros((len(seeds), MOST_POSES), np.int64)
    corners, sides, frames, local, tried = prepare_seeds(ct, seeds, trials, sigma)
    found, limit = np.empty((len(ots) * len(ots), 2), np.int32), sides_chi2 * 2.0 * sigma * sigma
    work = POINT_WORK * len(seeds) * trials.shape[1]
    for p in range(len(ots)):  # a row of distances is read once for all seeds
        row = table[0][p], table[1][p], table[2][p]
        for s in range(len(seeds)):
            count, done = triangles_at(ots, row, sides[s], limit, found)
            work += done
            a, b, c = corners[s]
            for q, r in found[:count]:
                if not is_known(known, a, b, c, p, q, r):
                    work += try_triangle(
                        ct, ots, grid, (a, b, c), (p, q, r), frames[s], local[s, : tried[s]], needed, sigma,
                        poses[s], hits[s],
                    )  # fmt: skip
        if work > most_work:
            return poses, hits, work, False
    return poses, hits, work, True
