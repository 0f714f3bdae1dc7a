"""A pose tried on other points: which of them its seed predicts well, and how many meet a point of the other set."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import bdtrc

from kernelcache import njit
from ronnaplan.correspondence.lookup import side, square_to
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.geometry import FloatArray

REACH_SIGMAS = 2.5
"""A trial point meets an OTS point within this many standard deviations of its predicted place."""

WIDEST_REACH_SIGMAS = 6.25
MOST_VARIANCE = (WIDEST_REACH_SIGMAS / REACH_SIGMAS) ** 2
"""Trial points whose place a seed predicts so poorly that they need a wider reach are not tried."""

STOPPED = 0.1
"""Share of right poses that are left, at most, because their first trials miss."""

NO_LINE = (0.0, 1.0)
"""The line that nothing falls below."""

MOST_SHARE = 0.9
"""Of the trial points no larger a share is relied upon to hit."""

MOST_TRIALS = 128
"""CT points on which the pose of a seed is tried."""

TRIALS_PER_HIT, LEAST_HITS = 24, 2
"""Of the trial points one in so many must meet an OTS point at least, up to so many: smaller bodies could not be found
in time."""

CHANCE_PASSES = ((1e-2, 1e-5), (1e-2, 1e-3))
"""So many hits are needed that a false pose passes the trial, and then that of all points, with these probabilities:
where seeds are drawn, and where every triangle is.  Those are few, and with fewer hits a body of seven is found."""

TRIAL_WORK = 6
"""Work of carrying a trial point: about nanoseconds."""


def at_least(needed: ArrayLike, count: int | IntArray, share: FloatArray | float) -> FloatArray:
    """Return the chance (...) of ``needed`` successes or more among ``count`` trials that succeed with ``share``."""
    fewer, most = np.asarray(needed) - 1, np.asarray(count)
    return np.where(fewer < 0, 1.0, bdtrc(np.clip(fewer, 0, most), most, np.asarray(share)))


def needed_hits(rest: int, chance: float, every: bool) -> tuple[IntArray, IntArray]:
    """Return how many of 0, 1, ... R = ``rest`` points tried must meet one before chance is unlikely, twice (R + 1,).

    At first, and where all that a seed predicts are tried: of a row flat triangles predict few, but nearly all of its
    own.  ``every``: whether every seed is drawn.
    """
    if rest == 0:
        return np.zeros(1, np.int64), np.zeros(1, np.int64)
    least = np.minimum(np.arange(rest + 1) // TRIALS_PER_HIT, LEAST_HITS)
    first, of_all = (np.maximum(hits_beyond(chance, rest, unlikely), least) for unlikely in CHANCE_PASSES[every])
    return first, of_all


@njit(cache=True, nogil=True, error_model="numpy")
def hits_beyond(chance: float, most: int, unlikely: float) -> IntArray:
    """Return the fewest hits that 0, 1, ... M = ``most`` trials reach by ``chance`` hardly ever (M + 1,)."""
    hits, probability = np.ones(most + 1, np.int64), np.zeros(most + 2)  # of 0, 1, ... hits
    probability[0] = 1.0
    for tried in range(1, most + 1):
        for k in range(tried, 0, -1):
            probability[k] += chance * (probability[k - 1] - probability[k])
        probability[0] *= 1.0 - chance
        fewest = hits[tried - 1]
        hits[tried] = fewest + (1.0 - probability[:fewest].sum() > unlikely)
    return hits


@njit(cache=True, nogil=True, error_model="numpy")
def trial_points(
    ct: FloatArray, corners: IntArray, frame: FloatArray, trial: IntArray, sigma: float, local: FloatArray
) -> int:
    """Enter (4, T) the places in a seed's frame of the CT points to try, and how near they have to come; return T.

    A seed with the longest side l and the height h over it predicts a point at (x, y, z) from its centroid with
    the variance (1/3 + (y^2 + z^2) / (2/3 h^2) + r^2 / (l^2 / 2)) of a pair's, at most.  The reach is entered squared.
    """
    a, b, c = corners
    height = 0.0
    for d in range(3):
        height += frame[d, 1] * (ct[c, d] - ct[a, d])
    of_side, of_height = 2.0 / max(side(ct, a, b) ** 2, 1e-12), 1.5 / max(height * height, 1e-12)
    reach2, found = (REACH_SIGMAS * sigma) ** 2, 0
    xu, xv, xw, u0 = frame[0, 0], frame[1, 0], frame[2, 0], frame[0, 3]
    yu, yv, yw, v0 = frame[0, 1], frame[1, 1], frame[2, 1], frame[1, 3]
    zu, zv, zw, w0 = frame[0, 2], frame[1, 2], frame[2, 2], frame[2, 3]
    for i in trial:
        u, v, w = ct[i, 0] - u0, ct[i, 1] - v0, ct[i, 2] - w0
        x, y, z = xu * u + xv * v + xw * w, yu * u + yv * v + yw * w, zu * u + zv * v + zw * w
        aside2 = y * y + z * z
        variance = 4.0 / 3.0 + of_height * aside2 + of_side * (x * x + aside2)
        local[0, found], local[1, found], local[2, found], local[3, found] = x, y, z, reach2 * variance
        found += (variance <= MOST_VARIANCE) & (i != a) & (i != b) & (i != c)  # a branch would cost more
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
def trials_before(hits: int, total: int, least: int, line: tuple[float, float]) -> int:
    """Return after how many of ``total`` trials so many hits are too few, see `count_hits`; ``total`` if never."""
    slope, below = line
    end = min(max(hits + total - least + 1, 0), total)
    if slope * end - below <= hits:
        return end
    t = max(int((hits + below) / slope) - 1, 0)
    while t < end and hits >= slope * t - below:
        t += 1
    return t


@njit(cache=True, nogil=True, error_model="numpy")
def count_hits(
    near: NDArray[np.int16], places: FloatArray, cells: FloatArray,
    pose: FloatArray, local: FloatArray, total: int, least: int, line: tuple[float, float], carried: FloatArray,
) -> tuple[int, int]:  # fmt: skip
    """Return how many of ``total`` trial points meet an OTS point, and the work.

    -1 once ``least`` is out of reach, or the hits fall below a ``line`` (see `stopping_line`).  The first are of a
    `point_grid`; ``carried`` (4, T): room for the points' places and cells.  Where no OTS point is near, the one looked
    at is far away: a branch would cost more.
    """
    step, hits, t = 1.0 / cells[3], 0, 0
    low_x, low_y, low_z = cells[0], cells[1], cells[2]
    xu, xv, xw, x0 = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3] - low_x
    yu, yv, yw, y0 = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3] - low_y
    zu, zv, zw, z0 = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3] - low_z
    last_a, last_b, last_c = cells[4] - 1.0, cells[5] - 1.0, cells[6] - 1.0
    end = trials_before(0, total, least, line)
    while t < end:
        first, stop = np.uint64(t), np.uint64(end)  # what cannot be negative, numba looks up without asking
        for k in range(first, stop):
            u, v, w = local[0, k], local[1, k], local[2, k]
            x, y, z = x0 + xu * u + xv * v + xw * w, y0 + yu * u + yv * v + yw * w, z0 + zu * u + zv * v + zw * w
            a = np.trunc(min(max(x * step, 0.0), last_a))
            b = np.trunc(min(max(y * step, 0.0), last_b))
            c = np.trunc(min(max(z * step, 0.0), last_c))
            carried[0, k], carried[1, k], carried[2, k] = x + low_x, y + low_y, z + low_z
            carried[3, k] = (a * (last_b + 1.0) + b) * (last_c + 1.0) + c
        for k in range(first, stop):
            q = np.uint64(near[np.uint64(np.int64(carried[3, k]))])
            hits += square_to(places, q, carried[0, k], carried[1, k], carried[2, k]) < local[3, k]
        t, end = end, trials_before(hits, total, least, line)
    return hits if t == total else -1, TRIAL_WORK * t
