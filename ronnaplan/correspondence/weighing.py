"""Poses of larger sets weighed: the evidence of the pairs that a pose makes, and the best of the distinct ones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kernelcache import njit
from ronnaplan.correspondence.evidence import fit, log_misfit
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.priors import log_pairings
from ronnaplan.correspondence.problem import Problem, pairs_of
from ronnaplan.geometry import FloatArray

MOST_POSES = 20
"""Rival poses kept."""


@dataclass(frozen=True, eq=False)
class PairedPose:
    """A pose and its pairs: ``matrix`` (3, 4) OTS from CT, ``partner`` (n,); their chi^2, and its log evidence."""

    matrix: FloatArray
    partner: IntArray
    chi2: float
    log_evidence: float

    @cached_property
    def pairs(self) -> IntArray:
        """The pairs (L, 2)."""
        return pairs_of(self.partner)


def poses_of(problem: Problem, matrices: FloatArray, partners: IntArray) -> list[PairedPose]:
    """Return those of poses (K, 3, 4) and their pairs (K, n) that chance does not explain, weighed by these."""
    chi2, log_evidence = evidences(problem.ct, problem.ots, problem.weights, problem.volume_mm3, partners)
    return [
        PairedPose(matrices[k], partners[k], float(chi2[k]), float(log_evidence[k]))
        for k in np.flatnonzero(log_evidence >= 0.0)
    ]


def weigh_pairs(problem: Problem, partner: IntArray, taken: int = 0) -> tuple[float, float]:
    """Return the chi^2 of a pairing (n,) and its log evidence, see `pose_evidence`."""
    return pose_evidence(problem.ct, problem.ots, problem.weights, problem.volume_mm3, partner, taken)


@njit(cache=True, nogil=True, error_model="numpy")
def pose_evidence(
    ct: FloatArray, ots: FloatArray, weight: FloatArray, volume: float, partner: IntArray, taken: int
) -> tuple[float, float]:
    """Return the chi^2 of a pairing, and its log evidence as in `evidence`, with markers as wide as the outliers.

    ``weight`` (n, m): 1/variance of a pair; ``partner`` (n,); ``taken``: points of either set that belong to another
    body and could not have paired.
    """
    i = np.flatnonzero(partner >= 0)
    j, size = partner[i], len(i)
    n, m = len(ct) - taken, len(ots) - taken
    chi2, log_evidence = fit(ct, ots, weight, i, j, size, math.inf)
    for a in range(size):
        log_evidence += 1.5 * math.log(weight[i[a], j[a]])
    log_evidence += (size - 1) * math.log(volume) - math.log(8.0 * math.pi**2) - math.log(min(n, m))
    log_evidence += (3.0 - 1.5 * size) * math.log(2.0 * math.pi) - log_pairings(n, m, size, 0)
    return chi2, log_evidence + log_misfit(chi2, size)


@njit(cache=True, nogil=True, error_model="numpy")
def evidences(
    ct: FloatArray, ots: FloatArray, weight: FloatArray, volume: float, partners: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the chi^2 (K,) and the log evidences (K,) of pairings (K, n), see `pose_evidence`."""
    chi2, log_evidence = np.empty(len(partners)), np.empty(len(partners))
    for k in range(len(partners)):
        chi2[k], log_evidence[k] = pose_evidence(ct, ots, weight, volume, partners[k], 0)
    return chi2, log_evidence


@njit(cache=True, nogil=True, error_model="numpy")
def is_alike(partner: IntArray, other: IntArray) -> bool:
    """Tell whether two pairings, each the partner (n,) of each CT point, pair mostly the same points."""
    agreeing = of_one = of_other = 0
    for i in range(len(partner)):
        of_one += partner[i] >= 0
        of_other += other[i] >= 0
        agreeing += partner[i] >= 0 and partner[i] == other[i]
    return 2 * agreeing > min(of_one, of_other)


@njit(cache=True, nogil=True, error_model="numpy")
def left_by(best: IntArray, partner: IntArray) -> IntArray:
    """Return a pairing (n,) less the pairs of which either point is one that the pairing ``best`` (n,) claims."""
    claimed = np.zeros(max(best.max(), partner.max()) + 1, np.bool_)
    for i in range(len(best)):
        if best[i] >= 0:
            claimed[best[i]] = True
    rest = partner.copy()
    for i in range(len(rest)):
        if rest[i] >= 0 and (best[i] >= 0 or claimed[rest[i]]):
            rest[i] = -1
    return rest


def add_pose(poses: list[PairedPose], pose: PairedPose) -> None:
    """Add a pose, or let it replace one that `is_alike` with less evidence."""
    same = next((k for k, one in enumerate(poses) if is_alike(one.partner, pose.partner)), None)
    if same is None:
        poses.append(pose)
    elif pose.log_evidence > poses[same].log_evidence:
        poses[same] = pose
    if len(poses) > MOST_POSES:
        poses.sort(key=lambda one: -one.log_evidence)
        poses.pop()
