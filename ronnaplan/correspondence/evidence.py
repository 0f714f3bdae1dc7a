"""How probable a pairing is: the evidence of its pairs against chance, in numba kernels.

Model.  A hypothesis pairs k CT points with k OTS points.  Paired points are two readings of one marker with
normal errors; every other point is uniform in a field of volume V, which is what the two sets themselves fill
unless it is stated.  The rigid transform is uniform over the proper rotations (volume 8 pi^2) and over the field.
Integrated over the markers' true places and over the transform (Laplace's approximation about the
maximum-likelihood fit), the evidence relative to "nothing pairs" is

    log E = (k-1) ln V - ln 8 pi^2 + (3 - 3k/2) ln 2 pi
            - 3/2 sum ln c - 3/2 ln W - 1/2 ln det J + ln misfit(chi^2) + 3/2 (k-1) - S / (2 spread^2)

with c the variance per axis of a pair's difference, W = sum 1/c, J the information on the rotation, and S the
scatter of the paired CT points about their centroid: among pairings of one size, those whose markers lie
together as on a head (normal about a centre, ``spread`` per axis) are more probable beforehand.  ``misfit`` is
exp(-chi^2/2), mixed with a little of the same for errors half and twice as large as stated, so that a wrong
statement degrades the answer slowly.

The expected E of a false pairing is 1 at most.  So the pairings that a search leaves out because of their chi^2
weigh, as an expectation, at most their prior times the chi^2 tail beyond the gate: the remainder in `size_priors`.

Numba's cache does not see a change in what another module's kernel calls: after editing a kernel or a constant
here, delete this folder's ``__pycache__``.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ronnaplan.geometry import FloatArray

GATE_CHI2 = 80.0
"""Pairings in which two pairs alone exceed this chi^2 (9 standard deviations) are left to the remainder."""

UNEXPECTED_PRIOR = 1e-3
"""Prior probability that the true number of pairs is not the one the user expects."""

MISSTATED_PRIOR = 0.02
"""Prior probability that the true errors are twice the stated ones; the same again that they are half."""

ROTATION_PRECISION = 1.0 / (2.0 * math.pi)
"""Added to the information on the rotation (rad^-2): no axis is less certain than a full turn."""

COLLINEAR_SIGMAS = 3.0
"""Paired points closer to a line than this many standard deviations (root mean square) are collinear."""

LEAST_PAIRS = 3
"""A rigid transform needs three pairs."""


def log_pairings(ct_count: int, ots_count: int, size: int, known: int = 0) -> float:
    """Return the log of the number of pairings of ``size`` pairs that contain ``known`` given ones."""
    n, m, k = ct_count - known, ots_count - known, size - known
    return (
        math.lgamma(n + 1)
        - math.lgamma(n - k + 1)
        + math.lgamma(m + 1)
        - math.lgamma(m - k + 1)
        - math.lgamma(k + 1)
    )


def size_constant(size: int) -> float:
    """Return the terms of log E that depend on the number of pairs only, but for (k-1) ln V."""
    return 1.5 * (size - 1) - math.log(8.0 * math.pi**2) + (3.0 - 1.5 * size) * math.log(2.0 * math.pi)


def size_priors(counts: tuple[int, int], expected: int | None, known: int = 0) -> tuple[FloatArray, float]:
    """Return the log prior and `size_constant` of each number of pairs, and the log weight of the background.

    ``counts``: number of CT and of OTS points.  The first result is indexed by the number of pairs, -inf where a
    pairing of that size is impossible.  The background is "nothing pairs" and the pairings outside the gate.
    Unless a number of pairs is ``expected``, that nothing pairs (another patient) is as probable as that anything
    does, and every number is equally probable.  Every pairing of one size is, always.
    """
    most = min(counts)
    sizes = range(max(LEAST_PAIRS, known), most + 1)
    prior = {0: 0.5} | dict.fromkeys(sizes, 0.5 / max(len(sizes), 1))
    if expected is not None:
        prior = dict.fromkeys(prior, UNEXPECTED_PRIOR / len(sizes))
        prior[expected] = 1.0 - UNEXPECTED_PRIOR
    constants = np.full(most + 1, -np.inf)
    background = prior[0]
    for size in sizes:
        constants[size] = math.log(prior[size]) - log_pairings(*counts, size, known) + size_constant(size)
        background += prior[size] * tail_beyond_gate(size)
    return constants, math.log(background)


def tail_beyond_gate(size: int) -> float:
    """Return the probability that a true pairing of ``size`` pairs has a chi^2 beyond the gate."""
    from scipy.special import gammaincc

    half_freedom = 1.5 * size - 3.0
    as_stated, twice = gammaincc(half_freedom, GATE_CHI2 / 2.0), gammaincc(half_freedom, GATE_CHI2 / 8.0)
    return float((1.0 - MISSTATED_PRIOR) * as_stated + MISSTATED_PRIOR * twice)


@njit(cache=True, nogil=True, error_model="numpy")
def filled_volume(ct, ots):  # type: ignore[no-untyped-def]
    """Return the volume of a uniformly filled ball with the spread of the points, the two sets' geometric mean."""
    log_volume = 0.0
    for points in (ct, ots):
        square = 0.0
        for c in range(3):
            square += points[:, c].var() * len(points) / (len(points) - 1.0)
        log_volume += 0.5 * math.log(4.0 / 3.0 * math.pi * (5.0 / 3.0 * square) ** 1.5)
    return math.exp(log_volume)


@njit(cache=True, nogil=True, error_model="numpy")
def log_misfit(chi2, size):  # type: ignore[no-untyped-def]
    """Return the log likelihood of a fit's chi^2 under the stated errors, and half and twice as large ones."""
    change = (3.0 * size - 6.0) * math.log(2.0)
    stated = math.log(1.0 - 2.0 * MISSTATED_PRIOR) - 0.5 * chi2
    half = math.log(MISSTATED_PRIOR) + change - 2.0 * chi2
    twice = math.log(MISSTATED_PRIOR) - change - 0.125 * chi2
    top = max(stated, half, twice)
    return top + math.log(math.exp(stated - top) + math.exp(half - top) + math.exp(twice - top))


@njit(cache=True, nogil=True, error_model="numpy")
def cofactors(m):  # type: ignore[no-untyped-def]
    """Return the cofactor matrix of a 3x3 matrix."""
    c = np.empty((3, 3))
    for a in range(3):
        p, q = (a + 1) % 3, (a + 2) % 3
        for b in range(3):
            r, s = (b + 1) % 3, (b + 2) % 3
            c[a, b] = m[p, r] * m[q, s] - m[p, s] * m[q, r]
    return c


@njit(cache=True, nogil=True, error_model="numpy")
def largest_overlap(m, bound):  # type: ignore[no-untyped-def]
    """Return the largest trace(R m) over the proper rotations R, given an upper bound of it.

    It is the largest root of the characteristic quartic of Horn's quaternion matrix (Horn 1987); Newton's method
    from
    above (Theobald 2005) descends to it monotonically.  Mirror images are no rotation, so they are never fitted.
    """
    c = cofactors(m)
    square = (m * m).sum()
    p2, p1 = -2.0 * square, -8.0 * (m[0] * c[0]).sum()
    p0 = square * square - 4.0 * (c * c).sum()
    x = min(bound, math.sqrt(3.0 * square))
    for _ in range(60):
        slope = (4.0 * x * x + 2.0 * p2) * x + p1
        if slope <= 0.0:
            break
        step = (((x * x + p2) * x + p1) * x + p0) / slope
        x -= step
        if step <= 1e-13 * x:
            break
    return x


@njit(cache=True, nogil=True, error_model="numpy")
def weighted_centroids(ct, ots, weight, i, j, k):  # type: ignore[no-untyped-def]
    """Return the total weight and the weighted centroids of k pairs."""
    total = 0.0
    p, q = np.zeros(3), np.zeros(3)
    for a in range(k):
        w = weight[i[a], j[a]]
        total += w
        for c in range(3):
            p[c] += w * ct[i[a], c]
            q[c] += w * ots[j[a], c]
    for c in range(3):
        p[c] /= total
        q[c] /= total
    return total, p, q


@njit(cache=True, nogil=True, error_model="numpy")
def fit(ct, ots, weight, i, j, k, spread):  # type: ignore[no-untyped-def]
    """Fit k pairs (ct[i[a]], ots[j[a]]) with weights 1/c: chi^2, and the log of the volume and the spread.

    The second is -3/2 ln W - 1/2 ln det J - S / (2 spread^2).  Adding a pair raises chi^2 and lowers the second.
    """
    total, p, q = weighted_centroids(ct, ots, weight, i, j, k)
    m, s = np.zeros((3, 3)), np.zeros((3, 3))
    square, scatter = 0.0, 0.0
    u, v, mean = np.empty(3), np.empty(3), np.zeros(3)
    for a in range(k):
        w = weight[i[a], j[a]]
        for c in range(3):
            u[c] = ct[i[a], c] - p[c]
            v[c] = ots[j[a], c] - q[c]
            square += w * v[c] * v[c]
            scatter += u[c] * u[c]
            mean[c] += u[c]
        for c in range(3):
            for d in range(3):
                m[c, d] += w * u[c] * v[d]
                s[c, d] += w * u[c] * u[d]
    scatter -= (mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2) / k
    trace = s[0, 0] + s[1, 1] + s[2, 2]
    half = 0.5 * (trace + square)
    chi2 = max(2.0 * (half - largest_overlap(m, half)), 0.0)
    s = -s
    for c in range(3):
        s[c, c] += trace + ROTATION_PRECISION
    det = (s[0] * cofactors(s)[0]).sum()
    return chi2, -1.5 * math.log(total) - 0.5 * math.log(det) - 0.5 * scatter / (spread * spread)


@njit(cache=True, nogil=True, error_model="numpy")
def is_collinear(points, sigma):  # type: ignore[no-untyped-def]
    """Tell whether points (k, 3) lie on a line within their error, so that the turn about it is undetermined."""
    centred = points - np.array([points[:, 0].mean(), points[:, 1].mean(), points[:, 2].mean()])
    values = np.linalg.eigvalsh(centred.T @ centred)
    return max(values[0] + values[1], 0.0) < len(points) * (COLLINEAR_SIGMAS * sigma) ** 2
