"""Two rigid bodies that moved against each other: one that was missed is sought, and the larger is the patient."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ronnaplan.correspondence.chance import Chance
from ronnaplan.correspondence.evidence import fits_as_well
from ronnaplan.correspondence.exact import in_volume, not_by_chance, search
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.poses import SUCCESS_SIZES, Found, find_poses, work_allowed
from ronnaplan.correspondence.priors import size_priors
from ronnaplan.correspondence.problem import Problem
from ronnaplan.correspondence.rivals import BODY_NATS, LEAST_REGULAR, LOG_ODDS_PER_PAIR, RIGID_GATE_CHI2
from ronnaplan.correspondence.told import LEAST_PAIRS
from ronnaplan.correspondence.weighing import PairedPose, is_alike, left_by, weigh_pairs
from ronnaplan.geometry import FloatArray
from ronnaplan.rigid import freedom

LIKELY_PAIR = 0.5
"""Pairs of the best pose that are more probable than not are none of a body beside it."""

FEWER_BESIDE, MOST_BESIDE = 2, 1600
"""A body beside the best pose's is sought where it has at most so many pairs fewer (three make odds of 1 %), and there
are up to so many possible pairs: 40 points of either set."""


def points_left(problem: Problem, best: PairedPose, of_pairs: FloatArray) -> tuple[IntArray, IntArray, int]:
    """Return CT (K,) and OTS points (L,) that are none of the best pose's, and how many pairs of theirs are a rival.

    ``of_pairs`` are the probabilities of the best pose's pairs. There are no points where a pair is known, which the
    patient holds; where there is no room for a rival; and where all pairs are doubtful, as of points that stand twice:
    what is left is the same body.
    """
    taken = best.pairs[of_pairs >= LIKELY_PAIR]
    i, j = (np.setdiff1d(np.arange(count), taken[:, axis]) for axis, count in enumerate(problem.counts))
    least = max(round(float(of_pairs.sum())) - FEWER_BESIDE, LEAST_PAIRS)
    if len(problem.known) or len(taken) < LEAST_PAIRS or min(len(i), len(j)) < least:
        return i[:0], j[:0], least
    return i, j, least


def poses_beside(found: Found, best: PairedPose, of_pairs: FloatArray, acceptable: float) -> list[PairedPose]:
    """Return the poses of bodies that would be rivals of the best pose among the points that it leaves.

    A body somewhat smaller than the best is missed more often than an equal among all points. Among those that are left
    its triangles are more, and so many are drawn that it is missed with the ``acceptable`` probability, within what the
    search for all has left of the work allowed.
    """
    problem = found.chance.problem
    i, j, least = points_left(problem, best, of_pairs)
    if len(i) == 0:
        return []
    rest = problem.only(i, j)
    work_done = max(work_allowed(rest) - work_allowed(problem) + found.work, 0.0)
    return find_poses(rest, acceptable, least, work_done).poses


def odds_of_body_beside(problem: Problem, poses: list[PairedPose], of_pairs: FloatArray) -> float:
    """Return the odds that the patient is not the best pose's pairs but a body that was missed, among what they leave.

    ``of_pairs`` are the pairs' probabilities. A small body holds few triangles, so that it may have been missed; it is
    sought by its distances alone. 0 beside bodies that are large enough for the search for poses to be sure of their
    equals, where `points_left` are none, and for a body that was not missed: it is weighed as a rival, by its points.
    """
    size = float(of_pairs.sum())
    i, j, least = points_left(problem, poses[0], of_pairs)
    if size >= SUCCESS_SIZES[0] or not 0 < len(i) * len(j) <= MOST_BESIDE:
        return 0.0
    rest = problem.only(i, j)
    constants, background = size_priors(rest.counts, rest.told)
    constants = in_volume(constants, rest.volume_mm3)
    constants[:least] = -math.inf
    log_evidence, _, partners, _ = search(
        rest.ct,
        rest.ots,
        *rest.pair_weights,
        constants,
        rest.known,
        math.inf,
        BODY_NATS,
        background,
        RIGID_GATE_CHI2,
    )
    if len(log_evidence) == 0:
        return 0.0
    top = int(log_evidence.argmax())
    body = np.full(problem.counts[0], -1)
    paired = partners[top] >= 0
    body[i[paired]] = j[partners[top][paired]]
    if any(is_alike(pose.partner, body) for pose in poses[1:]):
        return 0.0
    real = not_by_chance(float(log_evidence[top]), background)
    return real * math.exp(LOG_ODDS_PER_PAIR * (int(paired.sum()) - size))


def is_other_body(best: PairedPose, rival: PairedPose) -> bool:
    """Tell whether both sets hold the bodies of both poses: they share few points, and the best fits as well.

    As well as the rival, or as errors as stated let it: a rival that fits better than these tells nothing of them.
    What each explains is explained then, whichever is the patient: evidence does not tell.
    """
    size, left = len(rival.pairs), int((left_by(best.partner, rival.partner) >= 0).sum())
    chi2 = max(rival.chi2, float(freedom(size)))
    return 2 * left >= size and fits_as_well(chi2, size, best.chi2, len(best.pairs))


def larger_first(found: Found) -> Found:
    """Return what was found with the largest of its bodies first: of two the larger is the patient, by its points."""
    if not found.poses:
        return found
    points, first = found.chance.point_probabilities, found.poses[0]
    for pose in found.poses:
        if is_other_body(pose, first) and points(pose).sum() > points(first).sum():
            first = pose
    return replace(found, poses=[first, *(pose for pose in found.poses if pose is not first)])


def odds_of_rivals(found: Found) -> float:
    """Return the odds of the poses that were found to the best of them, whose points they explain otherwise.

    By their evidence.  But one that pairs them otherwise and fits as well has those of its size: they are regular (a
    lattice, a circle), and of so many points the noise alone makes evidences differ by many nats.  Another body has
    those of its own points alone, see `odds_of_bodies`.
    """
    best, *others = found.poses
    total, points = 0.0, found.chance.point_probabilities
    for rival in others:
        if is_other_body(best, rival):
            continue
        odds = math.exp(min(rival.log_evidence - best.log_evidence, 0.0))
        if fits_otherwise(best, rival):
            odds = max(odds, odds_by_size(points(best), points(rival)))
        total += odds
    return total


def fits_otherwise(best: PairedPose, rival: PairedPose) -> bool:
    """Tell whether a rival, which is no other body, fits as well as the best: its points are regular."""
    size = len(rival.pairs)
    return size >= LEAST_REGULAR and fits_as_well(best.chi2, len(best.pairs), rival.chi2, size)


def is_regular(found: Found) -> bool:
    """Tell whether a pose that is not clearly smaller than the best pairs the points of its body otherwise."""
    best, *others = found.poses
    least = len(best.pairs) - FEWER_BESIDE
    return any(
        len(pose.pairs) >= least and fits_otherwise(best, pose) and not is_other_body(best, pose)
        for pose in others
    )


def odds_of_bodies(found: Found, best: PairedPose) -> float:
    """Return the odds of the bodies that were found, beside that of the ``best`` pose, to it.

    ``best`` may have been weighed with other errors.
    """
    same = next((pose for pose in found.poses if is_alike(pose.partner, best.partner)), None)
    return sum(odds_of_body(found.chance, same, pose) for pose in found.poses if same and pose is not same)


def odds_of_body(chance: Chance, best: PairedPose, rival: PairedPose) -> float:
    """Return the odds of a rival pose to the best, if it pairs points that the best leaves, and not by chance.

    Then both sets hold two rigid bodies, and evidence does not tell which of them is the patient: the larger is, by
    `LOG_ODDS_PER_PAIR` for each point more, where a point that both claim is of one of them.
    """
    rest = left_by(best.partner, rival.partner)
    if (rest >= 0).sum() < LEAST_PAIRS:
        return 0.0
    alone = weigh_pairs(chance.problem, rest, len(best.pairs))[1]
    real = not_by_chance(alone, 0.0)
    of_best, of_rival = (chance.claims(pose) for pose in (best, rival))
    return real * odds_by_size(of_best.point_probabilities(of_rival), of_rival.point_probabilities(of_best))


def odds_by_size(of_best: FloatArray, of_rival: FloatArray) -> float:
    """Return the odds of a body to the best by the number of its points, which are its own with ``of_rival`` (L,).

    `LOG_ODDS_PER_PAIR` for each more, averaged over which points are a body's own: by their expected numbers alone one
    of two equal bodies would be taken where a few of the other's points are doubtful.  Points count, not pairs: where a
    body is so dense that its points have several neighbours, each of its pairs is doubtful, but not how many there are.
    """
    more = math.exp(LOG_ODDS_PER_PAIR)
    log_odds = np.log1p(of_rival * (more - 1.0)).sum() + np.log1p(of_best * (1.0 / more - 1.0)).sum()
    return math.exp(min(float(log_odds), 0.0))
