"""Whether the points that a pairing leaves hold another body, which may be the patient."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ronnaplan.correspondence.anisotropic import anisotropic_log_evidence
from ronnaplan.correspondence.exact import LISTED_NATS, best_of
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.priors import residual_priors
from ronnaplan.correspondence.problem import Problem
from ronnaplan.correspondence.rivals import BODY_GATE_CHI2, BODY_NATS, LOG_ODDS_PER_PAIR, Left, pairings_left
from ronnaplan.correspondence.told import LEAST_PAIRS


def odds_of_another_body(problem: Problem, partner: IntArray, gate_chi2: float = BODY_GATE_CHI2) -> float:
    """Return the odds that the patient is not the pairing ``partner`` (n,) but a body among the points that it leaves.

    A smaller one that has too few pairs to be given is none: three pairs among outliers are too easily had. Nor is
    there one where a pair is known: the patient holds it.
    """
    if len(problem.known):
        return 0.0
    count, real = best_body(problem, partner, gate_chi2)
    size = int((partner >= 0).sum())
    if count == 0 or (count < size and not problem.told.allows(count)):
        return 0.0
    prior = problem.told.prior(range(LEAST_PAIRS, min(problem.counts) + 1))
    return float(real * math.exp(LOG_ODDS_PER_PAIR * (count - size)) * prior[count] / prior[size])


def best_body(problem: Problem, partner: IntArray, gate_chi2: float) -> tuple[int, float]:
    """Return the number of pairs of the best body among the points that ``partner`` (n,) leaves, and if it is real.

    The second is the probability that these pairs are no chance meeting; both are 0 where there is no body.
    """

    def listed(nats: float) -> Left:
        return pairings_left(
            problem.ct,
            problem.ots,
            *problem.pair_weights,
            *residual_priors(problem.counts),
            problem.volume_mm3,
            partner.astype(np.int16),
            nats,
            gate_chi2,
        )

    left = listed(BODY_NATS)
    log_evidence = left.log_evidence
    if len(log_evidence) and problem.is_anisotropic:  # the kernel's weights bound the evidence from above
        of_all = listed(LISTED_NATS)
        if of_all.complete:
            left, alone = of_all, replace(problem.only(of_all.i, of_all.j), spread_mm=math.inf)
            log_evidence, _ = anisotropic_log_evidence(alone, left.partners.astype(np.int64), left.constants)
    best, real = best_of(log_evidence, left.background)
    return (int((left.partners[best] >= 0).sum()), real) if best >= 0 else (0, 0.0)
