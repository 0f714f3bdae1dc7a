"""Matching larger sets, with any share of outliers: the poses that bring most points together, weighed as rivals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ronnaplan.correspondence.chance import Chance
from ronnaplan.correspondence.evidence import LEAST_OFF_LINE, SCALES, fits_as_well, off_one_line
from ronnaplan.correspondence.exact import in_volume, search
from ronnaplan.correspondence.lookup import point_grid
from ronnaplan.correspondence.pairing import (
    LEFT_HANDED,
    MOST_RIVALS,
    TWO_BODIES,
    IntArray,
    Pairing,
    Rival,
    no_pairs,
)
from ronnaplan.correspondence.poses import SUCCESS_SIZES, Found, find_poses, weighed_anew, work_allowed
from ronnaplan.correspondence.priors import size_priors
from ronnaplan.correspondence.problem import Problem, moved_pairs, pairs_of
from ronnaplan.correspondence.refining import PAIR_SIGMAS, refined
from ronnaplan.correspondence.rivals import LOG_ODDS_OF_MIRROR, LOG_ODDS_PER_PAIR
from ronnaplan.correspondence.told import LEAST_PAIRS, Told
from ronnaplan.correspondence.weighing import Pose, alike, pose_evidence
from ronnaplan.geometry import FloatArray

MISSED_SHARE = 0.1
"""Poses are sought until an equal of the best is missed with at most this share of the doubt that is allowed."""

LEAST_SCALE = 1.5
"""Errors this many times as large as stated, by the residuals of the best pose, are taken for what they are, and poses
are sought anew: with errors as stated, pairs of larger ones are lost, and equals are missed."""

DOUBTED_SCALE = 1.15
"""From here on rivals are sought with such errors, too, and weighed with those that are stated. Of two equal bodies the
other was missed else, for its residuals are taken for smaller than they are where some of its pairs are lost."""

SCALE_ROUNDS = 4

CHI2_MEDIAN = 2.366
"""Of three degrees of freedom."""

MISSED_MIRROR = 0.01
"""A mirror image that pairs more points is missed with at most this probability."""

MIRROR_SHARE = 0.05
"""Share of the work allowed that is kept for the mirror image of what is refused."""

MORE_IF_MIRRORED = 1.5
"""Right pairs that a mirror image has to have more. That of flat markers has as many, but for those of which noise and
outliers decide: more than this in 8 of 769 scenes of 20 to 200 markers, half of them the densest."""

LIKELY_PAIR = 0.5
"""Pairs of the best pose that are more probable than not are none of a body beside it."""

BESIDE_CHI2, FEWER_BESIDE, MOST_BESIDE = 12.0, 2, 1600
"""A body beside the best pose's is sought by distances that agree within 3.5 standard deviations, where it has at most
so many pairs fewer (three make odds of 1 %), and there are up to so many possible pairs: 40 points of either set."""


def match_large(problem: Problem, least_probability: float) -> Pairing:
    """Match sets too large to list every pairing of.

    The probability is that of the pose against its rivals; a pair is given when its own probability reaches the
    level too, and is listed as doubtful otherwise (an outlier of each set may meet by chance).  Anisotropic errors
    enter by their mean variance.  The search is seeded, so it repeats itself exactly.
    """
    if len(problem.ct) > len(problem.ots):  # seeds from the smaller set find more
        return match_large(problem.swapped(), least_probability).swapped()
    acceptable = MISSED_SHARE * (1.0 - least_probability)
    kept_back = MIRROR_SHARE * work_allowed(problem)
    found = find_poses(problem, acceptable, work_done=kept_back)
    scale = scale_of_errors(found.chance, found.poses[0]) if found.poses else 1.0
    if scale > DOUBTED_SCALE:
        larger = problem.with_errors(scale)
        wider = find_poses(larger, acceptable, work_done=found.work, before=found.poses)
        if scale > LEAST_SCALE:
            problem, found = larger, wider
        else:
            found = replace(found, poses=weighed_anew(problem, [*found.poses, *wider.poses]), work=wider.work)
    best = found.poses[0] if found.poses else None
    of_pairs = np.zeros(0) if best is None else found.chance.pair_probabilities(best.matrix, best.partner)
    answer = weighed(problem, found, of_pairs, least_probability)
    # What is given has its mirror image looked for as thoroughly; a refusal only gets its reason from it.
    work_done = 0.0 if answer.status == "unique" else work_allowed(problem) - kept_back
    if is_mirrored(problem, best, float(of_pairs.sum()), work_done):
        return Pairing("unmatched", no_pairs(), answer.probability, rivals_of(found.poses), LEFT_HANDED)
    return answer


def weighed(problem: Problem, found: Found, of_pairs: FloatArray, least_probability: float) -> Pairing:
    """Return the pairs of the best pose that was found, or the reason why they are not given.

    ``of_pairs`` are their probabilities.
    """
    if not found.poses:
        return Pairing("unmatched", no_pairs(), 0.0, reason=nothing_found(found))
    best = found.poses[0]
    rivals = rivals_of(found.poses)
    others, beside = odds_of_rivals(found), odds_of_body_beside(problem, found.poses, of_pairs)
    by_chance = math.exp(min(-best.log_evidence, 700.0))
    probability = 1.0 / (1.0 + others + beside + found.missed + by_chance)
    if probability < least_probability and beside > max(others, found.missed, by_chance):
        touch = int(best.pairs[of_pairs.argmax(), 0])  # of the one or of the other
        return Pairing("ambiguous", no_pairs(), probability, rivals, TWO_BODIES, touch, best.pairs)
    if probability < least_probability:
        reason = f"the best pose has probability {probability:.4g}, at least {least_probability:g} is required"
        if others < found.missed:
            reason = (
                "the search was given up: the points are so dense or so regular that an equal pose may have been "
                f"missed (probability {found.missed:.2g}); leave out what is no marker, or state known pairs"
            )
        return Pairing("ambiguous", no_pairs(), probability, rivals, reason, telling_point(found.poses))
    certain = of_pairs >= least_probability
    given, doubtful = best.pairs[certain], best.pairs[~certain]
    if len(given) < LEAST_PAIRS or odds_of_turn(problem, given) * (1.0 - least_probability) < least_probability:
        reason = "fewer than three pairs off one line are certain"
        return Pairing("ambiguous", no_pairs(), probability, rivals, reason, doubtful=best.pairs)
    if not problem.told.allows(len(given)):
        reason = f"{len(given)} pairs fit but {problem.told} are expected; check the expected number"
        return Pairing("unmatched", no_pairs(), probability, rivals, reason)
    moved = moved_pairs(problem, best.partner)
    return Pairing("unique", given, probability, rivals[1:], doubtful=doubtful, moved=moved)


def odds_of_turn(problem: Problem, given: IntArray) -> float:
    """Return the odds that the pairs ``given`` (L, 2) which lie off a line of the others are right, not met by chance.

    A row leaves the turn about itself open, so that a pose may take the one that brings two outliers together: these
    hold their place by the evidence of all over that of the row.
    """
    off = off_one_line(problem.ct[given[:, 0]], problem.pair_variances(*given.T))
    if off.sum() >= LEAST_OFF_LINE or np.isin(given[off, 0], problem.known[:, 0]).any():
        return math.inf
    partner = np.full(problem.counts[0], -1)
    partner[given[:, 0]] = given[:, 1]
    of_all = pose_evidence(problem, partner)[1]
    partner[given[off, 0]] = -1
    return math.exp(min(of_all - pose_evidence(problem, partner)[1], 700.0))


def odds_of_body_beside(problem: Problem, poses: list[Pose], of_pairs: FloatArray) -> float:
    """Return the odds that the patient is not the best pose's pairs but a body that was missed, among what they leave.

    ``of_pairs`` are the pairs' probabilities. Few triangles lead to the pose of a small thin body (a plate, a row), so
    that it may have been missed; it is sought by its distances alone. 0 beside bodies that are large enough for the
    search for poses to be sure of their equals, where a pair is known, which the patient holds, for a body that
    was not missed: it is weighed as a rival, by its points; and where all pairs are doubtful, as of points that stand
    twice: what is left is the same body.
    """
    taken, size = poses[0].pairs[of_pairs >= LIKELY_PAIR], float(of_pairs.sum())
    i, j = (np.setdiff1d(np.arange(count), taken[:, axis]) for axis, count in enumerate(problem.counts))
    least = max(round(size) - FEWER_BESIDE, LEAST_PAIRS)
    small = len(taken) >= LEAST_PAIRS and size < SUCCESS_SIZES[0] and len(problem.known) == 0
    if not small or min(len(i), len(j)) < least or len(i) * len(j) > MOST_BESIDE:
        return 0.0
    constants, background = size_priors((len(i), len(j)), Told())
    constants = in_volume(constants, problem.volume_mm3)
    constants[:least] = -math.inf
    weight, value = (pairs[np.ix_(i, j)] for pairs in problem.pair_weights())
    log_evidence, _, partners, _ = search(
        problem.ct[i], problem.ots[j], weight, value, constants, no_pairs(), math.inf, 1.0, background, BESIDE_CHI2
    )
    if len(log_evidence) == 0:
        return 0.0
    top = int(log_evidence.argmax())
    body = np.full(problem.counts[0], -1)
    paired = partners[top] >= 0
    body[i[paired]] = j[partners[top][paired]]
    if len(alike(poses[1:], body)):
        return 0.0
    real = 1.0 / (1.0 + math.exp(min(background - log_evidence[top], 700.0)))
    return real * math.exp(LOG_ODDS_PER_PAIR * (int(paired.sum()) - size))


def rivals_of(poses: list[Pose]) -> tuple[Rival, ...]:
    """Return the best of ``poses`` as rivals, the very best among them."""
    return tuple(
        Rival(pose.pairs, float(poses[0].log_evidence - pose.log_evidence)) for pose in poses[: MOST_RIVALS + 1]
    )


def scale_of_errors(chance: Chance, pose: Pose) -> float:
    """Return how many times as large as stated the errors are, from the pairs that a pose makes when its reach grows.

    From their median, for outliers that meet by chance lie farther; each counts with its probability under errors
    twice as large as taken so far, for where outliers are dense most meet.  Never less than 1, nor more than believed.
    """
    problem, scale = chance.problem, 1.0
    for _ in range(SCALE_ROUNDS):
        reach = scale * PAIR_SIGMAS * problem.sigma_mm
        grid = point_grid(problem.ots, problem.sigma_mm, reach)
        (matrix,), (partner,) = refined(problem.ct, problem.ots, grid, pose.matrix[None], np.full(3, reach))
        pairs = pairs_of(partner)
        larger = replace(chance, problem=problem.with_errors(2.0 * scale))
        right = larger.pair_probabilities(matrix, partner)
        if len(pairs) < LEAST_PAIRS or right.sum() <= 2.0:
            break
        off = problem.ots[pairs[:, 1]] - problem.ct[pairs[:, 0]] @ matrix[:, :3].T - matrix[:, 3]
        chi2 = (off**2).sum(axis=1) / problem.pair_variances(*pairs.T)
        order = np.argsort(chi2)
        half = int(np.searchsorted(np.cumsum(right[order]), 0.5 * right.sum()))
        middle = chi2[order[half]] / CHI2_MEDIAN * right.sum() / max(right.sum() - 2.0, 1.0)
        before, scale = scale, min(max(math.sqrt(middle), 1.0), SCALES[-1])
        if scale < 1.1 * before:
            break
    return scale


def nothing_found(found: Found) -> str:
    """Say that no pose was found, and how many pairs one would have had to have to be found for sure."""
    reason = "no pose brings more points together than chance would"
    if found.complete:
        return reason
    return f"{reason}; the search was given up before poses of fewer than {found.least_sure} pairs were sure to be seen"


def odds_of_rivals(found: Found) -> float:
    """Return the odds of the poses that were found to the best of them."""
    best, *others = found.poses
    of_best = found.chance.point_probabilities(best.matrix, best.partner) if others else np.zeros(0)
    return sum(rival_odds(found.chance, best, of_best, pose) for pose in others)


def rival_odds(chance: Chance, best: Pose, of_best: FloatArray, rival: Pose) -> float:
    """Return the odds of a rival pose to the best, of whose body points are with the probabilities ``of_best``.

    Two poses explain the same points by their evidence.  But where the rival pairs points that the best leaves,
    and more of them than chance would, both sets hold two rigid bodies, and evidence does not tell which of them
    is the patient: the larger is, by `LOG_ODDS_PER_PAIR` for each point more.  The same goes for a rival that pairs
    the same points otherwise and fits as well: they are regular (a lattice, a circle), and of so many points the
    noise alone makes evidences differ by many nats.
    """
    by_evidence = math.exp(min(rival.log_evidence - best.log_evidence, 0.0))
    by_size = odds_by_size(of_best, chance.point_probabilities(rival.matrix, rival.partner))
    if fits_as_well(best.chi2, len(best.pairs), rival.chi2, len(rival.pairs)):
        return max(by_evidence, by_size)
    pairs = best.pairs
    rest = np.where(np.isin(np.arange(len(rival.partner)), pairs[:, 0]), -1, rival.partner)
    rest = np.where(np.isin(rest, pairs[:, 1]), -1, rest)
    if (rest >= 0).sum() < LEAST_PAIRS:
        return by_evidence
    alone = pose_evidence(chance.problem, rest, len(pairs))[1]
    real = 1.0 / (1.0 + math.exp(min(-alone, 700.0)))
    return max(by_evidence, real * by_size)


def odds_by_size(of_best: FloatArray, of_rival: FloatArray) -> float:
    """Return the odds of a body to the best by the number of its points, which are its own with ``of_rival`` (L,).

    `LOG_ODDS_PER_PAIR` for each more, averaged over which points are a body's own: by their expected numbers alone one
    of two equal bodies would be taken where a few of the other's points are doubtful.  Points count, not pairs: where a
    body is so dense that its points have several neighbours, each of its pairs is doubtful, but not how many there are.
    """
    more = math.exp(LOG_ODDS_PER_PAIR)
    log_odds = np.log1p(of_rival * (more - 1.0)).sum() + np.log1p(of_best * (1.0 / more - 1.0)).sum()
    return math.exp(min(float(log_odds), 0.0))


def is_mirrored(problem: Problem, best: Pose | None, of_best: float, work_done: float) -> bool:
    """Tell whether a reflection, which no patient undergoes, would pair more points than the best pose does, if any.

    ``of_best`` of its pairs are right, as an expectation. It is not looked for beyond the work allowed, of which
    ``work_done`` is done.
    """
    size, log_evidence = (0, LOG_ODDS_OF_MIRROR) if best is None else (len(best.pairs), best.log_evidence)
    found = find_poses(problem.mirrored(), MISSED_MIRROR, size + 1, work_done)
    if not found.poses or found.poses[0].log_evidence < log_evidence:
        return False
    mirrored = found.poses[0]
    of_mirrored = float(found.chance.pair_probabilities(mirrored.matrix, mirrored.partner).sum())
    return of_mirrored - of_best > MORE_IF_MIRRORED


def telling_point(poses: list[Pose]) -> int | None:
    """Return a CT point that the two best poses pair differently: touching it decides between them."""
    if len(poses) < 2:
        return None
    first, second = poses[0].partner, poses[1].partner
    differing = np.flatnonzero((first >= 0) & (first != second))
    return int(differing[0]) if len(differing) else None
