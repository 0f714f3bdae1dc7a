"""How dense outliers lie about each point, and how probable it is that two points are no such that meet by chance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from kernelcache import njit
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.refining import PAIR_SIGMAS
from ronnaplan.geometry import FloatArray

ROUNDS = 4
"""Which points are outliers, and how dense these are, are told from each other so often."""

BESIDE_SIGMAS = (0.5 * PAIR_SIGMAS, PAIR_SIGMAS, 15.0)
"""How many strays lie beside markers is told from the points within these of them."""


class Densities(NamedTuple):
    """How dense a set lies about each point: its nearest others (n, K), and the volume of the ball (n,) that they fill.

    Twice the square root of their number: fewer know a density too poorly, more know it too far away. ``beside`` (n, B)
    of them are within each of `BESIDE_SIGMAS`, and fill that volume.
    """

    near: IntArray
    volume_mm3: FloatArray
    beside: IntArray
    beside_mm3: FloatArray

    @classmethod
    def of(cls, points: FloatArray, sigma_mm: float) -> Densities:
        """Return those of points (n, 3)."""
        count = min(2 * math.isqrt(len(points)) + 1, len(points))
        distance, index = map(np.asarray, cKDTree(points).query(points, count))
        radius = np.maximum(distance[:, -1], PAIR_SIGMAS * sigma_mm)
        close = np.minimum(radius[:, None], np.array(BESIDE_SIGMAS) * sigma_mm)
        return cls(
            np.ascontiguousarray(index[:, 1:], np.int64),
            4.0 / 3.0 * math.pi * radius**3,
            np.ascontiguousarray((distance[:, 1:, None] <= close[:, None]).sum(axis=1)),
            4.0 / 3.0 * math.pi * close**3,
        )


@njit(cache=True, nogil=True, error_model="numpy")
def density(densities: Densities, share: FloatArray) -> FloatArray:
    """Return how dense at each point those are that count with ``share`` (n,); their mean counts as one more."""
    mean, found = (share.sum() + 1.0) / (len(share) + 1.0), np.empty(len(share))
    for p in range(len(share)):
        total = mean
        for q in densities.near[p]:
            total += share[q]
        found[p] = total / densities.volume_mm3[p]
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def odds_of_pairs(
    i: IntArray, j: IntArray, likelihood: FloatArray, partner: IntArray, ct: Densities, ots: Densities
) -> tuple[FloatArray, FloatArray]:
    """Return the odds (L,) that points ``i`` and ``j`` (L,) are a pair, and the probability of each pair (n,) made.

    Markers of both sets, and the outliers of each, lie with densities of their own: the odds of a pair of the
    ``likelihood`` N(r; 0, c) (L,), at the distance r, are that times the density of the markers, over the product of
    the outliers' there.  The densities about each point are taken from its neighbours, which count as outliers with
    what is left of their own probability.  ``partner`` (n,) tells which pairs are made.
    """
    odds, of_ct, of_ots = likelihood.copy(), np.zeros(len(ct.near)), np.zeros(len(ots.near))
    for p in range(len(partner)):
        if partner[p] >= 0:
            of_ct[p] = of_ots[partner[p]] = 1.0
    for _ in range(ROUNDS):
        markers, only_ct, only_ots = density(ct, of_ct), density(ct, 1.0 - of_ct), density(ots, 1.0 - of_ots)
        at_ct, at_ots = np.zeros(len(of_ct)), np.zeros(len(of_ots))
        for a in range(len(odds)):
            odds[a] = likelihood[a] * markers[i[a]] / (only_ct[i[a]] * only_ots[j[a]])
            at_ct[i[a]] += odds[a]
            at_ots[j[a]] += odds[a]
        of_ct, of_ots = np.zeros(len(of_ct)), np.zeros(len(of_ots))
        for a in range(len(odds)):
            if partner[i[a]] == j[a]:
                of_ct[i[a]] = of_ots[j[a]] = odds[a] / (1.0 + at_ct[i[a]] + at_ots[j[a]] - odds[a])
    return odds, of_ct
