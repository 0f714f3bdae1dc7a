"""Matching large sets (hundreds of points, half of them outliers): a seeded search with the same refusals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import binom

from ronnaplan.correspondence.evidence import LEAST_PAIRS, fit, is_collinear, log_misfit, log_pairings
from ronnaplan.correspondence.pairing import IntArray, Pairing, Rival, no_pairs
from ronnaplan.correspondence.seeds import fill_grid, partners_under, poses_of_seed
from ronnaplan.geometry import FloatArray

if TYPE_CHECKING:
    from ronnaplan.correspondence.matching import Problem

SEED_SIGMAS = 3.0
"""Sides of a seed triangle may differ by this many standard deviations of a difference of distances."""

PAIR_SIGMAS = 5.5
"""Points further apart than this many standard deviations under the fitted pose do not pair."""

MISSED_RIVAL = 1e-4
"""Seeds are tried until a rival with as many pairs as the best is missed with at most this probability."""

SEED_SUCCESS = 0.95
"""Probability that a seed of three true markers leads to their pose, measurement errors considered."""

TRIAL_POINTS = 32
"""CT points on which the pose of a seed is tried before all are counted."""

TRIAL_REACH_SIGMAS = 6.0
"""A trial point meets an OTS point within this many standard deviations: a seed's pose is not refined yet."""

CHANCE_PASSES = 1e-4
"""So many hits are needed that a pose passes the trial by chance with this probability at most."""

MOST_SEEDS = 1000
MOST_RIVAL_POSES = 20
REFINEMENTS = 4
LEAST_CELL_MM = 8.0
MOST_CELLS_PER_AXIS = 96


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose and its pairs: ``matrix`` (3, 4) OTS from CT, ``partner`` (n,), and its log evidence."""

    matrix: FloatArray
    partner: IntArray
    log_evidence: float

    @property
    def pairs(self) -> IntArray:
        """The pairs (L, 2)."""
        i = np.flatnonzero(self.partner >= 0)
        return np.column_stack((i, self.partner[i]))

    def is_same_as(self, other: Pose) -> bool:
        """Tell whether two poses pair mostly the same points."""
        paired = (self.partner >= 0) & (other.partner >= 0)
        agree = int((paired & (self.partner == other.partner)).sum())
        return 2 * agree > min(len(self.pairs), len(other.pairs))


def match_large(problem: Problem, least_probability: float) -> Pairing:
    """Match sets too large to enumerate.

    The probability is that of the pose against its rivals; a pair is given when its own probability reaches the
    level too, and is listed as doubtful otherwise (an outlier of each set may meet by chance).  Anisotropic errors
    enter by their mean variance.  The search is seeded, so it repeats itself exactly.
    """
    poses, missed, complete = find_poses(problem)
    if not poses:
        reason = "no pose brings more points together than chance would"
        return Pairing("unmatched", no_pairs(), 0.0, reason=reason)
    best = poses[0]
    below = np.array([best.log_evidence - pose.log_evidence for pose in poses])
    background = math.exp(min(-math.log(min(len(problem.ct), len(problem.ots))) - best.log_evidence, 700.0))
    probability = 1.0 / (float(np.exp(-below).sum()) + missed + background)
    rivals = tuple(Rival(pose.pairs, float(gap)) for pose, gap in zip(poses, below, strict=True))
    if not complete:
        reason = "the points are so dense or so regular that not every pose could be tried"
        return Pairing("ambiguous", no_pairs(), 0.0, rivals, reason, telling_point(poses))
    if probability < least_probability:
        reason = f"the best pose has probability {probability:.4g}, at least {least_probability:g} is required"
        return Pairing("ambiguous", no_pairs(), probability, rivals, reason, telling_point(poses))
    if problem.expected is not None and len(best.pairs) != problem.expected:
        reason = f"{len(best.pairs)} pairs fit but {problem.expected} are expected; check the expected number"
        return Pairing("unmatched", no_pairs(), probability, rivals, reason)
    if 2 * len(best.pairs) < min(len(problem.ct), len(problem.ots)) and is_mirrored(problem, best):
        reason = "the mirror image fits more points: the coordinates of one set are left-handed; check its axes"
        return Pairing("unmatched", no_pairs(), probability, rivals, reason)
    certain = pair_probabilities(problem, best) >= least_probability
    given, doubtful = best.pairs[certain], best.pairs[~certain]
    if len(given) < LEAST_PAIRS or is_collinear(problem.ct[given[:, 0]], problem.sigma_mm):
        reason = "fewer than three pairs off one line are certain"
        return Pairing("ambiguous", no_pairs(), probability, rivals, reason, doubtful=best.pairs)
    return Pairing("unique", given, probability, rivals[1:], doubtful=doubtful)


def find_poses(problem: Problem) -> tuple[list[Pose], float, bool]:
    """Return the distinct poses, best first, the probability that an equal was missed, and if all was tried."""
    rng = np.random.default_rng(len(problem.ct) * 10_007 + len(problem.ots))
    sigma = problem.sigma_mm
    table, grid = distance_table(problem.ots), point_grid(problem.ots)
    needed = needed_hits(len(problem.ots), sigma, problem.volume_mm3)
    poses: list[Pose] = []
    missed, complete = 1.0, True
    for _ in range(MOST_SEEDS):
        seed = draw_seed(rng, problem.ct)
        others = rng.permutation(len(problem.ct))
        trial = others[~np.isin(others, seed)][:TRIAL_POINTS]
        tolerance, reach = SEED_SIGMAS * math.sqrt(2.0) * sigma, TRIAL_REACH_SIGMAS * sigma
        promising, whole = poses_of_seed(
            problem.ct, problem.ots, grid, seed, trial, needed, table, tolerance, reach
        )
        complete &= whole
        for matrix in promising:
            add_pose(poses, refine(problem, grid, matrix))
        if poses:
            share = max(len(pose.pairs) for pose in poses) / len(problem.ct)
            missed *= 1.0 - SEED_SUCCESS * share**3 * float(binom.sf(needed - 1, len(trial), share))
        if missed < MISSED_RIVAL or len(poses) >= MOST_RIVAL_POSES:
            break
    poses.sort(key=lambda pose: -pose.log_evidence)
    return poses, missed, complete


def is_mirrored(problem: Problem, best: Pose) -> bool:
    """Tell whether a reflection, which no patient undergoes, would pair more points than the best pose does."""
    mirrored = find_poses(replace(problem, ct=problem.ct * np.array([-1.0, 1.0, 1.0])))[0]
    return bool(mirrored) and mirrored[0].log_evidence > best.log_evidence


def needed_hits(count: int, sigma_mm: float, volume_mm3: float) -> int:
    """Return how many trial points must meet one of ``count`` OTS points before chance is unlikely."""
    chance = count * 4.0 / 3.0 * math.pi * (TRIAL_REACH_SIGMAS * sigma_mm) ** 3 / volume_mm3
    return max(LEAST_PAIRS, int(binom.isf(CHANCE_PASSES, TRIAL_POINTS, min(chance, 0.5))) + 1)


def draw_seed(rng: np.random.Generator, ct: FloatArray) -> IntArray:
    """Return three CT points that span a wide triangle: the widest of a few drawn ones."""
    drawn = np.array([rng.choice(len(ct), 3, replace=False) for _ in range(4)])
    a, b, c = ct[drawn[:, 0]], ct[drawn[:, 1]], ct[drawn[:, 2]]
    return np.asarray(drawn[np.linalg.norm(np.cross(b - a, c - a), axis=1).argmax()], dtype=np.int64)


def distance_table(points: FloatArray) -> tuple[Any, ...]:
    """Return all distances, each row's neighbours sorted by distance, and all pairs sorted by distance."""
    from ronnaplan.correspondence.exact import distances

    d = distances(points)
    row_order = np.argsort(d, axis=1)
    first, second = np.triu_indices(len(points), 1)
    order = np.argsort(d[first, second])
    pairs = np.column_stack((first[order], second[order]))
    return d, row_order, np.take_along_axis(d, row_order, axis=1), pairs, d[first, second][order]


def point_grid(points: FloatArray) -> tuple[Any, ...]:
    """Return the points sorted into cells for `nearest`."""
    low = points.min(axis=0)
    extent = np.ptp(points, axis=0)
    cell = max(LEAST_CELL_MM, float(extent.max()) / MOST_CELLS_PER_AXIS)
    shape = (extent / cell).astype(np.int64) + 1
    start, order = fill_grid(points, low, cell, shape)
    return start, order, low, cell, shape


def refine(problem: Problem, grid: tuple[Any, ...], matrix: FloatArray) -> Pose | None:
    """Fit a pose to all pairs it makes, repeatedly; None when fewer than three remain or a known pair breaks."""
    from scipy.spatial.transform import Rotation

    sigma = problem.sigma_mm
    partner = np.zeros(0, dtype=np.int64)
    for step in range(REFINEMENTS + 1):
        reach = PAIR_SIGMAS * sigma * (1.6 if step < 2 else 1.0)
        partner = partners_under(problem.ct, problem.ots, grid, matrix, reach)
        i = np.flatnonzero(partner >= 0)
        if len(i) <= LEAST_PAIRS or (partner[problem.known[:, 0]] != problem.known[:, 1]).any():
            return None
        if step < REFINEMENTS:
            x, y = problem.ct[i], problem.ots[partner[i]]
            rotation = Rotation.align_vectors(y - y.mean(axis=0), x - x.mean(axis=0))[0].as_matrix()
            matrix = np.column_stack((rotation, y.mean(axis=0) - rotation @ x.mean(axis=0)))
    return Pose(matrix, partner, pose_log_evidence(problem, partner))


def pose_log_evidence(problem: Problem, partner: IntArray) -> float:
    """Return the log evidence of a pairing as in `evidence`, with markers as widely spread as the outliers."""
    i = np.flatnonzero(partner >= 0)
    variance = problem.ct_errors.variances[:, None] + problem.ots_errors.variances[None, :]
    size, j = len(i), partner[i]
    chi2, volume = fit(problem.ct, problem.ots, 1.0 / variance, i, j, size, math.inf)
    counts = (len(problem.ct), len(problem.ots))
    return (
        -math.log(min(counts))
        - log_pairings(*counts, size)
        + (size - 1) * math.log(problem.volume_mm3)
        - math.log(8.0 * math.pi**2)
        + (3.0 - 1.5 * size) * math.log(2.0 * math.pi)
        - 1.5 * float(np.log(variance[i, j]).sum())
        + float(volume)
        + float(log_misfit(chi2, size))
    )


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


def pair_probabilities(problem: Problem, pose: Pose) -> FloatArray:
    """Return the probability of each pair of a pose, against a chance meeting of outliers and its neighbours.

    The odds of points (i, j) at distance r are V N(r; 0, c) times the prior odds k / ((n - k + 1) (m - k + 1)).
    """
    n, m, k = len(problem.ct), len(problem.ots), len(pose.pairs)
    prior = problem.volume_mm3 * k / ((n - k + 1) * (m - k + 1))
    moved = problem.ct @ pose.matrix[:, :3].T + pose.matrix[:, 3]
    reach = 1.5 * PAIR_SIGMAS * problem.sigma_mm
    near = cKDTree(moved).sparse_distance_matrix(cKDTree(problem.ots), reach, output_type="coo_matrix")
    variance = problem.ct_errors.variances[near.row] + problem.ots_errors.variances[near.col]
    odds = prior * (2.0 * np.pi * variance) ** -1.5 * np.exp(-0.5 * near.data**2 / variance)
    of_ct, of_ots = np.bincount(near.row, odds, n), np.bincount(near.col, odds, m)
    own = {(i, j): value for i, j, value in zip(near.row.tolist(), near.col.tolist(), odds, strict=True)}
    share = [own.get((i, j), 0.0) for i, j in pose.pairs.tolist()]
    return np.array(
        [value / (1.0 + of_ct[i] + of_ots[j] - value) for value, (i, j) in zip(share, pose.pairs, strict=True)]
    )


def telling_point(poses: list[Pose]) -> int | None:
    """Return a CT point that the two best poses pair differently: touching it decides between them."""
    if len(poses) < 2:
        return None
    first, second = poses[0].partner, poses[1].partner
    differing = np.flatnonzero((first >= 0) & (first != second))
    return int(differing[0]) if len(differing) else None
