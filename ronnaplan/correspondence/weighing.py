"""Poses of larger sets weighed: the evidence of the pairs that a pose makes, and the best of the distinct ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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
    """A pose and its pairs: ``matrix`` (3, 4) OTS from CT, ``partner`` (n,); their chi^2, and its log evidence."""

    matrix: FloatArray
    partner: IntArray
    chi2: float
    log_evidence: float

    @classmethod
    def weighed(cls, problem: Problem, matrix: FloatArray, partner: IntArray) -> Pose:
        """Return the pose weighed by the pairs that it makes."""
        return cls(matrix, partner, *pose_evidence(problem, partner))

    @cached_property
    def pairs(self) -> IntArray:
        """The pairs (L, 2)."""
        return pairs_of(self.partner)


def pose_evidence(problem: Problem, partner: IntArray, taken: int = 0) -> tuple[float, float]:
    """Return the chi^2 of a pairing, and its log evidence as in `evidence`, with markers as wide as the outliers.

    ``taken``: points of either set that belong to another body and could not have paired.
    """
    i = np.flatnonzero(partner >= 0)
    size, j = len(i), partner[i]
    variance = problem.pair_variances(i, j)
    chi2, volume = fit(problem.ct, problem.ots, problem.weights, i, j, size, math.inf)
    counts = (len(problem.ct) - taken, len(problem.ots) - taken)
    log_evidence = (
        -math.log(min(counts))
        - log_pairings(*counts, size)
        + (size - 1) * math.log(problem.volume_mm3)
        - math.log(8.0 * math.pi**2)
        + (3.0 - 1.5 * size) * math.log(2.0 * math.pi)
        - 1.5 * float(np.log(variance).sum())
        + volume
        + float(log_misfit(chi2, size))
    )
    return float(chi2), float(log_evidence)


def alike(poses: Sequence[Pose], partner: IntArray) -> IntArray:
    """Return which of ``poses`` pair mostly the same points as a ``partner`` (n,) of each CT point does."""
    partners = np.array([pose.partner for pose in poses], dtype=np.int64).reshape(-1, len(partner))
    paired = partners >= 0
    # a sum of truths would take three times as long
    agreeing = np.count_nonzero(paired & (partners == partner), axis=1)
    of_fewer = np.minimum(np.count_nonzero(paired, axis=1), np.count_nonzero(partner >= 0))
    return np.flatnonzero(2 * agreeing > of_fewer)


def add_pose(poses: list[Pose], pose: Pose) -> None:
    """Add a pose, or let it replace one that is `alike` with less evidence; one that chance explains is dropped."""
    if pose.log_evidence < 0:
        return
    same = alike(poses, pose.partner)
    if len(same) == 0:
        poses.append(pose)
    elif pose.log_evidence > poses[same[0]].log_evidence:
        poses[same[0]] = pose
    if len(poses) > MOST_POSES:
        poses.sort(key=lambda one: -one.log_evidence)
        poses.pop()
