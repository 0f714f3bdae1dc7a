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
from ronnaplan.correspondence.lookup import FAR_MM, Grid, Table, side
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.trials import MOST_SHARE, NO_LINE, count_hits, stopping_line, trial_points
from ronnaplan.geometry import FloatArray

MOST_TRIANGLES = 8_000
"""Sets with no more triangles than this have them all drawn."""

POSES_PER_SEED = 3
"""Poses that one seed hands on: those with the most hits."""

BLOCK = 8
"""So many distances are looked at together."""

SCAN_WORK, ROW_WORK, POSE_WORK, POINT_WORK, HAND_WORK = 1.5, 20, 40, 5, 800
"""Work of looking at a distance, of entering a row, of making a pose, of preparing a trial point, and of handing a pose
on: about nanoseconds."""


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


def first_in_order(values: FloatArray, most: int) -> IntArray:
    """Return where in each row of ``values`` (R, N) the smallest are, up to so many, by size."""
    if 4 * most < values.shape[1]:
        smallest = np.argpartition(values, most, axis=1)[:, :most]
        order = np.argsort(np.take_along_axis(values, smallest, axis=1), axis=1)
        return np.ascontiguousarray(np.take_along_axis(smallest, order, axis=1))
    return np.ascontiguousarray(np.argsort(values, axis=1)[:, :most])  # one layout: compiled once


@njit(cache=True, nogil=True, error_model="numpy")
def triangle_frame(points: FloatArray, a: int, b: int, c: int, frame: FloatArray) -> None:
    """Enter (3, 4) the right-handed axes (columns) of a triangle, the first along its first side, and its centroid."""
    x0, x1, x2 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    norm = 1.0 / max(math.sqrt(x0 * x0 + x1 * x1 + x2 * x2), 1e-12)
    x0, x1, x2 = x0 * norm, x1 * norm, x2 * norm
    w0, w1, w2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    along = w0 * x0 + w1 * x1 + w2 * x2
    y0, y1, y2 = w0 - along * x0, w1 - along * x1, w2 - along * x2
    norm = 1.0 / max(math.sqrt(y0 * y0 + y1 * y1 + y2 * y2), 1e-12)
    y0, y1, y2 = y0 * norm, y1 * norm, y2 * norm
    frame[0, 0], frame[1, 0], frame[2, 0] = x0, x1, x2
    frame[0, 1], frame[1, 1], frame[2, 1] = y0, y1, y2
    frame[0, 2], frame[1, 2], frame[2, 2] = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    for d in range(3):
        frame[d, 3] = (points[a, d] + points[b, d] + points[c, d]) / 3.0


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
def is_known(known: IntArray, corners: IntArray, p: int, q: int, r: int) -> bool:
    """Tell whether a pose that was found before (its partners, (P, n)) pairs these corners already."""
    a, b, c = corners
    found = False
    for pose in range(len(known)):
        found |= known[pose, a] == p and known[pose, b] == q and known[pose, c] == r
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def prepare_seeds(
    ct: FloatArray, seeds: IntArray, trials: IntArray, shares: tuple[float, float], sigma: float
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, IntArray, FloatArray]:
    """Return each seed's corners (S, 3), sides (S, 3), frame (S, 3, 4), trial points (S, 4, T), their number and line.

    ``shares`` of the trial points are met by chance, and by a right pose.
    """
    corners, sides = np.empty((len(seeds), 3), np.int64), np.empty((len(seeds), 3))
    frames, local = np.empty((len(seeds), 3, 4)), np.empty((len(seeds), 4, trials.shape[1]))
    tried, lines = np.empty(len(seeds), np.int64), np.empty((len(seeds), 2))
    for s in range(len(seeds)):
        a, b, c, ab, ac, bc = longest_side_first(ct, seeds[s])
        corners[s, 0], corners[s, 1], corners[s, 2] = a, b, c
        sides[s, 0], sides[s, 1], sides[s, 2] = ab, ac, bc
        triangle_frame(ct, a, b, c, frames[s])
        tried[s] = trial_points(ct, corners[s], frames[s], trials[s % len(trials)], sigma, local[s])
        share = shares[1] * (trials.shape[1] - 3) / max(tried[s], 1)
        lines[s] = stopping_line(shares[0], min(share, MOST_SHARE))
    return corners, sides, frames, local, tried, lines


@njit(cache=True, nogil=True, error_model="numpy")
def steps_of(sides: FloatArray, widest: float, step: float, steps: int) -> NDArray[np.int32]:
    """Return (S, 4) at which steps of a row the distances begin and end that agree with each seed's first two sides."""
    found = np.empty((len(sides), 4), np.int32)
    for s in range(len(sides)):
        for e in range(2):
            found[s, 2 * e] = min(int(max(sides[s, e] - widest, 0.0) / step), steps - 1)
            found[s, 2 * e + 1] = min(int((sides[s, e] + widest) / step) + 1, steps - 1)
    return found


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def off2(
    around: FloatArray,
    r: int | np.integer,
    x: float,
    y: float,
    z: float,
    ac: float,
    square_bc: float,
    scale: float,
) -> float:
    """Return by how much (squared, summed) the sides ac and bc differ of the triangle whose q is at (x, y, z)."""
    u, v, w = around[0, r] - x, around[1, r] - y, around[2, r] - z
    of_bc, of_ac = scale * (u * u + v * v + w * w - square_bc), around[3, r] - ac
    square: float = of_bc * of_bc + of_ac * of_ac
    return square


@njit(cache=True, nogil=True, error_model="numpy")
def triangles_at(
    around: FloatArray,
    bounds: tuple[np.uint64, ...],
    sides: tuple[float, ...],
    scale: float,
    limit: float,
    found: NDArray[np.int32],
) -> int:
    """Enter where in a row (q, r) of the OTS triangles (p, q, r) with these sides stand; return their number.

    ``around`` (4, m): p's others by distance, and that distance, then a block that is far away.  ``bounds``: where q
    begin and end, and r.  ``scale``: what makes a difference of squares one of the third side, to first order.
    """
    q_first, q_end, r_first, r_end = bounds
    ab, ac, bc = sides
    # What lies behind `r_end` agrees with no side. In whole blocks the loop has no rest that is looked at one by one.
    r_end = r_first + (r_end - r_first + np.uint64(BLOCK - 1)) // np.uint64(BLOCK) * np.uint64(BLOCK)
    square_bc, count = bc * bc, 0
    for q in range(q_first, q_end):
        left = limit - (around[3, q] - ab) ** 2
        x, y, z = around[0, q], around[1, q], around[2, q]
        hits, r = 0, r_first
        for at in range(r_first, r_end):  # hardly any agree; to count them alone is done several at a time
            hits += off2(around, at, x, y, z, ac, square_bc, scale) <= left
        while hits > 0 and r < r_end:
            found[count, 0], found[count, 1] = q, r
            is_hit = off2(around, r, x, y, z, ac, square_bc, scale) <= left
            hits -= is_hit
            count += is_hit and r != q
            r += np.uint64(1)
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def hand_on(
    ct: FloatArray, near: NDArray[np.int16], places: FloatArray, cells: FloatArray, corners: IntArray,
    frame: FloatArray, met: FloatArray, needed: IntArray, sigma: float, everyone: FloatArray, carried: FloatArray,
    poses: FloatArray, hits: IntArray,
) -> int:  # fmt: skip
    """Enter the pose that brings the seed's ``frame`` onto ``met`` if it brings enough of all; return the work."""
    total = trial_points(ct, corners, frame, np.arange(len(ct)), sigma, everyone)
    lowest, least = np.argmin(hits), needed[total]
    count, work = count_hits(
        near, places, cells, met, everyone, total, max(least, hits[lowest] + 1), NO_LINE, carried
    )
    if count > max(least - 1, hits[lowest]) or (total == 0 and least == 0):
        hits[lowest] = max(count, 1)
        rotation = np.ascontiguousarray(met[:, :3]) @ np.ascontiguousarray(frame[:, :3].T)
        moved = rotation @ np.ascontiguousarray(frame[:, 3])
        for d in range(3):
            for c in range(3):
                poses[lowest, d, c] = rotation[d, c]
            poses[lowest, d, 3] = met[d, 3] - moved[d]
    return HAND_WORK + work + POINT_WORK * len(ct)


@njit(cache=True, nogil=True, error_model="numpy")
def poses_of_seeds(
    ct: FloatArray,
    ots: FloatArray,
    grid: Grid,
    seeds: IntArray,
    trials: IntArray,
    needed: tuple[IntArray, IntArray],
    shares: tuple[float, float],
    table: Table,
    sigma: float,
    sides_chi2: float,
    known: IntArray,
    most_work: float,
) -> tuple[FloatArray, IntArray, float, bool]:
    """Return the poses (S, POSES_PER_SEED, 3, 4) of seeds (S, 3) that meet the most points, their hits, and the work.

    ``needed``: hits at least of 0, 1, ... ``trials`` (R,), and of points.  ``shares``: those of the trials that hit by
    chance, and under a right pose.  ``sides_chi2``: sum of squared differences of the three sides, in variances of a
    side's difference, up to which triangles agree.  ``table``: see `lookup.distance_table`.  ``hits``
    (S, POSES_PER_SEED) is 0 where no pose was entered.  The fourth result tells whether the seeds were looked up in all
    of the OTS points, before ``most_work`` was done.
    """
    order, distance, starts, step = table
    _, _, near, places, cells = grid
    poses, hits = np.empty((len(seeds), POSES_PER_SEED, 3, 4)), np.zeros((len(seeds), POSES_PER_SEED), np.int64)
    corners, sides, frames, local, tried, lines = prepare_seeds(ct, seeds, trials, shares, sigma)
    limit = sides_chi2 * 2.0 * sigma * sigma
    steps = steps_of(sides, math.sqrt(limit), step, starts.shape[1])
    scales = 0.5 / np.maximum(sides[:, 2], math.sqrt(limit))
    around, everyone, met = np.full((4, len(ots) + BLOCK), FAR_MM), np.empty((4, len(ct))), np.empty((3, 4))
    found, carried = np.empty((len(ots) * len(ots), 2), np.int32), np.empty((4, max(len(ct), trials.shape[1])))
    work = POINT_WORK * len(seeds) * trials.shape[1]
    for p in range(len(ots)):  # a row of distances is read once for all seeds
        for at in range(len(ots)):
            q = order[p, at]
            around[0, at], around[1, at], around[2, at] = ots[q, 0], ots[q, 1], ots[q, 2]
            around[3, at] = distance[p, at]
        for s in range(len(seeds)):
            # What cannot be negative, numba looks up without asking.
            q_first, q_end = np.uint64(starts[p, steps[s, 0]]), np.uint64(starts[p, steps[s, 1]])
            r_first, r_end = np.uint64(starts[p, steps[s, 2]]), np.uint64(starts[p, steps[s, 3]])
            work += ROW_WORK + SCAN_WORK * int((q_end - q_first) * (r_end - r_first))
            if work > most_work:
                return poses, hits, work, False
            if q_first == q_end or r_first == r_end:
                continue
            bounds, three = (q_first, q_end, r_first, r_end), (sides[s, 0], sides[s, 1], sides[s, 2])
            count = triangles_at(around, bounds, three, scales[s], limit, found)
            if count == 0:
                continue
            of_seed, least, line = local[s], needed[0][tried[s]], (lines[s, 0], lines[s, 1])
            for e in range(count):
                q, r = order[p, found[e, 0]], order[p, found[e, 1]]
                triangle_frame(ots, p, q, r, met)
                number, done = count_hits(near, places, cells, met, of_seed, tried[s], least, line, carried)
                work += POSE_WORK + done
                if number >= least and not is_known(known, corners[s], p, q, r):
                    work += hand_on(
                        ct, near, places, cells, corners[s], frames[s], met, needed[1], sigma, everyone, carried,
                        poses[s], hits[s],
                    )  # fmt: skip
                if work > most_work:
                    return poses, hits, work, False
    return poses, hits, work, work <= most_work
