"""What a matcher is to solve: two checked point sets, their errors, and what is known of their pairing."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ronnaplan.correspondence.inputs import ErrorModel
from ronnaplan.correspondence.pairing import IntArray, no_pairs
from ronnaplan.correspondence.told import Told
from ronnaplan.geometry import MIRROR, FloatArray
from ronnaplan.rigid import fit_closed_form
from ronnaplan.transforms import transform_points

MOVED_MM = 20.0
"""Markers that were knocked lie no further than this from where the others say that they should be."""

FITS_SIGMAS = 4.0
"""Points that lie no further than this many standard deviations (per axis) from each other fit: no marker moved."""

CHANCE_NEIGHBOUR = 0.05
"""Points count as one moved marker only where two outliers meet as closely with this probability at most."""

FAR_LARGER = 10.0
"""Points that err by so many times as much as usual weigh less than a hundredth in a fit: how near each other pairs lie
is not told by them. One reading of 50 mm and more made all others of a large set be refused."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Two checked point sets (n, 3) and (m, 3) in mm with their errors, and what is known about their pairing."""

    ct: FloatArray
    ots: FloatArray
    ct_errors: ErrorModel
    ots_errors: ErrorModel
    told: Told
    known: IntArray
    volume_mm3: float
    spread_mm: float

    @property
    def counts(self) -> tuple[int, int]:
        """The number of CT and of OTS points."""
        return len(self.ct), len(self.ots)

    @cached_property
    def sigma_mm(self) -> float:
        """The typical error per axis of a pair's difference: the root mean square of all but far larger ones."""
        variances = self.ct_errors.variances, self.ots_errors.variances
        most = FAR_LARGER**2 * sum(float(np.median(of_set)) for of_set in variances)
        return math.sqrt(sum(float(of_set[of_set <= most].mean()) for of_set in variances))

    def pair_variances(self, i: NDArray[np.integer], j: NDArray[np.integer]) -> FloatArray:
        """Return the variance (L,) per axis of the difference of each pair of the points ``i`` and ``j`` (L,)."""
        variances: FloatArray = self.ct_errors.variances[i] + self.ots_errors.variances[j]
        return variances

    @cached_property
    def weights(self) -> FloatArray:
        """1/variance (n, m) per axis of the difference of each possible pair."""
        return np.asarray(1.0 / (self.ct_errors.variances[:, None] + self.ots_errors.variances))

    @property
    def is_anisotropic(self) -> bool:
        """Whether any error is stated as a full covariance."""
        return self.ct_errors.covariances is not None or self.ots_errors.covariances is not None

    def swapped(self) -> Problem:
        """Return the problem with the sets exchanged."""
        return replace(
            self,
            ct=self.ots,
            ots=self.ct,
            ct_errors=self.ots_errors,
            ots_errors=self.ct_errors,
            known=np.ascontiguousarray(self.known[:, ::-1]),
        )

    def mirrored(self) -> Problem:
        """Return the problem with the CT's mirror image."""
        return replace(self, ct=self.ct * MIRROR, ct_errors=self.ct_errors.mirrored())

    def only(self, i: IntArray, j: IntArray) -> Problem:
        """Return the problem of the CT points ``i`` (K,) and OTS points ``j`` (L,) alone, of which nothing is told."""
        return replace(
            self,
            ct=self.ct[i],
            ots=self.ots[j],
            ct_errors=self.ct_errors.of(i),
            ots_errors=self.ots_errors.of(j),
            told=Told(),
            known=no_pairs(),
        )

    def with_errors(self, scale: float) -> Problem:
        """Return the problem with errors so many times as large."""
        return replace(self, ct_errors=self.ct_errors.scaled(scale), ots_errors=self.ots_errors.scaled(scale))

    @cached_property
    def pair_weights(self) -> tuple[FloatArray, FloatArray]:
        """1/variance (n, m) of each possible pair, and its share (n, m), -1/2 ln det C, of the log evidence.

        For anisotropic errors both bound the evidence from above: the largest variance of each point, and
        Minkowski's inequality det(A + B)^(1/3) >= det(A)^(1/3) + det(B)^(1/3) in whatever way A and B are turned.
        """
        largest: list[FloatArray] = []
        geometric: list[FloatArray] = []
        for errors in (self.ct_errors, self.ots_errors):
            if errors.covariances is None:
                largest.append(errors.variances)
                geometric.append(errors.variances)
            else:
                largest.append(np.linalg.eigvalsh(errors.covariances)[:, 2].astype(np.float64))
                geometric.append(np.cbrt(np.linalg.det(errors.covariances)).astype(np.float64))
        weight = 1.0 / (largest[0][:, None] + largest[1][None, :])
        return weight, -1.5 * np.log(geometric[0][:, None] + geometric[1][None, :])


def pairs_of(partner: IntArray) -> IntArray:
    """Return the pairs (L, 2) of a pairing given as the OTS partner of each CT point (n,), -1 for none."""
    i = np.flatnonzero(partner >= 0)
    return np.column_stack((i, partner[i])).astype(np.int64)


def moved_pairs(problem: Problem, partner: IntArray) -> IntArray:
    """Return the pairs (S, 2) of points left over that lie next to each other under a pairing's pose.

    They are beyond their errors, so they do not pair, yet nearer (mutually nearest, within `MOVED_MM`) than chance
    would bring two points of these sets: a marker that moved, most likely.
    """
    pairs = pairs_of(partner)
    i, j = (np.setdiff1d(np.arange(count), pairs[:, axis]) for axis, count in enumerate(problem.counts))
    if len(i) == 0 or len(j) == 0:
        return no_pairs()
    chance_mm = (CHANCE_NEIGHBOUR * problem.volume_mm3 / (4.0 / 3.0 * math.pi * len(i) * len(j))) ** (1.0 / 3.0)
    pose = fit_closed_form(problem.ct[pairs[:, 0]], problem.ots[pairs[:, 1]])
    gap = np.linalg.norm(transform_points(pose, problem.ct[i])[:, None] - problem.ots[j][None], axis=2)
    nearest = gap.argmin(axis=1)
    beyond = gap.min(axis=1) > FITS_SIGMAS * np.sqrt(problem.pair_variances(i, j[nearest]))
    mutual = (gap.argmin(axis=0)[nearest] == np.arange(len(i))) & (gap.min(axis=1) < min(MOVED_MM, chance_mm))
    return np.column_stack((i[mutual & beyond], j[nearest[mutual & beyond]]))
