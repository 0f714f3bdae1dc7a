"""Small sets: every pairing listed and weighed, then one answer or a refusal with its rivals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.correspondence.anisotropic import anisotropic_log_evidence
from ronnaplan.correspondence.another_body import odds_of_another_body
from ronnaplan.correspondence.collinear import is_collinear
from ronnaplan.correspondence.evidence import GATE_CHI2, MOST_ODDS_IF_LARGER, SCALES
from ronnaplan.correspondence.exact import LISTED_NATS, in_volume, search
from ronnaplan.correspondence.pairing import (
    LEFT_HANDED,
    MOST_RIVALS,
    REGULAR,
    TWO_BODIES,
    IntArray,
    Pairing,
    Rival,
    no_pairs,
)
from ronnaplan.correspondence.priors import size_priors
from ronnaplan.correspondence.problem import Problem, moved_pairs, pairs_of
from ronnaplan.correspondence.rivals import (
    LOG_ODDS_OF_MIRROR,
    RIGID_GATE_CHI2,
    mirror_is_better,
    odds_if_larger,
    regular_odds,
)
from ronnaplan.correspondence.strays import side_by_side, told_twice
from ronnaplan.correspondence.told import LEAST_PAIRS
from ronnaplan.geometry import FloatArray
from ronnaplan.rigid import fit_probability
from ronnaplan.sigmas import MISFIT_PROBABILITY

MOST_ODDS_AGAINST_KNOWN = 100.0
"""Known pairs are not believed where pairings that contradict them are so many times as probable without them: about as
rarely does a person point at the wrong marker."""

ON_A_LINE = "the paired points lie on one line, so the rotation about it is unknown; add a marker off the line"
WRONG_NUMBER = "{pairs} pairs fit but {told} are expected; check the markers or the expected number"
SIDE_BY_SIDE = (
    "{pairs} pairs are left without those that lie so near each other that one marker may have been read twice; remove "
    "what is no marker"
)


@dataclass(frozen=True, eq=False)
class Weighed:
    """Pairings by falling log evidence (L,), with their chi^2 (L,), and what weighed them.

    ``partners``: the OTS partner of each CT point in each of them (L, n), -1 for none.
    """

    log_evidence: FloatArray
    chi2: FloatArray
    partners: IntArray
    constants: FloatArray
    background: float

    def posterior(self, other: float = 0.0) -> FloatArray:
        """Return the posterior probability of each pairing, (L,); ``other``: odds of others to the best."""
        top = max(float(self.log_evidence.max(initial=-np.inf)), self.background)
        weights = np.exp(self.log_evidence - top)
        return np.asarray(weights / (weights.sum() + math.exp(self.background - top) + other * weights[0]))

    def rivals(self) -> tuple[Rival, ...]:
        """Return the most probable pairings, the best itself first."""
        below = self.log_evidence[:1] - self.log_evidence[: MOST_RIVALS + 1]
        return tuple(Rival(pairs_of(one), float(gap)) for one, gap in zip(self.partners, below, strict=False))


def match_small(problem: Problem, least_probability: float) -> Pairing | None:
    """Weigh every pairing and decide; None when there are too many to list."""
    weighed = weigh_all(problem)
    if weighed is None:
        return None
    answer = decide(problem, weighed, least_probability)
    if answer.reason != LEFT_HANDED and contradicts_known(problem):
        reason = "the points fit far better without the pairs that were given; check what was pointed at"
        return Pairing.ambiguous(reason, answer.probability, weighed.rivals())
    return answer


def weigh_all(problem: Problem) -> Weighed | None:
    """Enumerate and weigh every pairing of a small problem; None when there are too many."""
    constants, background = size_priors(problem.counts, problem.told, len(problem.known))
    constants = in_volume(constants, problem.volume_mm3)
    log_evidence, chi2, listed, complete = search(
        problem.ct,
        problem.ots,
        *problem.pair_weights,
        constants,
        problem.known,
        problem.spread_mm,
        LISTED_NATS,
        -math.inf,
        GATE_CHI2,
    )
    if not complete:
        return None
    partners = listed.astype(np.int64)
    if problem.is_anisotropic:
        log_evidence, chi2 = anisotropic_log_evidence(problem, partners, constants)
    order = np.argsort(-log_evidence, kind="stable")
    return Weighed(log_evidence[order], chi2[order], partners[order], constants, background)


def decide(problem: Problem, weighed: Weighed, least_probability: float) -> Pairing:
    """Accept the pairs that are certain together, or refuse them with their rivals."""
    mirrored = is_mirrored(problem, weighed)
    if len(weighed.log_evidence) == 0:
        reason = "no three pairs agree in their distances; check that both sets are of this patient, and in mm"
        return Pairing.unmatched(LEFT_HANDED if mirrored else reason)
    other = odds_of_another_body(problem, weighed.partners[0])
    regular = odds_of_another_order(problem, weighed)
    posterior = weighed.posterior(other + regular)
    whole = without_strays(problem, weighed.partners[0])
    core, probability = certain_core(weighed.partners, posterior, whole, problem, least_probability)
    beside = odds_beside_core(problem, weighed, whole != core)
    other, probability = max(other, beside), probability / (1.0 + beside)
    rivals, pairs = weighed.rivals(), pairs_of(core)
    if mirrored:
        return Pairing.unmatched(LEFT_HANDED, probability, rivals)
    if weighed.background >= weighed.log_evidence[0]:
        reason = "the best pairing explains the points no better than chance does"
        return Pairing.unmatched(reason, probability, rivals)
    if not problem.told.allows(len(pairs)):
        reason = WRONG_NUMBER if (whole == weighed.partners[0]).all() else SIDE_BY_SIDE
        reason = reason.format(pairs=len(pairs), told=problem.told)
        return Pairing.unmatched(reason, probability, rivals)
    if probability < least_probability:
        reason = f"the best pairing has probability {probability:.4g}, at least {least_probability:g} is required"
        touch, twice = best_touch(weighed, posterior), told_twice(problem, weighed.partners[0])
        if other > 1.0 - least_probability:
            reason, touch = TWO_BODIES, int(pairs_of(weighed.partners[0])[0, 0])  # of the one or of the other
        elif regular > 1.0 - least_probability:
            reason = REGULAR
        return Pairing.ambiguous(reason + twice, probability, rivals, touch=touch)
    if odds_if_larger(weighed.log_evidence, weighed.chi2, weighed.partners, core) > MOST_ODDS_IF_LARGER:
        reason = (
            f"were the errors {SCALES[-1]:g} times as large as stated, another pairing might be the right one; "
            "have one more marker read, or point at one"
        )
        return Pairing.ambiguous(reason, probability, rivals, touch=best_touch(weighed, posterior))
    if is_collinear(problem.ct[pairs[:, 0]], problem.pair_variances(*pairs.T)):
        return Pairing.ambiguous(ON_A_LINE, probability, rivals)
    left_out, moved = pairs_of(np.where(core < 0, weighed.partners[0], -1)), moved_pairs(problem, core)
    own = posterior @ (weighed.partners[:, pairs[:, 0]] == pairs[:, 1]) / (1.0 + beside)
    return Pairing(
        "unique", pairs, probability, rivals[1:], doubtful=left_out, moved=moved, pair_probabilities=own
    )


def odds_of_another_order(problem: Problem, weighed: Weighed) -> float:
    """Return the odds, to the best pairing, of one that pairs regular markers in another order."""
    weight, _ = problem.pair_weights
    return regular_odds(
        problem.ct,
        problem.ots,
        weight,
        weighed.log_evidence,
        weighed.chi2,
        weighed.partners,
        0,
        weighed.background,
    )


def contradicts_known(problem: Problem) -> bool:
    """Tell whether pairings that contradict a known pair are, without it, far more probable than its own, and chance.

    Those that leave both of its points do not contradict it, for the marker may have moved; nor do the other orders of
    regular markers, which known pairs are to settle. Nothing is told where there are too many pairings to list.
    """
    free = weigh_all(replace(problem, known=no_pairs())) if len(problem.known) else None
    if free is None or free.log_evidence.max(initial=-np.inf) <= free.background:
        return False
    if odds_of_another_order(problem, free) > 1.0 / MOST_ODDS_AGAINST_KNOWN:
        return False
    i, j = problem.known.T
    holds = free.partners[:, i] == j
    paired = (free.partners[:, i] >= 0) | (free.partners[:, :, None] == j).any(axis=1)
    weight = np.exp(free.log_evidence - free.log_evidence[0])
    against, held = weight[(paired & ~holds).any(axis=1)].sum(), weight[holds.all(axis=1)].sum()
    return bool(against > MOST_ODDS_AGAINST_KNOWN * (held + math.exp(free.background - free.log_evidence[0])))


def certain_core(
    partners: IntArray, posterior: FloatArray, whole: IntArray, problem: Problem, least_probability: float
) -> tuple[IntArray, float]:
    """Return the pairing ``whole`` (n,), less the pairs of which it is not certain, and its probability.

    Pairings that differ only in which markers moved, or in which of two points a marker is, do not contradict each
    other in the rest: where they agree, they vouch for it together (markers that change places do contradict it).  So
    the least certain pair is left out, and the next, while that may make the rest certain; otherwise the pairing is
    returned whole.
    """
    core = whole
    if not problem.told.allows(int((core >= 0).sum())):
        return core, float(posterior[0])
    of_another = np.isin(partners, core[core >= 0]) & (partners != core)
    agreeing = ((core < 0) | ~of_another).all(axis=1)
    partners, posterior = partners[agreeing], posterior[agreeing]
    probability = vouched(partners, posterior, core)
    while probability < least_probability:
        i = np.flatnonzero(core >= 0)
        if len(i) <= LEAST_PAIRS or not problem.told.allows(len(i) - 1):
            return whole, vouched(partners, posterior, whole)
        held = (partners[:, i] == core[i]).T.astype(np.float64) @ posterior
        core = core.copy()
        core[i[held.argmin()]] = -1
        probability = vouched(partners, posterior, core)
    return core, probability


def without_strays(problem: Problem, partner: IntArray) -> IntArray:
    """Return a pairing (n,) less the pairs `side_by_side`, but for known ones."""
    i, j = pairs_of(partner).T
    beside = side_by_side(problem.ct[i], problem.ots[j], problem.pair_variances(i, j))
    kept = partner.copy()
    kept[np.setdiff1d(i[beside], problem.known[:, 0])] = -1
    return kept


def vouched(partners: IntArray, posterior: FloatArray, core: IntArray) -> float:
    """Return the probability (of pairings (L, n)) that all pairs of ``core`` (n,) are right."""
    i = np.flatnonzero(core >= 0)
    return float(posterior[(partners[:, i] == core[i]).all(axis=1)].sum())


def odds_beside_core(problem: Problem, weighed: Weighed, dropped: NDArray[np.bool_]) -> float:
    """Return the odds of a body among the points that the best pairing leaves without what was ``dropped`` (n,) of it.

    What is left out for want of certainty is the patient's if errors are so large, and otherwise another body, or
    markers that moved each by itself, which are no body: its distances agree with errors as stated.  Where those of all
    do (`MISFIT_PROBABILITY`), the best pairing is one body.
    """
    core = np.where(dropped, -1, weighed.partners[0])
    size = int((weighed.partners[0] >= 0).sum())
    if not dropped.any() or fit_probability(float(weighed.chi2[0]), size) > MISFIT_PROBABILITY:
        return 0.0
    return odds_of_another_body(problem, core, RIGID_GATE_CHI2)


def is_mirrored(problem: Problem, weighed: Weighed) -> bool:
    """Tell whether a reflection, which no patient undergoes, pairs as many points or more, and far more probably."""
    size = int((weighed.partners[:1] >= 0).sum())
    to_beat = max(float(weighed.log_evidence.max(initial=-np.inf)), weighed.background)
    if not mirror_is_better(
        problem.ct,
        problem.ots,
        *problem.pair_weights,
        weighed.constants,
        problem.known,
        problem.spread_mm,
        size,
        to_beat,
    ):
        return False
    if not problem.is_anisotropic:
        return True
    seen = weigh_all(problem.mirrored())  # the kernel's weights bound anisotropic evidence from above
    return seen is not None and bool(seen.log_evidence.max(initial=-np.inf) > to_beat + LOG_ODDS_OF_MIRROR)


def best_touch(weighed: Weighed, posterior: FloatArray) -> int | None:
    """Return the CT point whose partner is least certain, by a posterior (L,): touching it tells most of the rest."""
    entropy = np.zeros(weighed.partners.shape[1])
    for i, column in enumerate(weighed.partners.T):
        share = np.bincount(column + 1, weights=posterior)
        share = share[share > 0] / share.sum()
        entropy[i] = -(share * np.log(share)).sum()
    return int(entropy.argmax()) if entropy.max() > 0 else None
