"""Poses of larger sets weighed: the evidence of the pairs that a pose makes, and the best of the distinct ones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ronnaplan.correspondence.evidence import fit, log_misfit
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.priors import log_pairings
from ronnaplan.correspondence.problem import Problem, pairs_of
from ronnaplan.geometry import FloatArray

MOST_POSES = 20
"""Rival poses kept."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose and its pairs: ``matrix`` (3, 4) OTS from CT, ``partner`` (n,), and its log evidence."""

    matrix: FloatArray
    partner: IntArray
    log_evidence: float

    @property
    def pairs(self) -> IntArray:
        """The pairs (L, 2)."""
        return pairs_of(self.partner)

    def is_same_as(self, other: Pose) -> bool:
        """Tell whether two poses pair mostly the same points."""
        agree = int(((self.partner >= 0) & (self.partner == other.partner)).sum())
        return 2 * agree > min(len(self.pairs), len(other.pairs))


def pose_log_evidence(problem: Problem, partner: IntArray, taken: int = 0) -> float:
    """Return the log evidence of a pairing as in `evidence`, with markers as widely spread as the outliers.

    ``taken``: points of either set that belong to another body and could not have paired.
    """
    variance, chi2, volume = pose_fit(problem, partner)
    size = len(variance)
    counts = (len(problem.ct) - taken, len(problem.ots) - taken)
    return (
        -math.log(min(counts))
        - log_pairings(*counts, size)
        + (size - 1) * math.log(problem.volume_mm3)
        - math.log(8.0 * math.pi**2)
        + (3.0 - 1.5 * size) * math.log(2.0 * math.pi)
        - 1.5 * float(np.log(variance).sum())
        + volume
        + float(log_misfit(chi2, size))
    )


def pose_fit(problem: Problem, partner: IntArray) -> tuple[FloatArray, float, float]:
    """Return the variances (L,) of a pairing's differences, and what `evidence.fit` says of it: chi^2 and volume."""
    i = np.flatnonzero(partner >= 0)
    size, j = len(i), partner[i]
    variance = problem.ct_errors.variances[i] + problem.ots_errors.variances[j]
    index, weight = np.arange(size), np.tile(1.0 / variance, (size, 1))
    chi2, volume = fit(problem.ct[i], problem.ots[j], weight, index, index, size, math.inf)
    return variance, float(chi2), float(volume)


def add_pose(poses: list[Pose], pose: Pose | None) -> None:
    """Add a pose, or let it replace the same pose with less evidence; one that chance explains is dropped."""
    if pose is None or pose.log_evidence < 0:
        return
    for index, other in enumerate(poses):
        if pose.is_same_as(other):
            if pose.log_evidence > other.log_evidence:
                poses[index] = pose
            return
    poses.append(pose)
    if len(poses) > MOST_POSES:
        poses.sort(key=lambda one: -one.log_evidence)
        poses.pop()
