"""Kernels of the pose search: triangles looked up by their sides, and the poses that they give tried on more points.

A seed is a triangle of CT points.  Every OTS triangle with the same sides gives a pose; the pose is tried on other
CT points, those first whose place it predicts well, and the poses that bring the most of them onto OTS points are
handed on.
"""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit

MOST_POSES = 3
"""Poses that one seed hands on: those with the most hits."""

REACH_SIGMAS = 3.2
"""A trial point meets an OTS point within this many standard deviations of its predicted place."""

WIDEST_REACH_SIGMAS = 8.0
"""Trial points whose place a seed predicts so poorly that they need a wider reach are not tried."""

FIRST_TRIALS = 24
"""A pose that brings none of the first so many trial points onto an OTS point is left at once."""

STEP_MM = 1.5
"""Each point's neighbours, sorted by distance, are entered at steps of this."""

SCAN_WORK, ROW_WORK, POSE_WORK, TRIAL_WORK, NEAREST_WORK = 2, 15, 90, 8, 60
"""Work of looking at a distance, of entering a row, of making a pose, of carrying a trial point, and of looking
for its neighbour: about nanoseconds."""


@njit(cache=True, nogil=True, error_model="numpy")
def row_starts(row_sorted):  # type: ignore[no-untyped-def]
    """Return where the distances of each row (m, m) reach each multiple of `STEP_MM`."""
    steps = int(row_sorted[:, -1].max() / STEP_MM) + 1
    start = np.empty((len(row_sorted), steps), np.int32)
    for p in range(len(row_sorted)):
        position = 0
        for step in range(steps):
            while position < len(row_sorted) and row_sorted[p, position] < step * STEP_MM:
                position += 1
            start[p, step] = position
    return start


@njit(cache=True, nogil=True, error_model="numpy")
def triangle_frame(a, b, c):  # type: ignore[no-untyped-def]
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
def longest_side_first(points, seed):  # type: ignore[no-untyped-def]
    """Return a triangle's corners so that its longest side is the first, and the sides (ab, ac, bc)."""
    a, b, c = seed[0], seed[1], seed[2]
    ab, ac, bc = side(points, a, b), side(points, a, c), side(points, b, c)
    if ac >= ab and ac >= bc:
        return a, c, b, ac, ab, bc
    if bc >= ab and bc >= ac:
        return b, c, a, bc, ab, ac
    return a, b, c, ab, ac, bc


@njit(cache=True, nogil=True, error_model="numpy")
def side(points, a, b):  # type: ignore[no-untyped-def]
    """Return the distance of two points."""
    x, y, z = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True, error_model="numpy")
def trial_points(ct, corners, frame, trial, sigma):  # type: ignore[no-untyped-def]
    """Return (T, 4) the places in a seed's frame of the CT points to try, and how near they have to come.

    A seed with the longest side l and the height h over it predicts a point at (x, y, z) from its centroid with
    the variance (1/3 + (y^2 + z^2) / (2/3 h^2) + r^2 / (l^2 / 2)) of a pair's, at most.
    """
    a, b, c = corners
    local, found = np.empty((len(trial), 4)), 0
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
    return local[:found]


@njit(cache=True, nogil=True, error_model="numpy")
def fill_grid(points, low, cell, shape, reach):  # type: ignore[no-untyped-def]
    """Sort points into cubic cells: each cell's start, the points in that order, and the cells within reach."""
    count = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    near = np.zeros((shape[0], shape[1], shape[2]), np.bool_)
    home, at = np.empty(len(points), np.int64), np.empty(3, np.int64)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for p in range(len(points)):
        for d in range(3):
            place = points[p, d] - low[d]
            at[d] = int(place / cell)
            first[d] = max(int((place - reach) / cell), 0)
            last[d] = min(int((place + reach) / cell), shape[d] - 1)
        near[first[0] : last[0] + 1, first[1] : last[1] + 1, first[2] : last[2] + 1] = True
        home[p] = (at[0] * shape[1] + at[1]) * shape[2] + at[2]
        count[home[p] + 1] += 1
    return np.cumsum(count), np.argsort(home, kind="mergesort"), near


@njit(cache=True, nogil=True, error_model="numpy")
def nearest(grid, points, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Return the point nearest to (x, y, z) and its squared distance, -1 when none lies within ``radius``."""
    start, order, _, low, cell, shape = grid
    best, square = -1, radius * radius
    a0, a1 = max(int((x - radius - low[0]) / cell), 0), min(int((x + radius - low[0]) / cell), shape[0] - 1)
    b0, b1 = max(int((y - radius - low[1]) / cell), 0), min(int((y + radius - low[1]) / cell), shape[1] - 1)
    c0, c1 = max(int((z - radius - low[2]) / cell), 0), min(int((z + radius - low[2]) / cell), shape[2] - 1)
    if c1 < c0:
        return best, square
    for a in range(a0, a1 + 1):
        for b in range(b0, b1 + 1):
            first = (a * shape[1] + b) * shape[2]
            for q in range(start[first + c0], start[first + c1 + 1]):
                p = order[q]
                d = (points[p, 0] - x) ** 2 + (points[p, 1] - y) ** 2 + (points[p, 2] - z) ** 2
                if d < square:
                    best, square = p, d
    return best, square


@njit(cache=True, nogil=True, error_model="numpy")
def count_hits(ots, grid, frame, centre, local, least):  # type: ignore[no-untyped-def]
    """Return how many trial points meet an OTS point, -1 as soon as ``least`` is out of reach; and the work."""
    near, low, cell, shape = grid[2], grid[3], grid[4], grid[5]
    hits, work, total = 0, POSE_WORK, len(local)
    for t in range(total):
        if hits + total - t < least or (t == FIRST_TRIALS and hits == 0):
            return -1, work
        work += TRIAL_WORK
        u, v, w = local[t, 0], local[t, 1], local[t, 2]
        x = centre[0] + frame[0, 0] * u + frame[0, 1] * v + frame[0, 2] * w
        y = centre[1] + frame[1, 0] * u + frame[1, 1] * v + frame[1, 2] * w
        z = centre[2] + frame[2, 0] * u + frame[2, 1] * v + frame[2, 2] * w
        a, b, c = int((x - low[0]) / cell), int((y - low[1]) / cell), int((z - low[2]) / cell)
        if not (0 <= a < shape[0] and 0 <= b < shape[1] and 0 <= c < shape[2]) or not near[a, b, c]:
            continue
        work += NEAREST_WORK
        if nearest(grid, ots, x, y, z, local[t, 3])[0] >= 0:
            hits += 1
    return hits, work


@njit(cache=True, nogil=True, error_model="numpy")
def is_known(known, a, b, c, p, q, r):  # type: ignore[no-untyped-def]
    """Tell whether a pose that was found before (its partners, (P, n)) pairs these corners already."""
    found = False
    for pose in range(len(known)):
        found |= known[pose, a] == p and known[pose, b] == q and known[pose, c] == r
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def poses_of_seed(ct, ots, grid, seed, trial, needed, table, sigma, sides_chi2, known, poses, hits, most_work):  # type: ignore[no-untyped-def]
    """Enter the poses of a seed with the most hits, ``needed`` at least, into ``poses`` (MOST_POSES, 3, 4).

    ``sides_chi2``: sum of squared differences of the three sides, in variances of a side's difference, up to which
    triangles agree.  ``table``: see `poses.distance_table`.  Returns the work done; ``hits`` (MOST_POSES,) is 0
    where no pose was entered.
    """
    d_ots, row_order, row_sorted, row_start, pairs, pair_distance = table
    a, b, c, ab, ac, bc = longest_side_first(ct, seed)
    frame, corners = triangle_frame(ct[a], ct[b], ct[c]), (a, b, c)
    local = trial_points(ct, corners, frame, trial, sigma)
    middle = (ct[a] + ct[b] + ct[c]) / 3.0
    centre, limit = np.empty(3), sides_chi2 * 2.0 * sigma * sigma
    widest, work = math.sqrt(limit), 100
    hits[:] = 0
    lowest = np.argmin(hits)
    first = np.searchsorted(pair_distance, ab - widest)
    last = np.searchsorted(pair_distance, ab + widest)
    for entry in range(2 * first, 2 * last):
        p, q = pairs[entry >> 1, entry & 1], pairs[entry >> 1, 1 - (entry & 1)]
        left = limit - (pair_distance[entry >> 1] - ab) ** 2
        width = math.sqrt(max(left, 0.0))
        step = min(max(int((ac - width) / STEP_MM), 0), row_start.shape[1] - 1)
        work += ROW_WORK
        for position in range(row_start[p, step], len(row_sorted)):
            off = row_sorted[p, position] - ac
            if off < -width:
                continue
            if off > width:
                break
            r = row_order[p, position]
            work += SCAN_WORK
            if r in (p, q) or (d_ots[q, r] - bc) ** 2 > left - off * off:
                continue
            if is_known(known, a, b, c, p, q, r):
                continue
            turned = triangle_frame(ots[p], ots[q], ots[r])
            for d in range(3):
                centre[d] = (ots[p, d] + ots[q, d] + ots[r, d]) / 3.0
            count, done = count_hits(ots, grid, turned, centre, local, max(needed, hits[lowest] + 1))
            work += done
            if count > 0:
                hits[lowest] = count
                rotation = turned @ frame.T
                poses[lowest, :, :3] = rotation
                poses[lowest, :, 3] = centre - rotation @ middle
                lowest = np.argmin(hits)
            if work > most_work:
                return work
    return work


@njit(cache=True, nogil=True, error_model="numpy")
def poses_of_seeds(ct, ots, grid, seeds, trials, needed, table, sigma, sides_chi2, known, most_work):  # type: ignore[no-untyped-def]
    """Return the poses (S, MOST_POSES, 3, 4) of seeds (S, 3), their hits, the work, and how many were done."""
    poses = np.empty((len(seeds), MOST_POSES, 3, 4))
    hits = np.zeros((len(seeds), MOST_POSES), np.int64)
    work = 0
    for s in range(len(seeds)):
        trial = trials[s % len(trials)]
        work += poses_of_seed(
            ct,
            ots,
            grid,
            seeds[s],
            trial,
            needed,
            table,
            sigma,
            sides_chi2,
            known,
            poses[s],
            hits[s],
            most_work - work,
        )
        if work > most_work:
            return poses, hits, work, s
    return poses, hits, work, len(seeds)


@njit(cache=True, nogil=True, error_model="numpy")
def partners_under(ct, ots, grid, pose, radius):  # type: ignore[no-untyped-def]
    """Return the nearest OTS point of each CT point under a pose (3, 4), -1 when none is within ``radius``.

    An OTS point goes to the nearest CT point.
    """
    partner, taken_by, square = np.full(len(ct), -1), np.full(len(ots), -1), np.full(len(ots), np.inf)
    for i in range(len(ct)):
        u, v, w = ct[i]
        x = pose[0, 0] * u + pose[0, 1] * v + pose[0, 2] * w + pose[0, 3]
        y = pose[1, 0] * u + pose[1, 1] * v + pose[1, 2] * w + pose[1, 3]
        z = pose[2, 0] * u + pose[2, 1] * v + pose[2, 2] * w + pose[2, 3]
        j, d = nearest(grid, ots, x, y, z, radius)
        if j >= 0 and d < square[j]:
            if taken_by[j] >= 0:
                partner[taken_by[j]] = -1
            partner[i], taken_by[j], square[j] = j, i, d
    return partner


@njit(cache=True, nogil=True, error_model="numpy")
def fitted(x, y):  # type: ignore[no-untyped-def]
    """Return the rigid pose (3, 4) that brings points x (k, 3) closest to y (Kabsch 1978), never a reflection."""
    x0, y0 = np.empty(3), np.empty(3)
    for d in range(3):
        x0[d], y0[d] = x[:, d].mean(), y[:, d].mean()
    u, _, vt = np.linalg.svd(np.ascontiguousarray((y - y0).T) @ (x - x0))
    if np.linalg.det(np.ascontiguousarray(u) @ np.ascontiguousarray(vt)) < 0.0:
        u[:, 2] = -u[:, 2]
    pose = np.empty((3, 4))
    turn = np.ascontiguousarray(u) @ np.ascontiguousarray(vt)
    pose[:, :3] = turn
    pose[:, 3] = y0 - turn @ x0
    return pose


@njit(cache=True, nogil=True, error_model="numpy")
def refined(ct, ots, grid, pose, reaches):  # type: ignore[no-untyped-def]
    """Fit a pose to the pairs within each of the ``reaches`` in turn; return it and its pairs within the last."""
    partner = partners_under(ct, ots, grid, pose, reaches[0])
    for step in range(1, len(reaches)):
        i = np.flatnonzero(partner >= 0)
        if len(i) < 3:
            break
        pose = fitted(ct[i], ots[partner[i]])
        partner = partners_under(ct, ots, grid, pose, reaches[step])
    return pose, partner
