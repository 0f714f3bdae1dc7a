"""How probable a pairing is: the evidence of its pairs against chance, in numba kernels.

Model.  A hypothesis pairs k CT points with k OTS points.  Paired points are two readings of one marker with
normal errors; every other point is uniform in a field of volume V, which is what the two sets themselves fill
unless it is stated.  The rigid transform is uniform over the proper rotations (volume 8 pi^2) and over the field.
Integrated over the markers' true places and over the transform (Laplace's approximation about the
maximum-likelihood fit), the evidence relative to "nothing pairs" is

    log E = (k-1) ln V - ln 8 pi^2 + (3 - 3k/2) ln 2 pi
            - 3/2 sum ln c - 3/2 ln W - 1/2 ln det J + ln misfit(chi^2) + 3/2 (k-1) - S / (2 spread^2)

with c the variance per axis of a pair's difference, W = sum 1/c, J the information on the rotation, and S the scatter
of the paired CT points about their centroid. S counts because, among pairings of one size, those whose markers lie
together as on a head (normal about a center, ``spread`` per axis) are more probable beforehand. ``misfit`` is
s^(6 - 3k) exp(-chi^2 / 2 s^2) integrated over the scale s of the true errors in terms of the stated ones (`SCALES`):
the noise is inferred with the pairing.

The expected E of a false pairing is 1 at most.  So the pairings that a search leaves out because two of their pairs
differ too much in their distance weigh, as an expectation, at most their prior times the probability that a true one
is left out: the remainder in `priors.size_priors`.
"""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.geometry import FloatArray

GATE_CHI2 = 256.0
"""Pairings in which two pairs alone exceed this chi^2 (16 standard deviations as stated, 4 where the true errors are
four times as large) are left to the remainder."""

LOOSE_CHI2 = 200.0
"""Of more than `FEW_PAIRS` pairs the remainder is the prior times the tail of their whole chi^2 beyond this.

That is far more than what the gate leaves out, on purpose: another patient's markers lie on a head, too, so by chance
more of them pair than the evidence takes for chance.  With the tight bound, of 15,000 pairs of different heads 74 in
place of 61 are accepted where five of eight markers are expected, and 44 in place of 43 where four are
(`benchmarks.strangers`)."""

SCALES = (0.5, 1.0, 2.0, 4.0)
SCALE_PRIORS = (0.10, 0.55, 0.10, 0.25)
"""True errors over the stated ones, and how probable each ratio is beforehand.

The weight on four times decides between two harms: with less, three markers whose errors are that large pair wrongly
more often; with more, three markers with honest errors are refused more often (docs/correspondence.md has both)."""

LEAST_SCALE = 1.5
"""Errors this many times as large as stated, by the residuals of the best pose, are taken for what they are, and poses
are sought anew: with errors as stated, pairs of larger ones are lost, and equals are missed."""

ROTATION_PRECISION = 1.0 / (2.0 * math.pi)
"""Added to the information on the rotation (rad^-2): no axis is less certain than a full turn."""

FEW_PAIRS = 3
MOST_ODDS_IF_LARGER = 1.0 / 50.0
"""So few pairs have to stand against errors of the largest of `SCALES`, too: what pairs otherwise has these odds to
them at most were it certain that its errors are so large.

Where all errors are, a wrong pairing that happens to fit as if they were not passes by the posterior alone: three pairs
say too little of the scale.  Of more, their residuals tell it.  Smaller odds let fewer wrong answers pass where errors
are so large, and refuse more where they are as stated: `benchmarks/scale_prior.py` has both."""

AS_WELL_SIGMAS = 3.7
"""A rival fits as well as the best where its residuals would be as large in more than 1 in 10,000 cases."""


LARGEST_LOG_ODDS = 700.0
"""Odds of a larger logarithm are as good as endless: the exponential of 710 is beyond all numbers."""


@njit(cache=True, nogil=True, error_model="numpy")
def odds_from_log(log_odds: float) -> float:
    """Return the odds of this logarithm, up to `LARGEST_LOG_ODDS`."""
    return math.exp(min(log_odds, LARGEST_LOG_ODDS))


@njit(cache=True, nogil=True, error_model="numpy")
def filled_volume(ct: FloatArray, ots: FloatArray) -> float:
    """Return the volume of a filled ball as spread as points (n, 3) and (m, 3) are, the two sets' geometric mean."""
    log_volume = 0.0
    for points in (ct, ots):
        square = 0.0
        for c in range(3):
            square += points[:, c].var() * len(points) / (len(points) - 1.0)
        log_volume += 0.5 * math.log(4.0 / 3.0 * math.pi * (5.0 / 3.0 * square) ** 1.5)
    return math.exp(log_volume)


@njit(cache=True, nogil=True, error_model="numpy")
def log_misfit_at(chi2: float, size: int, scale: float) -> float:
    """Return the log likelihood of a fit's chi^2 were the errors ``scale`` times as large as stated."""
    return -(3.0 * size - 6.0) * math.log(scale) - 0.5 * chi2 / (scale * scale)


@njit(cache=True, nogil=True, error_model="numpy")
def log_misfit(chi2: float, size: int) -> float:
    """Return the log likelihood of a fit's chi^2, the scale of the errors integrated out over its prior."""
    top, total = -np.inf, 0.0
    for a in range(len(SCALES)):
        here = math.log(SCALE_PRIORS[a]) + log_misfit_at(chi2, size, SCALES[a])
        if here > top:
            total = total * math.exp(top - here) + 1.0
            top = here
        else:
            total += math.exp(here - top)
    return top + math.log(total)


@njit(cache=True, nogil=True, error_model="numpy")
def fits_as_well(chi2: float, size: int, rival_chi2: float, rival_size: int) -> bool:
    """Tell whether chance makes a rival's residuals as much larger as they are than those of a fit of ``size`` pairs.

    The logarithm of the ratio of two mean squares is nearly normal (R. Fisher, 1924).
    """
    freedom, of_rival = 3.0 * size - 6.0, 3.0 * rival_size - 6.0
    ratio = math.log(max(rival_chi2 / of_rival, 1e-12) / max(chi2 / freedom, 1e-12))
    return ratio < AS_WELL_SIGMAS * math.sqrt(2.0 / freedom + 2.0 / of_rival)


@njit(cache=True, nogil=True, error_model="numpy")
def cofactors(m: FloatArray) -> FloatArray:
    """Return the cofactors (3, 3) of a matrix (3, 3)."""
    c = np.empty((3, 3))
    for a in range(3):
        p, q = (a + 1) % 3, (a + 2) % 3
        for b in range(3):
            r, s = (b + 1) % 3, (b + 2) % 3
            c[a, b] = m[p, r] * m[q, s] - m[p, s] * m[q, r]
    return c


@njit(cache=True, nogil=True, error_model="numpy")
def determinant(m: FloatArray, c: FloatArray) -> float:
    """Return the determinant of a matrix (3, 3) with the cofactors ``c`` (3, 3)."""
    return float(m[0, 0] * c[0, 0] + m[0, 1] * c[0, 1] + m[0, 2] * c[0, 2])


@njit(cache=True, nogil=True, error_model="numpy")
def largest_overlap(m: FloatArray, bound: float) -> float:
    """Return the largest trace(R m), of ``m`` (3, 3), over the proper rotations R, given an upper bound of it.

    It is the largest root of the characteristic quartic of Horn's quaternion matrix (Horn 1987); Newton's method
    from above (Theobald 2005) descends to it monotonically.  Mirror images are no rotation, so they are never fitted.
    """
    c = cofactors(m)
    square = of_cofactors = 0.0
    for a in range(3):
        for b in range(3):
            square += m[a, b] * m[a, b]
            of_cofactors += c[a, b] * c[a, b]
    p2, p1 = -2.0 * square, -8.0 * determinant(m, c)
    p0 = square * square - 4.0 * of_cofactors
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
def weighted_centroids(
    ct: FloatArray, ots: FloatArray, weight: FloatArray, i: IntArray, j: IntArray, k: int
) -> tuple[float, FloatArray, FloatArray]:
    """Return the total weight and the weighted centroids (3,) of the k pairs ``i`` and ``j``, by ``weight`` (n, m)."""
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
def fit(
    ct: FloatArray, ots: FloatArray, weight: FloatArray, i: IntArray, j: IntArray, k: int, spread: float
) -> tuple[float, float]:
    """Fit k pairs (ct[i[a]], ots[j[a]]) with weights 1/c (n, m): chi^2, and the log of the volume and the spread.

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
    log_det = math.log(determinant(s, cofactors(s)))
    return chi2, -1.5 * math.log(total) - 0.5 * log_det - 0.5 * scatter / (spread * spread)
