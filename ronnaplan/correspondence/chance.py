"""How probable each pair of a pose is, against outliers that meet by chance where both sets hold many."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.problem import Problem
from ronnaplan.correspondence.refining import PAIR_SIGMAS
from ronnaplan.geometry import FloatArray

ROUNDS = 4
"""Which points are outliers, and how dense these are, are told from each other so often."""

LEAST_ODDS = 0.01
"""Points compete for partners with which they pair with larger odds than this: others change their probability by less
than a hundredth each."""


@dataclass(frozen=True, eq=False)
class Densities:
    """How dense a set lies about each point: its nearest others (n, K), and the volume of the ball (n,) that they fill.

    Twice the square root of their number: fewer know a density too poorly, more know it too far away.
    """

    near: IntArray
    volume_mm3: FloatArray

    @classmethod
    def of(cls, points: FloatArray, sigma_mm: float) -> Densities:
        """Return those of points (n, 3)."""
        count = min(2 * math.isqrt(len(points)) + 1, len(points))
        distance, index = map(np.asarray, cKDTree(points).query(points, count))
        radius = np.maximum(distance[:, -1], PAIR_SIGMAS * sigma_mm)
        return cls(index[:, 1:], 4.0 / 3.0 * math.pi * radius**3)

    def density(self, share: FloatArray) -> FloatArray:
        """Return how dense at each point those are that count with ``share`` (n,); their mean counts as one more."""
        mean = (share.sum() + 1.0) / (len(share) + 1.0)
        return np.asarray((share[self.near].sum(axis=1) + mean) / self.volume_mm3)


@dataclass(frozen=True, eq=False)
class Chance:
    """What tells the pairs of a problem's poses from chance: how dense its points lie, the same under every pose."""

    problem: Problem
    ct: Densities
    ots: Densities

    @classmethod
    def of(cls, problem: Problem) -> Chance:
        """Return it for a problem."""
        return cls(problem, *(Densities.of(points, problem.sigma_mm) for points in (problem.ct, problem.ots)))

    def pair_probabilities(self, matrix: FloatArray, partner: IntArray) -> FloatArray:
        """Return the probability of each pair of a pose (3, 4), against outliers that meet and its neighbours."""
        return self._meetings(matrix, partner)[1][partner >= 0]

    def point_probabilities(self, matrix: FloatArray, partner: IntArray) -> FloatArray:
        """Return the probability of each point that it is of a pose's body, whichever of its neighbours it pairs with.

        Of points that compete those of the set in which they are fewer: no two of a set have one partner.
        """
        near, _, odds = self._meetings(matrix, partner)
        n, m = self.problem.counts
        i, j = near.row, near.col + n
        sums = np.bincount(i, odds, n + m) + np.bincount(j, odds, n + m)
        probabilities = sums / (1.0 + sums)
        compete = odds > LEAST_ODDS
        partners = coo_matrix((odds[compete], (i[compete], j[compete])), (n + m, n + m))
        count, cluster = connected_components(partners, directed=False)
        of_ct = np.bincount(cluster[:n], probabilities[:n], count)
        of_ots = np.bincount(cluster[n:], probabilities[n:], count)
        is_ct = np.arange(n + m) < n
        return np.asarray(probabilities[is_ct == (of_ct <= of_ots)[cluster]])

    def _meetings(self, matrix: FloatArray, partner: IntArray) -> tuple[coo_matrix, FloatArray, FloatArray]:
        """Return which points lie near each other under a pose, the probability (n,) of each pair, and all odds.

        Markers of both sets, and the outliers of each, lie with densities of their own: the odds of points (i, j) at
        the distance r are those of the markers times N(r; 0, c), over the product of the outliers' there.  The
        densities about each point are taken from its neighbours, which count as outliers with what is left of their
        own probability.
        """
        problem, (n, m) = self.problem, self.problem.counts
        moved = problem.ct @ matrix[:, :3].T + matrix[:, 3]
        reach = 1.5 * PAIR_SIGMAS * problem.sigma_mm
        near = cKDTree(moved).sparse_distance_matrix(cKDTree(problem.ots), reach, output_type="coo_matrix")
        variance = problem.pair_variances(near.row, near.col)
        likelihood = (2.0 * np.pi * variance) ** -1.5 * np.exp(-0.5 * near.data**2 / variance)
        is_pair = partner[near.row] == near.col
        i, j = near.row[is_pair], near.col[is_pair]
        probabilities, of_ots = (partner >= 0).astype(np.float64), np.bincount(j, minlength=m).astype(np.float64)
        odds = likelihood
        for _ in range(ROUNDS):
            ct, ots = self.ct.density(1.0 - probabilities), self.ots.density(1.0 - of_ots)
            odds = likelihood * self.ct.density(probabilities)[near.row] / (ct[near.row] * ots[near.col])
            sums = np.bincount(near.row, odds, n)[i] + np.bincount(near.col, odds, m)[j]
            probabilities[:], of_ots[:] = 0.0, 0.0
            probabilities[i] = of_ots[j] = odds[is_pair] / (1.0 + sums - odds[is_pair])
        return near, probabilities, odds
