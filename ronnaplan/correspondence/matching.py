"""`match_points`: the exact matcher, from raw points to an accepted pairing or a refusal with its rivals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.correspondence.anisotropic import anisotropic_log_evidence
from ronnaplan.correspondence.evidence import filled_volume, is_collinear, size_priors
from ronnaplan.correspondence.exact import LISTED_NATS, mirror_is_better, search
from ronnaplan.correspondence.inputs import (
    ErrorModel,
    checked_errors,
    checked_expected,
    checked_known,
    checked_points,
)
from ronnaplan.correspondence.pairing import IntArray, Pairing, Rival, no_pairs
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM

LEAST_PROBABILITY = 0.99
"""Posterior at which a pairing is accepted.

Most accepted pairings are far more probable: over the paper's protocol fewer than 1 in 10,000 accepted answers are
wrong, in the worst cell too (three markers, four outliers); see docs/correspondence.md."""

MOST_EXACT_POINTS = 32
FEW_POINTS = 12
MOST_EXACT_NODES = 6_000
"""Two sets of up to 32 points, or up to 12 against more, are searched exactly; larger ones by seeds."""

MOST_RIVALS = 10
"""Rivals listed in an answer."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Two checked point sets with their errors, and what is known about their pairing."""

    ct: FloatArray
    ots: FloatArray
    ct_errors: ErrorModel
    ots_errors: ErrorModel
    expected: int | None
    known: IntArray
    volume_mm3: float
    spread_mm: float

    @property
    def sigma_mm(self) -> float:
        """The typical error per axis of a pair's difference."""
        return math.sqrt(float(self.ct_errors.variances.mean() + self.ots_errors.variances.mean()))


@dataclass(frozen=True, eq=False)
class Weighed:
    """Pairings by falling log evidence (L,), as OTS partner of each CT point (L, n), and what weighed them."""

    log_evidence: FloatArray
    partners: IntArray
    constants: FloatArray
    background: float
    complete: bool

    def posterior(self) -> FloatArray:
        """Return the posterior probability of each pairing, (L,)."""
        top = max(float(self.log_evidence.max(initial=-np.inf)), self.background)
        weights = np.exp(self.log_evidence - top)
        return np.asarray(weights / (weights.sum() + math.exp(self.background - top)))

    def pairs(self, index: int) -> IntArray:
        """Return pairing ``index`` as (L, 2)."""
        i = np.flatnonzero(self.partners[index] >= 0)
        return np.column_stack((i, self.partners[index][i])).astype(np.int64)


def match_points(
    ct_points: ArrayLike,
    ots_points: ArrayLike,
    expected: int | None = None,
    sigma_ct_mm: ArrayLike = SIGMA_CT_MM,
    sigma_ots_mm: ArrayLike = SIGMA_OTS_MM,
    *,
    covariances_ct_mm2: ArrayLike | None = None,
    covariances_ots_mm2: ArrayLike | None = None,
    known_pairs: Iterable[tuple[int, int]] = (),
    least_probability: float = LEAST_PROBABILITY,
    field_radius_mm: float | None = None,
    spread_mm: float = 60.0,
) -> Pairing:
    """Pair CT points with tracker points, unordered, with outliers in both sets; be right or refuse.

    Parameters
    ----------
    ct_points, ots_points
        (n, 3) and (m, 3) in mm, each in its own frame.
    expected
        The number of markers seen in both sets; None: inferred.  A sound pairing of another number is refused.
    sigma_ct_mm, sigma_ots_mm
        Standard deviations per axis, one for all points or one a point.
    covariances_ct_mm2, covariances_ots_mm2
        (n, 3, 3) and (m, 3, 3), each in its own frame; they replace the sigma of that set.
    known_pairs
        (CT index, OTS index) of markers that were pointed at; every considered pairing holds them.
    least_probability
        The posterior at which a pairing is accepted, see `LEAST_PROBABILITY`; 0.9999 for a guarantee on each
        answer.
    field_radius_mm
        Outliers are uniform in a ball of this radius (their density); None: in one as wide as the sets themselves.
    spread_mm
        Standard deviation per axis of the markers about their centre: 60 mm for a head.

    Raises
    ------
    InputError
        For fewer than three points, wrong shapes, NaN, units that cannot be mm, errors that are not positive, an
        expected number that the sets cannot hold, or known pairs that name no points.

    """
    ct, ots = checked_points(ct_points, "CT points"), checked_points(ots_points, "OTS points")
    counts = (len(ct), len(ots))
    if not (0.5 < least_probability < 1 and (field_radius_mm is None or field_radius_mm > 0) and spread_mm > 0):
        raise InputError(
            f"least_probability {least_probability}, field_radius_mm {field_radius_mm}, spread_mm {spread_mm}: "
            "expected a probability between 0.5 and 1 and positive lengths"
        )
    problem = Problem(
        ct,
        ots,
        checked_errors(sigma_ct_mm, covariances_ct_mm2, len(ct), "CT points"),
        checked_errors(sigma_ots_mm, covariances_ots_mm2, len(ots), "OTS points"),
        checked_expected(expected, counts),
        checked_known(known_pairs, counts),
        filled_volume(ct, ots) if field_radius_mm is None else 4.0 / 3.0 * math.pi * field_radius_mm**3,
        spread_mm,
    )
    if is_large(counts):
        from ronnaplan.correspondence.large import match_large

        return match_large(problem, least_probability)
    return decide(problem, weigh_all(problem), least_probability)


def is_large(counts: tuple[int, int]) -> bool:
    """Tell whether sets of these sizes are too large for the exact search."""
    if max(counts) <= MOST_EXACT_POINTS:
        return False
    return min(counts) > FEW_POINTS or counts[0] * counts[1] > MOST_EXACT_NODES


def weigh_all(problem: Problem) -> Weighed:
    """Enumerate and weigh every pairing of a small problem."""
    constants, background = size_priors((len(problem.ct), len(problem.ots)), problem.expected, len(problem.known))
    constants = constants + (np.arange(len(constants)) - 1.0) * math.log(problem.volume_mm3)
    weight, node_value = pair_weights(problem)
    log_evidence, partners, complete = search(
        problem.ct,
        problem.ots,
        weight,
        node_value,
        constants,
        problem.known,
        problem.spread_mm,
        LISTED_NATS,
        -math.inf,
    )
    partners = partners.astype(np.int64)
    if problem.ct_errors.covariances is not None or problem.ots_errors.covariances is not None:
        log_evidence = anisotropic_log_evidence(problem, partners, constants)
    order = np.argsort(-log_evidence, kind="stable")
    return Weighed(log_evidence[order], partners[order], constants, background, bool(complete))


def pair_weights(problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Return 1/variance (n, m) of each possible pair and its share -1/2 ln det C of the log evidence.

    For anisotropic errors both bound the evidence from above: the largest variance of each point, and Minkowski's
    inequality det(A + B)^(1/3) >= det(A)^(1/3) + det(B)^(1/3) in whatever way A and B are turned.
    """
    largest: list[FloatArray] = []
    geometric: list[FloatArray] = []
    for errors in (problem.ct_errors, problem.ots_errors):
        if errors.covariances is None:
            largest.append(errors.variances)
            geometric.append(errors.variances)
        else:
            largest.append(np.linalg.eigvalsh(errors.covariances)[:, 2].astype(np.float64))
            geometric.append(np.cbrt(np.linalg.det(errors.covariances)).astype(np.float64))
    weight = 1.0 / (largest[0][:, None] + largest[1][None, :])
    return weight, -1.5 * np.log(geometric[0][:, None] + geometric[1][None, :])


def decide(problem: Problem, weighed: Weighed, least_probability: float) -> Pairing:
    """Accept the most probable pairing or refuse it with its rivals."""
    if len(weighed.log_evidence) == 0:
        return Pairing("unmatched", no_pairs(), 0.0, reason="no three pairs agree in their distances")
    posterior = weighed.posterior()
    top, probability = weighed.pairs(0), float(posterior[0])
    rivals = tuple(
        Rival(weighed.pairs(a), float(weighed.log_evidence[0] - weighed.log_evidence[a]))
        for a in range(min(len(posterior), MOST_RIVALS + 1))
    )
    if not weighed.complete:
        reason = "too many pairings fit almost equally well to list them all"
        return Pairing("ambiguous", no_pairs(), 0.0, rivals, reason, best_touch(weighed, posterior))
    if weighed.background >= weighed.log_evidence[0]:
        reason = "the best pairing explains the points no better than chance does"
        return Pairing("unmatched", no_pairs(), probability, rivals, reason)
    if problem.expected is not None and len(top) != problem.expected:
        reason = (
            f"{len(top)} pairs fit but {problem.expected} are expected; check the markers or the expected number"
        )
        return Pairing("unmatched", no_pairs(), probability, rivals, reason)
    if probability < least_probability:
        reason = f"the best pairing has probability {probability:.4g}, at least {least_probability:g} is required"
        return Pairing("ambiguous", no_pairs(), probability, rivals, reason, best_touch(weighed, posterior))
    if is_collinear(problem.ct[top[:, 0]], problem.sigma_mm):
        reason = (
            "the paired points lie on one line, so the rotation about it is unknown; add a marker off the line"
        )
        return Pairing("ambiguous", no_pairs(), probability, rivals, reason)
    if is_mirrored(problem, weighed):
        reason = "the mirror image fits more points: the coordinates of one set are left-handed; check its axes"
        return Pairing("unmatched", no_pairs(), probability, rivals, reason)
    return Pairing("unique", top, probability, rivals[1:])


def is_mirrored(problem: Problem, weighed: Weighed) -> bool:
    """Tell whether a reflection, which no patient undergoes, would pair more points than the best pairing does."""
    weight, node_value = pair_weights(problem)
    return bool(
        mirror_is_better(
            problem.ct,
            problem.ots,
            weight,
            node_value,
            weighed.constants,
            problem.known,
            problem.spread_mm,
            len(weighed.pairs(0)),
            float(weighed.log_evidence[0]),
        )
    )


def best_touch(weighed: Weighed, posterior: FloatArray) -> int | None:
    """Return the CT point whose partner is least certain: touching it tells most about the rest."""
    entropy = np.zeros(weighed.partners.shape[1])
    for i, column in enumerate(weighed.partners.T):
        share = np.bincount(column + 1, weights=posterior)
        share = share[share > 0] / share.sum()
        entropy[i] = -(share * np.log(share)).sum()
    return int(entropy.argmax()) if entropy.max() > 0 else None
