"""Matching larger sets, with any share of outliers: the poses that bring most points together, weighed as rivals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ronnaplan.correspondence.bodies import (
    is_regular,
    larger_first,
    odds_of_bodies,
    odds_of_body_beside,
    odds_of_rivals,
    poses_beside,
)
from ronnaplan.correspondence.chance import Chance
from ronnaplan.correspondence.collinear import LEAST_OFF_LINE, off_one_line
from ronnaplan.correspondence.evidence import AS_WELL_SIGMAS, LEAST_SCALE, SCALES, odds_from_log
from ronnaplan.correspondence.lookup import point_grid
from ronnaplan.correspondence.pairing import (
    LEFT_HANDED,
    MOST_RIVALS,
    REGULAR,
    TWO_BODIES,
    IntArray,
    Pairing,
    Rival,
)
from ronnaplan.correspondence.poses import Found, find_poses, weighed_with, work_allowed
from ronnaplan.correspondence.problem import Problem, moved_pairs, pairs_of
from ronnaplan.correspondence.refining import PAIR_SIGMAS, refined
from ronnaplan.correspondence.rivals import LOG_ODDS_OF_MIRROR
from ronnaplan.correspondence.told import LEAST_PAIRS
from ronnaplan.correspondence.weighing import PairedPose, weigh_pairs
from ronnaplan.geometry import FloatArray

MISSED_SHARE = 0.01
"""Poses are sought until an equal of the best is missed with at most this share of the doubt that is allowed."""

DOUBTED_SCALE = 1.15
"""From here on rivals are sought with such errors, too, and weighed with those that are stated. Of two equal bodies the
other was missed else, for its residuals are taken for smaller than they are where some of its pairs are lost."""

SCALE_ROUNDS = 4
"""So often the size of the errors is told anew, by what pairs within the reach that it gives."""

CHI2_MEDIAN = 2.366
"""Of three degrees of freedom."""

MISSED_MIRROR = 0.01
"""A mirror image that pairs more points is missed with at most this probability."""

MIRROR_SHARE = 0.05
"""Share of the work allowed that is kept for the mirror image of what is refused."""

MORE_IF_MIRRORED = 1.5
"""Right pairs that a mirror image has to have more. That of flat markers has as many, but for those of which noise and
outliers decide: more than this in 8 of 769 scenes of 20 to 200 markers, half of them the densest."""


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
    views = [found]
    if scale > DOUBTED_SCALE:
        larger = find_poses(problem.with_errors(scale), acceptable, work_done=found.work, before=found.poses)
        views = [larger] if scale > LEAST_SCALE else [weighed_with(found, larger.poses), larger]
    views = [larger_first(view) for view in views]
    answer, of_pairs = weighed(views, least_probability)
    if answer.status == "unique":
        beside = poses_beside(views[-1], views[0].poses[0], of_pairs, acceptable)
        views = [larger_first(weighed_with(view, beside)) for view in views]
        answer, of_pairs = weighed(views, least_probability)
    # What is given has its mirror image looked for as thoroughly; a refusal only gets its reason from it.
    work_done = 0.0 if answer.status == "unique" else work_allowed(problem) - kept_back
    if is_mirrored(views[0], work_done):
        return Pairing.unmatched(LEFT_HANDED, answer.probability, rivals_of(views[0].poses))
    return answer


class Doubts(NamedTuple):
    """What else may be right than the best pose: the odds of each to it."""

    of_rivals: float
    """Poses that pair its points otherwise."""
    of_bodies: float
    """Other bodies that were found."""
    of_body_beside: float
    """A body that was missed, among the points that the best leaves."""
    missed: float
    """An equal pose that was missed."""
    by_chance: float
    """No pose: these points met by chance."""

    @property
    def found(self) -> float:
        """Odds of the poses that were found; of two kinds of them the more probable counts."""
        return max(self.of_rivals, self.of_bodies)

    @property
    def probability(self) -> float:
        """Of the best pose."""
        return 1.0 / (1.0 + self.found + self.of_body_beside + self.missed + self.by_chance)


def weighed(views: list[Found], least_probability: float) -> tuple[Pairing, FloatArray]:
    """Return the pairs of the best pose, or the reason why they are not given, and the probability of each (L,).

    ``views``: what was found, weighed with the errors that are taken for true, and with those that are doubted.
    """
    found = views[0]
    if not found.poses:
        return Pairing.unmatched(nothing_found(found)), np.zeros(0)
    best = found.poses[0]
    of_pairs = found.chance.pair_probabilities(best.matrix, best.partner)
    doubts = Doubts(
        odds_of_rivals(found),
        max(odds_of_bodies(view, best) for view in views),
        odds_of_body_beside(found.chance.problem, found.poses, of_pairs),
        found.missed,
        odds_from_log(-best.log_evidence),
    )
    if doubts.probability < least_probability:
        return doubted(found, doubts, of_pairs, least_probability), of_pairs
    return given(found, doubts.probability, least_probability), of_pairs


def doubted(found: Found, doubts: Doubts, of_pairs: FloatArray, least_probability: float) -> Pairing:
    """Return the refusal of the best pose, by what doubts it most.

    ``of_pairs`` (L,) are the probabilities that its pairs do not meet by chance.
    """
    best, rivals, probability = found.poses[0], rivals_of(found.poses), doubts.probability
    if doubts.of_body_beside > max(doubts.found, doubts.missed, doubts.by_chance):
        touch = int(best.pairs[of_pairs.argmax(), 0])  # of the one or of the other
        return Pairing.ambiguous(TWO_BODIES, probability, rivals, touch=touch, doubtful=best.pairs)
    reason = f"the best pose has probability {probability:.4g}, at least {least_probability:g} is required"
    if doubts.found < doubts.missed:
        reason = (
            "the search was given up: the points are so dense or so regular that an equal pose may have been "
            f"missed (probability {doubts.missed:.2g}); leave out what is no marker, or state known pairs"
        )
    elif doubts.found > 1.0 - least_probability:
        is_of_bodies = doubts.of_bodies >= doubts.of_rivals
        reason = TWO_BODIES if is_of_bodies else REGULAR if is_regular(found) else reason
    return Pairing.ambiguous(reason, probability, rivals, touch=telling_point(found.poses))


def given(found: Found, probability: float, least_probability: float) -> Pairing:
    """Return the pairs of the best pose, which has this ``probability``, that are certain themselves, or a refusal."""
    problem, best, rivals = found.chance.problem, found.poses[0], rivals_of(found.poses)
    own = found.chance.sure_pairs(best.matrix, best.partner)
    certain = own >= least_probability
    sure, doubtful = best.pairs[certain], best.pairs[~certain]
    if len(sure) < LEAST_PAIRS or odds_of_turn(problem, sure) * (1.0 - least_probability) < least_probability:
        reason = "fewer than three pairs off one line are certain"
        return Pairing.ambiguous(reason, probability, rivals, doubtful=best.pairs)
    if not problem.told.allows(len(sure)):
        reason = f"{len(sure)} pairs fit but {problem.told} are expected; check the expected number"
        return Pairing.unmatched(reason, probability, rivals)
    moved = moved_pairs(problem, best.partner)
    own = probability * own[certain]
    return Pairing("unique", sure, probability, rivals[1:], doubtful=doubtful, moved=moved, pair_probabilities=own)


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
    of_all = weigh_pairs(problem, partner)[1]
    partner[given[off, 0]] = -1
    return odds_from_log(of_all - weigh_pairs(problem, partner)[1])


def rivals_of(poses: list[PairedPose]) -> tuple[Rival, ...]:
    """Return the best of ``poses`` as rivals, the very best among them; a smaller body may have more evidence."""
    return tuple(
        Rival(pose.pairs, max(float(poses[0].log_evidence - pose.log_evidence), 0.0))
        for pose in poses[: MOST_RIVALS + 1]
    )


def scale_of_errors(chance: Chance, pose: PairedPose) -> float:
    """Return how many times as large as stated the errors are, from the pairs that a pose makes when its reach grows.

    From their median, for outliers that meet by chance lie farther; each counts with its probability under errors
    twice as large as taken so far, for where outliers are dense most meet.  Never less than 1, nor more than believed.
    """
    problem, scale = chance.problem, 1.0
    for _ in range(SCALE_ROUNDS):
        reach = scale * PAIR_SIGMAS * problem.sigma_mm
        grid = point_grid(problem.ots, problem.sigma_mm, reach, reach)
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


def is_mirrored(found: Found, work_done: float) -> bool:
    """Tell whether a reflection, which no patient undergoes, would pair more points than the poses do that were found.

    Or about as many, far nearer to each other than those of the best pose: nearly all markers of a plate fit their
    mirror image as if errors were larger. It is not looked for beyond the work allowed, of which ``work_done`` is done.
    """
    size, log_evidence = 0, LOG_ODDS_OF_MIRROR
    if found.poses:
        size, log_evidence = len(found.poses[0].pairs), found.poses[0].log_evidence
    reflected = find_poses(found.chance.problem.mirrored(), MISSED_MIRROR, size + 1, work_done)
    if not reflected.poses or reflected.poses[0].log_evidence < log_evidence:
        return False
    mirrored = reflected.poses[0]
    most = max((found.chance.right_pairs(pose) for pose in found.poses[:MOST_RIVALS]), default=0.0)
    # Of flat or symmetric markers the noise decides: half the difference of two chi^2, of three freedoms a pair each.
    by_noise = AS_WELL_SIGMAS * math.sqrt(3.0 * len(mirrored.pairs))
    more_probable = mirrored.log_evidence - log_evidence > LOG_ODDS_OF_MIRROR + by_noise
    return reflected.chance.right_pairs(mirrored) - most > MORE_IF_MIRRORED or more_probable


def telling_point(poses: list[PairedPose]) -> int | None:
    """Return a CT point that the two best poses pair differently: touching it decides between them."""
    if len(poses) < 2:
        return None
    first, second = poses[0].partner, poses[1].partner
    differing = np.flatnonzero((first >= 0) & (first != second))
    return int(differing[0]) if len(differing) else None
