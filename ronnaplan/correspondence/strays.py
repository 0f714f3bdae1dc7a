"""Strays: outliers that lie beside a marker because of it, as a second reading of it or a reflection does.

Where one set lacks a marker, a stray of it pairs with the other's reading as if it were the marker; where both lack it,
or hold strays besides, two strays do.  How dense strays lie is told from the outliers beside the markers that pair, in
each set; how often they meet where no marker pairs is told from the meetings themselves, of which strays' are wider.

Of sets of few points nothing tells how dense strays lie.  But where both hold some of one marker, pairs lie side by
side as markers do not.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.correspondence.densities import BESIDE_SIGMAS, ROUNDS, Densities, density
from ronnaplan.correspondence.evidence import LEAST_SCALE, SCALES, odds_from_log
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.problem import Problem, pairs_of
from ronnaplan.correspondence.refining import PAIR_SIGMAS, lie_beside
from ronnaplan.geometry import FloatArray

WIDEST = len(BESIDE_SIGMAS) - 2
"""The last of `BESIDE_SIGMAS` within which points pair; further off strays count as dense as up to there."""

STRAYS_PRIOR = 0.05
"""Probability that the markers of a set have strays, before its outliers are looked at."""


class Meetings(NamedTuple):
    """Points ``i`` and ``j`` (L,) near each other under a pose.

    ``chi2`` (L,) of their distance with the ``variance`` (L,) per axis; ``within`` (L,) which of `BESIDE_SIGMAS`.
    """

    i: IntArray
    j: IntArray
    chi2: FloatArray
    variance: FloatArray
    within: IntArray


@njit(cache=True, nogil=True, error_model="numpy")
def stray_densities(densities: Densities, share: FloatArray, outliers: FloatArray) -> FloatArray:
    """Return how dense strays lie within each of `BESIDE_SIGMAS` of a marker, mm^-3, nearer ones no less.

    Points are markers with ``share`` (n,); ``outliers`` (n,) is how dense outliers lie about each without strays.
    Either these alone make as many outliers beside the markers (Poisson), or a marker has any number of strays, one on
    average (geometric); beforehand both are as probable.
    """
    markers, found = max(share.sum(), 1e-9), np.zeros(len(BESIDE_SIGMAS))
    for step in range(len(BESIDE_SIGMAS) - 1, -1, -1):
        seen, expected, volume = 0.0, 1e-9, 1e-9
        for p in range(len(share)):
            volume += share[p] * densities.beside_mm3[p, step]
            expected += share[p] * densities.beside_mm3[p, step] * outliers[p]
            for q in densities.near[p, : densities.beside[p, step]]:
                both = share[p] + share[q]
                seen += 0.5 * min(both, 2.0 - both)  # of two that compete for a partner one is none
        by_chance = seen * math.log(expected) - expected - math.lgamma(seen + 1.0)
        of_markers = seen * math.log(markers) - (seen + 1.0) * math.log(markers + 1.0)
        real = 1.0 / (1.0 + odds_from_log(by_chance - of_markers) * (1.0 - STRAYS_PRIOR) / STRAYS_PRIOR)
        # The one that nobody has seen yet lies anywhere within the reach of pairs.
        one_more = min(BESIDE_SIGMAS[step] / BESIDE_SIGMAS[WIDEST], 1.0) ** 3
        rate = real * (max(seen - expected, 0.0) + one_more) / (markers + 1.0)
        found[step] = max(rate * markers / volume, found[min(step + 1, len(found) - 1)])
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def weighed_meetings(
    meetings: Meetings, paired: FloatArray, ct: Densities, ots: Densities, sigma: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return the odds (L,) of a pair and of strays to outliers that meet by chance, and how many strays would pair.

    The last at most, in the place of the pairs: were every outlier of one set a marker that the other lacks.
    ``paired`` (L,): the probability of each.  Errors are as large as the pairs' residuals say.
    """
    i, j, chi2, variance, within = meetings
    scale2 = (paired * chi2).sum() / max(3.0 * paired.sum() - 6.0, 1.0)
    scale2, most = min(max(scale2, SCALES[0] ** 2), LEAST_SCALE**2), 0.0
    of_ct = np.minimum(np.bincount(i, paired, len(ct.near)), 1.0)
    of_ots = np.minimum(np.bincount(j, paired, len(ots.near)), 1.0)
    markers, only_ct, only_ots = density(ct, of_ct), density(ct, 1.0 - of_ct), density(ots, 1.0 - of_ots)
    by_ct, by_ots = stray_densities(ct, of_ct, only_ct), stray_densities(ots, of_ots, only_ots)
    odds, stray = np.empty(len(i)), np.empty(len(i))
    for a in range(len(i)):
        at_ct, at_ots, inner = only_ct[i[a]], only_ots[j[a]], 0.0
        likelihood = (2.0 * math.pi * scale2 * variance[a]) ** -1.5 * math.exp(-0.5 * chi2[a] / scale2)
        odds[a] = likelihood * markers[i[a]] / (at_ct * at_ots)
        stray[a] = by_ots[within[a]] / at_ots + by_ct[within[a]] / at_ct
        for step in range(WIDEST + 1):
            ball = 4.0 / 3.0 * math.pi * (BESIDE_SIGMAS[step] * sigma) ** 3
            both = by_ots[step] * at_ct + by_ct[step] * at_ots
            most, inner = most + paired[a] * (ball - inner) * both / markers[i[a]], ball
    return odds, stray, most


def shared_out(i: IntArray, j: IntArray, odds: FloatArray, counts: tuple[int, int]) -> FloatArray:
    """Return the probability of each meeting (L,) that it is a pair, were each that can be made one marker more.

    Each point pairs with one other at most (belief propagation: Bayati, Shah, Sharma 2008).
    """
    to_ct = np.zeros(len(odds))
    for _ in range(ROUNDS):
        to_ots = odds / (1.0 + np.bincount(i, to_ct, counts[0])[i] - to_ct)
        to_ct = odds / (1.0 + np.bincount(j, to_ots, counts[1])[j] - to_ots)
    return to_ct / (1.0 + np.bincount(i, to_ct, counts[0])[i])


def sure_pairs(meetings: Meetings, paired: FloatArray, ct: Densities, ots: Densities, sigma: float) -> FloatArray:
    """Return the probability of each meeting (L,) that it is of two readings of one marker, not of strays.

    ``paired`` (L,): that it is a pair that does not meet by chance; ``sigma``: a pair's error, mm.  Which points are
    markers is told as if two pairs side by side were two markers, which pair is right as if they were one.
    """
    i, j, share, counts, sure = meetings.i, meetings.j, 1.0, (len(ct.near), len(ots.near)), paired
    is_close = meetings.chi2 * meetings.variance < (BESIDE_SIGMAS[WIDEST] * sigma) ** 2
    for _ in range(ROUNDS):
        odds, stray, most = weighed_meetings(meetings, paired, ct, ots, sigma)
        others = np.bincount(i, odds, counts[0])[i] + np.bincount(j, odds, counts[1])[j] - odds
        all_odds = 1.0 + share * stray + others
        share = ((is_close * share * stray / all_odds).sum() + 1.0) / (most + 1.0)
        paired, sure = shared_out(i, j, odds, counts), odds / all_odds
    return sure


@njit(cache=True, nogil=True, error_model="numpy")
def side_by_side(ct: FloatArray, ots: FloatArray, variances: FloatArray) -> NDArray[np.bool_]:
    """Return which pairs of points (k, 3) `lie_beside` another in both sets; ``variances`` (k,) as there."""
    beside = np.zeros(len(ct), np.bool_)
    for a in range(len(ct)):
        for b in range(a):
            variance = min(variances[a], variances[b])
            if lie_beside(ct, a, b, variance) and lie_beside(ots, a, b, variance):
                beside[a] = beside[b] = True
    return beside


def told_twice(problem: Problem, partner: IntArray) -> str:
    """Say how near a point lies to one that ``partner`` (n,) pairs, where one marker may have been read twice."""
    i, j = pairs_of(partner).T
    reach_mm = PAIR_SIGMAS * math.sqrt(float(problem.pair_variances(i, j).min()))
    for points, paired, name in ((problem.ct, i, "CT points"), (problem.ots, j, "readings")):
        gap = np.linalg.norm(points[paired, None] - points, axis=2)
        gap[np.arange(len(paired)), paired] = np.inf
        if gap.min() < reach_mm:
            return f"; two {name} lie {gap.min():.1f} mm apart: if one marker was read twice, leave one out"
    return ""
