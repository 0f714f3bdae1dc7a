"""How probable each pair of a pose is, against outliers that meet by chance where both sets hold many."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ronnaplan.correspondence.densities import BESIDE_SIGMAS, Densities, odds_of_pairs
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.problem import Problem
from ronnaplan.correspondence.refining import PAIR_SIGMAS
from ronnaplan.correspondence.strays import WIDEST, Meetings, sure_pairs
from ronnaplan.correspondence.weighing import PairedPose
from ronnaplan.geometry import FloatArray

LEAST_ODDS = 0.01
"""Points compete for partners with which they pair with larger odds than this: others change their probability by less
than a hundredth each."""


@dataclass(frozen=True, eq=False)
class Claims:
    """The ``odds`` (L,) that points ``i`` and ``j`` (L,) near each other under a pose are a pair of its body.

    ``counts``: of the CT and the OTS points.
    """

    i: IntArray
    j: IntArray
    odds: FloatArray
    counts: tuple[int, int]

    def point_probabilities(self, other: Claims | None = None) -> FloatArray:
        """Return the probability of each point that it is of the body, whichever of its neighbours it pairs with.

        Of points that compete those of the set in which they are fewer: no two of a set have one partner.  What an
        ``other`` body claims is of one of the two: a pair is this body's against all that the other does with its
        points.
        """
        n, m = self.counts
        i, j, odds = self.i, self.j + n, self.odds
        if other is not None:
            odds = odds / other.at_points_of(self)
        sums = np.bincount(i, odds, n + m) + np.bincount(j, odds, n + m)
        probabilities = sums / (1.0 + sums)
        compete = odds > LEAST_ODDS
        cluster = connected(i[compete], j[compete], n + m)
        of_ct = np.bincount(cluster[:n], probabilities[:n], n + m)
        of_ots = np.bincount(cluster[n:], probabilities[n:], n + m)
        is_ct = np.arange(n + m) < n
        return np.asarray(probabilities[is_ct == (of_ct <= of_ots)[cluster]])

    def at_points_of(self, other: Claims) -> FloatArray:
        """Return the odds of whatever the body does with the two points of each pair (L,) of an ``other``, or nothing.

        It pairs them with each other, one of them or each of them with others, or none.
        """
        n, m = self.counts
        of_ct, of_ots = np.bincount(self.i, self.odds, n)[other.i], np.bincount(self.j, self.odds, m)[other.j]
        place, ends = self.i * m + self.j, other.i * m + other.j
        order = np.argsort(place)
        at = order[np.minimum(np.searchsorted(place, ends, sorter=order), len(order) - 1)]
        both = np.where(place[at] == ends, self.odds[at], 0.0)
        return np.asarray(1.0 + both + (of_ct - both) + (of_ots - both) + (of_ct - both) * (of_ots - both))


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
        """Return the probability of each pair of a pose (3, 4) that its body, not chance, brings the two together."""
        return self._meetings(matrix, partner)[3][partner >= 0]

    def right_pairs(self, pose: PairedPose) -> float:
        """Return how many of a pose's pairs are right, as an expectation."""
        return float(self.pair_probabilities(pose.matrix, pose.partner).sum())

    def sure_pairs(self, matrix: FloatArray, partner: IntArray) -> FloatArray:
        """Return the probability of each pair of a pose (3, 4) that it is one marker, against `strays` of it, too."""
        i, j, _, of_body = self._meetings(matrix, partner)
        problem = self.problem
        square = ((problem.ots[j] - problem.ct[i] @ matrix[:, :3].T - matrix[:, 3]) ** 2).sum(axis=1)
        variance = problem.pair_variances(i, j)
        steps = np.array(BESIDE_SIGMAS[:WIDEST]) * problem.sigma_mm
        meetings = Meetings(i, j, square / variance, variance, np.searchsorted(steps**2, square))
        is_made = partner[i] == j
        paired = sure_pairs(meetings, np.where(is_made, of_body[i], 0.0), self.ct, self.ots, problem.sigma_mm)
        own = np.zeros(len(partner))
        own[i[is_made]] = paired[is_made]
        return own[partner >= 0]

    def claims(self, pose: PairedPose) -> Claims:
        """Return which points a pose pairs, each with any of its neighbours."""
        i, j, odds, _ = self._meetings(pose.matrix, pose.partner)
        return Claims(i, j, odds, self.problem.counts)

    def point_probabilities(self, pose: PairedPose) -> FloatArray:
        """Return `Claims.point_probabilities` of a pose; each is asked for it more than once."""
        if pose not in self._of_points:
            self._of_points[pose] = self.claims(pose).point_probabilities()
        return self._of_points[pose]

    @cached_property
    def _of_points(self) -> dict[PairedPose, FloatArray]:
        return {}

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.problem.ots)

    def _meetings(
        self, matrix: FloatArray, partner: IntArray
    ) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
        """Return the points (L,) and (L,) near each other under a pose, and their `odds_of_pairs`."""
        problem = self.problem
        moved = problem.ct @ matrix[:, :3].T + matrix[:, 3]
        reach = 1.5 * PAIR_SIGMAS * problem.sigma_mm
        near = cKDTree(moved).sparse_distance_matrix(self._tree, reach, output_type="ndarray")
        i, j = near["i"].astype(np.int64), near["j"].astype(np.int64)
        variance = problem.pair_variances(i, j)
        likelihood = (2.0 * np.pi * variance) ** -1.5 * np.exp(-0.5 * near["v"] ** 2 / variance)
        return i, j, *odds_of_pairs(i, j, likelihood, partner, self.ct, self.ots)


def connected(i: IntArray, j: IntArray, count: int) -> IntArray:
    """Return for each of ``count`` points the first of those that it is connected with by pairs (i, j), its cluster."""
    cluster = np.arange(count)
    while True:
        before = cluster.copy()
        first = np.minimum(cluster[i], cluster[j])
        for ends in (i, j):
            np.minimum.at(cluster, before[ends], first)
            np.minimum.at(cluster, ends, first)
        cluster = cluster[cluster]
        if (cluster == before).all():
            return cluster
