"""A pose tried on other points: which of them its seed predicts well, and how many meet a point of the other set."""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.correspondence.lookup import Grid, side, square_to
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.geometry import FloatArray

REACH_SIGMAS = 2.5
"""A trial point meets an OTS point within this many standard deviations of its predicted place."""

WIDEST_REACH_SIGMAS = 6.25
MOST_VARIANCE = (WIDEST_REACH_SIGMAS / REACH_SIGMAS) ** 2
"""Trial points whose place a seed predicts so poorly that they need a wider reach are not tried."""

STOPPED = 0.1
"""Share of right poses that are left, at most, because their first trials miss."""

NO_LINE = np.array([0.0, 1.0])
"""The line that nothing falls below."""

MOST_SHARE = 0.9
"""Of the trial points no larger a share is relied upon to hit."""

TRIAL_WORK = 6
"""Work of carrying a trial point: about nanoseconds."""


@njit(cache=True, nogil=True, error_model="numpy")
def trial_points(
    ct: FloatArray, corners: IntArray, frame: FloatArray, trial: IntArray, sigma: float, local: FloatArray
) -> int:
    """Enter (T, 4) the places in a seed's frame of the CT points to try, and how near they have to come; return T.

    A seed with the longest side l and the height h over it predicts a point at (x, y, z) from its centroid with
    the variance (1/3 + (y^2 + z^2) / (2/3 h^2) + r^2 / (l^2 / 2)) of a pair's, at most.  The reach is entered squared.
    """
    a, b, c = corners
    height = 0.0
    for d in range(3):
        height += frame[d, 1] * (ct[c, d] - ct[a, d])
    of_side, of_height = 2.0 / max(side(ct, a, b) ** 2, 1e-12), 1.5 / max(height * height, 1e-12)
    reach2, found = (REACH_SIGMAS * sigma) ** 2, 0
    for i in trial:
        u, v, w = ct[i, 0] - frame[0, 3], ct[i, 1] - frame[1, 3], ct[i, 2] - frame[2, 3]
        x = frame[0, 0] * u + frame[1, 0] * v + frame[2, 0] * w
        y = frame[0, 1] * u + frame[1, 1] * v + frame[2, 1] * w
        z = frame[0, 2] * u + frame[1, 2] * v + frame[2, 2] * w
        aside2 = y * y + z * z
        variance = 4.0 / 3.0 + of_height * aside2 + of_side * (x * x + aside2)
        if variance <= MOST_VARIANCE and i != a and i != b and i != c:
            local[found, 0], local[found, 1], local[found, 2], local[found, 3] = x, y, z, reach2 * variance
            found += 1
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def stopping_line(chance: float, share: float) -> tuple[float, float]:
    """Return the line, rise a trial and depth at the first, below which a pose's hits say that it is none (Wald 1945).

    There, trials that hit with the probability ``share`` or more are `STOPPED` times as probable as by ``chance``; by
    Ville's inequality they ever get there with that probability at most.
    """
    if share <= chance:
        return 0.0, 1.0
    miss = math.log((1.0 - chance) / (1.0 - share))
    hit = math.log(share / chance) + miss
    return miss / hit, -math.log(STOPPED) / hit


@njit(cache=True, nogil=True, error_model="numpy")
def count_hits(
    grid: Grid, pose: FloatArray, local: FloatArray, total: int, least: int, line: FloatArray
) -> tuple[int, int]:
    """Return how many of ``total`` trial points meet an OTS point, and the work.

    -1 once ``least`` is out of reach, or the hits fall below a ``line`` (see `stopping_line`).  Where no OTS point is
    near, the one looked at is far away: a branch would cost more.
    """
    slope, below = line[0], line[1]
    near, places, low, cell, shape = grid[2], grid[3], grid[4], grid[5], grid[6]
    step, hits = 1.0 / cell, 0
    x0, y0, z0 = pose[0, 3] - low[0], pose[1, 3] - low[1], pose[2, 3] - low[2]
    last_a, last_b, last_c = shape[0] - 1.0, shape[1] - 1.0, shape[2] - 1.0
    for t in range(total):
        if hits + total - t < least or hits < slope * t - below:
            return -1, TRIAL_WORK * t
        u, v, w = local[t, 0], local[t, 1], local[t, 2]
        x = x0 + pose[0, 0] * u + pose[0, 1] * v + pose[0, 2] * w
        y = y0 + pose[1, 0] * u + pose[1, 1] * v + pose[1, 2] * w
        z = z0 + pose[2, 0] * u + pose[2, 1] * v + pose[2, 2] * w
        a = int(min(max(x * step, 0.0), last_a))
        b = int(min(max(y * step, 0.0), last_b))
        c = int(min(max(z * step, 0.0), last_c))
        q = near[a, b, c]
        hits += square_to(places, q, x + low[0], y + low[1], z + low[2]) < local[t, 3]
    return hits, TRIAL_WORK * total
