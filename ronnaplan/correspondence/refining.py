"""A pose fitted to the pairs that it makes, in kernels that numba compiles."""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.correspondence.lookup import Grid, nearest
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.geometry import FloatArray

PAIR_SIGMAS = 5.5
"""Points further apart than this many standard deviations under the fitted pose do not pair."""

REFINING_SIGMAS = (1.6 * PAIR_SIGMAS,) * 2 + (PAIR_SIGMAS,) * 8
"""How near pairs must be in each fit of a pose, until they stay: the first rest on three points only.  Most stay
after three to five fits; one that did not was weighed by pairs that are not its own."""

RIGHT_ANGLE, MOST_SWEEPS, NO_DIRECTION = 1e-15, 20, 1e-12
"""Columns with a smaller cosine are at right angles, which takes three or four sweeps over them, never so many; and
what is shorter than this share of the longest is rounding."""


@njit(cache=True, nogil=True, error_model="numpy")
def lie_beside(points: FloatArray, a: int | np.integer, b: int | np.integer, variance: float) -> bool:
    """Tell whether two of points (n, 3) lie so near that either may be a stray of the other's marker.

    No farther than each one's own points may lie from each other; ``variance`` of a pair's difference per axis.
    """
    return bool(((points[a] - points[b]) ** 2).sum() < PAIR_SIGMAS**2 * variance)


@njit(cache=True, nogil=True, error_model="numpy")
def partners_under(ct: FloatArray, ots: FloatArray, grid: Grid, pose: FloatArray, radius: float) -> IntArray:
    """Return the nearest OTS point of each CT point under a pose (3, 4), -1 when none is within ``radius``.

    An OTS point goes to the nearest CT point.
    """
    partner, taken_by, square = np.full(len(ct), -1), np.full(len(ots), -1), np.full(len(ots), np.inf)
    start, order, near, places, cells = grid
    for i in range(len(ct)):
        u, v, w = ct[i, 0], ct[i, 1], ct[i, 2]
        x = pose[0, 0] * u + pose[0, 1] * v + pose[0, 2] * w + pose[0, 3]
        y = pose[1, 0] * u + pose[1, 1] * v + pose[1, 2] * w + pose[1, 3]
        z = pose[2, 0] * u + pose[2, 1] * v + pose[2, 2] * w + pose[2, 3]
        j, d = nearest(start, order, near, places, cells, x, y, z, radius)
        if j >= 0 and d < square[j]:
            if taken_by[j] >= 0:
                partner[taken_by[j]] = -1
            partner[i], taken_by[j], square[j] = j, i, d
    return partner


@njit(cache=True, nogil=True, error_model="numpy")
def fit_to_pairs(ct: FloatArray, ots: FloatArray, partner: IntArray, pose: FloatArray) -> None:
    """Enter the rigid ``pose`` (3, 4) that brings CT points closest to their partners (n,), never a reflection.

    Kabsch 1978.
    """
    x0, y0, overlap = overlap_of(ct, ots, partner)
    turn = turn_of(overlap)
    for d in range(3):
        pose[d, 3] = y0[d]
        for c in range(3):
            pose[d, c] = turn[d, c]
            pose[d, 3] -= turn[d, c] * x0[c]


@njit(cache=True, nogil=True, error_model="numpy")
def overlap_of(ct: FloatArray, ots: FloatArray, partner: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the centroids (3,) of the CT points that have a partner (n,) and of these, and their overlap (3, 3)."""
    x0, y0, overlap, pairs = np.zeros(3), np.zeros(3), np.zeros((3, 3)), 0
    for i in range(len(ct)):
        if partner[i] >= 0:
            pairs += 1
            for d in range(3):
                x0[d] += ct[i, d]
                y0[d] += ots[partner[i], d]
    for d in range(3):
        x0[d] /= pairs
        y0[d] /= pairs
    for i in range(len(ct)):
        if partner[i] >= 0:
            for d in range(3):
                along = ots[partner[i], d] - y0[d]
                for c in range(3):
                    overlap[d, c] += along * (ct[i, c] - x0[c])
    return x0, y0, overlap


@njit(cache=True, nogil=True, error_model="numpy")
def turn_of(overlap: FloatArray) -> FloatArray:
    """Return the proper rotation (3, 3) that goes best with an ``overlap`` (3, 3), which is lost.

    By the columns of its singular vectors: to call LAPACK for so small a matrix takes many times as long.
    """
    axes, turn = np.eye(3), np.empty((3, 3))
    for _ in range(MOST_SWEEPS):
        turned = turn_columns(overlap, axes, 0, 1)
        turned |= turn_columns(overlap, axes, 0, 2)
        turned |= turn_columns(overlap, axes, 1, 2)
        if not turned:
            break
    longest = shortest = 0
    square = (overlap * overlap).sum(axis=0)
    for c in range(1, 3):
        if square[c] > square[longest]:
            longest = c
        if square[c] <= square[shortest]:
            shortest = c
    make_frame(overlap, longest, 3 - longest - shortest)
    make_frame(axes, longest, 3 - longest - shortest)
    for d in range(3):
        for c in range(3):
            turn[d, c] = overlap[d, 0] * axes[c, 0] + overlap[d, 1] * axes[c, 1] + overlap[d, 2] * axes[c, 2]
    return turn


@njit(cache=True, nogil=True, error_model="numpy")
def turn_columns(m: FloatArray, axes: FloatArray, p: int, q: int) -> bool:
    """Turn two columns of ``m`` (3, 3), and of ``axes``, until those of m are at right angles (Hestenes 1958).

    Tells whether they were not.
    """
    of_p = of_q = of_both = 0.0
    for d in range(3):
        of_p += m[d, p] * m[d, p]
        of_q += m[d, q] * m[d, q]
        of_both += m[d, p] * m[d, q]
    if of_both * of_both <= RIGHT_ANGLE**2 * of_p * of_q:
        return False
    half = (of_q - of_p) / (2.0 * of_both)
    tangent = math.copysign(1.0 / (abs(half) + math.sqrt(1.0 + half * half)), half)
    cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
    sine = cosine * tangent
    for columns in (m, axes):
        for d in range(3):
            u, v = columns[d, p], columns[d, q]
            columns[d, p], columns[d, q] = cosine * u - sine * v, sine * u + cosine * v
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def make_frame(m: FloatArray, first: int, second: int) -> None:
    """Make the columns of ``m`` (3, 3) right-handed axes: along its ``first``, and beside that towards its ``second``.

    Where that is no direction, as of points on a line, towards any.
    """
    x0, x1, x2 = m[0, first], m[1, first], m[2, first]
    y0, y1, y2 = m[0, second], m[1, second], m[2, second]
    length = math.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    if length == 0.0:
        x0, length = 1.0, 1.0
    x0, x1, x2 = x0 / length, x1 / length, x2 / length
    along = x0 * y0 + x1 * y1 + x2 * y2
    y0, y1, y2 = y0 - along * x0, y1 - along * x1, y2 - along * x2
    beside = math.sqrt(y0 * y0 + y1 * y1 + y2 * y2)
    if beside <= NO_DIRECTION * length:
        if abs(x0) < 0.7:
            y0, y1, y2 = 1.0 - x0 * x0, -x0 * x1, -x0 * x2
        else:
            y0, y1, y2 = -x1 * x0, 1.0 - x1 * x1, -x1 * x2
        beside = math.sqrt(y0 * y0 + y1 * y1 + y2 * y2)
    y0, y1, y2 = y0 / beside, y1 / beside, y2 / beside
    m[0, 0], m[1, 0], m[2, 0] = x0, x1, x2
    m[0, 1], m[1, 1], m[2, 1] = y0, y1, y2
    m[0, 2], m[1, 2], m[2, 2] = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0


@njit(cache=True, nogil=True, error_model="numpy")
def refined(
    ct: FloatArray, ots: FloatArray, grid: Grid, poses: FloatArray, reaches: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Fit poses (K, 3, 4) to their pairs within each of the ``reaches`` in turn; return them and their pairs (K, n).

    The pairs are those within the last reach.
    """
    fits, partners = poses.copy(), np.empty((len(poses), len(ct)), np.int64)
    for k in range(len(poses)):
        pose = fits[k]
        partner = partners_under(ct, ots, grid, pose, reaches[0])
        is_fitted = False
        for step in range(1, len(reaches)):
            if not is_fitted:
                if (partner >= 0).sum() < 3:
                    break
                fit_to_pairs(ct, ots, partner, pose)
            elif reaches[step] == reaches[step - 1]:
                continue
            before, partner = partner, partners_under(ct, ots, grid, pose, reaches[step])
            is_fitted = bool((before == partner).all())
        for i_ct in range(len(ct)):
            partners[k, i_ct] = partner[i_ct]
    return fits, partners
