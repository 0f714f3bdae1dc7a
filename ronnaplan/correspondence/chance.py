"""How probable each pair of a pose is, against outliers that meet by chance where both sets hold many."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from kernelcache import njit
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.problem import Problem
from ronnaplan.correspondence.refining import PAIR_SIGMAS
from ronnaplan.correspondence.weighing import Pose
from ronnaplan.geometry import FloatArray

ROUNDS = 4
"""Which points are outliers, and how dense these are, are told from each other so often."""

BESIDE_SIGMAS, LEAST_CROWDED = 15.0, 2.0
"""How many times as dense as about its neighbors outliers lie beside a marker is told from all markers, within this. It
counts from twice on: chance, and the edges of a set, make fewer times."""

LEAST_ODDS = 0.01
"""Points compete for partners with which they pair with larger odds than this: others change their probability by less
than a hundredth each."""


class Densities(NamedTuple):
    """How dense a set lies about each point: its nearest others (n, K), and the volume of the ball (n,) that they fill.

    Twice the square root of their number: fewer know a density too poorly, more know it too far away. ``beside``: how
    many of them are within `BESIDE_SIGMAS`, and which volume that is.
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
        close = np.minimum(radius, BESIDE_SIGMAS * sigma_mm)
        return cls(
            np.ascontiguousarray(index[:, 1:], np.int64),
            4.0 / 3.0 * math.pi * radius**3,
            (distance[:, 1:] <= close[:, None]).sum(axis=1),
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
def crowding(densities: Densities, share: FloatArray, outliers: FloatArray) -> float:
    """Return how many times as dense outliers lie beside markers as about these' neighbors; 1 below `LEAST_CROWDED`.

    Points are markers with ``share`` (n,); ``outliers`` (n,) is how dense the outliers lie about each.
    """
    seen = expected = 1.0
    for p in range(len(share)):
        expected += share[p] * outliers[p] * densities.beside_mm3[p]
        for a in range(densities.beside[p]):
            seen += share[p] * (1.0 - share[densities.near[p, a]])
    return seen / expected if seen > LEAST_CROWDED * expected else 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def odds_of_pairs(
    i: IntArray, j: IntArray, likelihood: FloatArray, partner: IntArray, ct: Densities, ots: Densities
) -> tuple[FloatArray, FloatArray]:
    """Return the odds (L,) that points ``i`` and ``j`` (L,) are a pair, and the probability of each pair (n,) made.

    Markers of both sets, and the outliers of each, lie with densities of their own: the odds of a pair of the
    ``likelihood`` N(r; 0, c) (L,), at the distance r, are that times the density of the markers, over the product of
    the outliers' there.  The densities about each point are taken from its neighbours, which count as outliers with
    what is left of their own probability; where one set's outliers lie denser beside markers, see `crowding`, both may
    meet there so much more often.  ``partner`` (n,) tells which pairs are made.
    """
    odds, of_ct, of_ots = likelihood.copy(), np.zeros(len(ct.near)), np.zeros(len(ots.near))
    for p in range(len(partner)):
        if partner[p] >= 0:
            of_ct[p] = of_ots[partner[p]] = 1.0
    for _ in range(ROUNDS):
        markers, only_ct, only_ots = density(ct, of_ct), density(ct, 1.0 - of_ct), density(ots, 1.0 - of_ots)
        crowded = max(crowding(ct, of_ct, only_ct), crowding(ots, of_ots, only_ots))
        at_ct, at_ots = np.zeros(len(of_ct)), np.zeros(len(of_ots))
        for a in range(len(odds)):
            odds[a] = likelihood[a] * markers[i[a]] / (crowded * only_ct[i[a]] * only_ots[j[a]])
            at_ct[i[a]] += odds[a]
            at_ots[j[a]] += odds[a]
        of_ct, of_ots = np.zeros(len(of_ct)), np.zeros(len(of_ots))
        for a in range(len(odds)):
            if partner[i[a]] == j[a]:
                of_ct[i[a]] = of_ots[j[a]] = odds[a] / (1.0 + at_ct[i[a]] + at_ots[j[a]] - odds[a])
    return odds, of_ct


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
        """Return the probability of each pair of a pose (3, 4), against outliers that meet and its neighbours."""
        return self._meetings(matrix, partner)[3][partner >= 0]

    def claims(self, pose: Pose) -> Claims:
        """Return which points a pose pairs, each with any of its neighbours."""
        i, j, odds, _ = self._meetings(pose.matrix, pose.partner)
        return Claims(i, j, odds, self.problem.counts)

    def point_probabilities(self, pose: Pose) -> FloatArray:
        """Return `Claims.point_probabilities` of a pose; each is asked for it more than once."""
        if pose not in self._of_points:
            self._of_points[pose] = self.claims(pose).point_probabilities()
        return self._of_points[pose]

    @cached_property
    def _of_points(self) -> dict[Pose, FloatArray]:
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
