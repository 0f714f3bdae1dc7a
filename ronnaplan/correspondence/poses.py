"""The search for poses: triangles drawn alike from all, until an equal of the best can hardly have been missed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import bdtrc

from ronnaplan.correspondence.evidence import fit, log_misfit
from ronnaplan.correspondence.exact import distances
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.priors import log_pairings
from ronnaplan.correspondence.problem import Problem, pairs_of
from ronnaplan.correspondence.seeds import (
    FIRST_TRIALS,
    REACH_SIGMAS,
    WIDEST_REACH_SIGMAS,
    fill_grid,
    poses_of_seeds,
    refined,
    row_starts,
)
from ronnaplan.correspondence.told import LEAST_PAIRS
from ronnaplan.geometry import FloatArray

PAIR_SIGMAS = 5.5
"""Points further apart than this many standard deviations under the fitted pose do not pair."""

REFINING_SIGMAS = (1.6 * PAIR_SIGMAS, 1.6 * PAIR_SIGMAS, PAIR_SIGMAS, PAIR_SIGMAS, PAIR_SIGMAS)
"""How near pairs must be in each fit of a pose: the first rest on three points only."""

SIDES_CHI2 = (2.5, 12.0)
"""Triangles agree up to this sum of squared differences of their sides, in variances of a side's difference: where
seeds are drawn, a strict limit finds more in a given time; where every triangle is, a wide one loses none."""

SEED_SUCCESS = (0.28, 0.5)
"""Share of the triangles within a body that lead to its pose, for these two limits, where enough of the points tried
are of the body.  `scripts/fit_seed_success.py` measures 0.41 and 0.54 and more on balls, heads, plates and rods."""

PREDICTED = 0.6
"""Share of a body's points whose place one of its triangles predicts well enough to try them."""

MOST_TRIALS = 64
"""CT points on which the pose of a seed is tried."""

TRIALS_PER_HIT = 24
"""Of the trial points one in so many must meet an OTS point at least: smaller bodies could not be found in time."""

CHANCE_PASSES = 1e-4
"""So many hits are needed that a false pose passes the trial with this probability at most."""

MOST_TRIANGLES = 8_000
"""Sets with no more triangles than this have them all drawn."""

BATCH, LARGER_BATCH = 64, 512
TRIAL_ORDERS = 32
"""Seeds drawn at once (where every seed is drawn, after the first: the larger number), and orders of the trial points
among them."""

WORK_PER_POINT, WORK_POWER = 250_000.0, 1.15
"""The search is given up after this work (1 to 2 ns each) times the larger set's size to this power."""

REFINING_WORK = 1_000
"""Work of refining a pose, for each CT point."""

MOST_POSES = 20
"""Rival poses kept."""

LEAST_CELL_MM = 3.0
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
        return pairs_of(self.partner)

    def is_same_as(self, other: Pose) -> bool:
        """Tell whether two poses pair mostly the same points."""
        agree = int(((self.partner >= 0) & (self.partner == other.partner)).sum())
        return 2 * agree > min(len(self.pairs), len(other.pairs))


@dataclass(frozen=True, eq=False)
class Found:
    """The distinct poses, best first; the probability that an equal of the best was missed; how far it was sought.

    ``complete``: every triangle was drawn.  ``least_sure``: a pose with so many pairs would not have been missed.
    ``work``: what was done, see `WORK_PER_POINT`.
    """

    poses: list[Pose]
    missed: float
    complete: bool
    least_sure: int
    work: float


@dataclass(frozen=True, eq=False)
class Search:
    """What all seeds share: the problem's distances and cells, the hits a pose needs, and if every seed is drawn."""

    problem: Problem
    table: tuple[Any, ...]
    grid: tuple[Any, ...]
    needed: int
    every: bool

    @property
    def sides_chi2(self) -> float:
        """How well triangles have to agree."""
        return SIDES_CHI2[self.every]

    def missed(self, size: int, drawn: float) -> float:
        """Return the probability that a pose of ``size`` pairs was missed by the seeds drawn.

        ``drawn`` is the share of all triangles that were drawn.  A body of ``size`` of the n CT points holds
        C(size, 3) of them; one is found out where enough of the points tried are of the body.
        """
        return float((1.0 - drawn * SEED_SUCCESS[self.every] * self.passes(size)) ** math.comb(size, 3))

    def passes(self, size: int) -> float:
        """Return the probability that enough of the points tried are of a body of ``size`` points."""
        rest = len(self.problem.ct) - 3
        tried, share = min(MOST_TRIALS, rest), PREDICTED * (size - 3) / max(rest, 1)
        if tried == rest:
            return float(size - 3 >= self.needed)
        return float(bdtrc(self.needed - 1, tried, share)) * (1.0 - (1.0 - share) ** FIRST_TRIALS)


def find_poses(problem: Problem, acceptable: float, least_size: int = 0) -> Found:
    """Return the poses that pair more points than chance would.

    Seeds are drawn until a pose with as many pairs as the best, and with ``least_size``, is missed with at most the
    ``acceptable`` probability, or the work allowed is done.  They are triangles drawn alike from all of the CT
    points', so that any body is found, compact or wide.
    """
    triangles = math.comb(len(problem.ct), 3)
    every = triangles <= MOST_TRIANGLES
    search = Search(problem, distance_table(problem.ots), point_grid(problem), needed_hits(problem), every)
    rng = np.random.default_rng(len(problem.ct) * 10_007 + len(problem.ots))
    allowed = work_left = WORK_PER_POINT * max(problem.counts) ** WORK_POWER
    poses: list[Pose] = []
    done, missed = 0, 1.0
    for seeds in seed_batches(rng, len(problem.ct)):
        trials = np.argsort(rng.random((TRIAL_ORDERS, len(problem.ct))), axis=1)[:, : MOST_TRIALS + 3]
        known = np.array([pose.partner for pose in poses], dtype=np.int64).reshape(-1, len(problem.ct))
        matrices, hits, work, count = poses_of_seeds(
            problem.ct, problem.ots, search.grid, seeds, trials, search.needed, search.table, problem.sigma_mm,
            search.sides_chi2, known, work_left,
        )  # fmt: skip
        done += count
        for matrix in matrices[hits > 0]:
            add_pose(poses, refine(search, matrix))
            work += REFINING_WORK * len(problem.ct)
        work_left -= work
        size = max([len(pose.pairs) for pose in poses] + [least_size])
        missed = search.missed(size, min(done / triangles, 1.0))
        if missed < acceptable or work_left <= 0:
            break
    poses.sort(key=lambda pose: -pose.log_evidence)
    drawn = min(done / triangles, 1.0)
    sure = next(
        (k for k in range(LEAST_PAIRS, len(problem.ct)) if search.missed(k, drawn) < 0.01), len(problem.ct)
    )
    return Found(poses, missed, done >= triangles, sure, allowed - work_left)


def seed_batches(rng: np.random.Generator, count: int) -> Iterator[IntArray]:
    """Give triangles (S, 3) of ``count`` points: all in a random order if there are few, else drawn at random."""
    if math.comb(count, 3) <= MOST_TRIANGLES:
        every = rng.permutation(np.array(list(combinations(range(count), 3)), dtype=np.int64))
        yield every[:BATCH]
        yield from (every[start : start + LARGER_BATCH] for start in range(BATCH, len(every), LARGER_BATCH))
        return
    while True:
        drawn = rng.integers(count, size=(2 * BATCH, 3))
        distinct = (drawn[:, 0] != drawn[:, 1]) & (drawn[:, 0] != drawn[:, 2]) & (drawn[:, 1] != drawn[:, 2])
        yield drawn[distinct][:BATCH]


def needed_hits(problem: Problem) -> int:
    """Return how many trial points must meet an OTS point before chance is unlikely.

    By chance a point meets another about as often as the points of the set with its outliers crowded meet their
    neighbours.
    """
    tried = min(MOST_TRIALS, len(problem.ct) - 3)
    if tried <= 0:
        return 0
    tree = cKDTree(problem.ots)
    reach = 1.5 * REACH_SIGMAS * problem.sigma_mm
    neighbours = tree.count_neighbors(tree, reach) / len(problem.ots) - 1.0
    exceeded = bdtrc(np.arange(tried + 1), tried, min(neighbours, 0.5))
    by_chance = int(np.argmax(exceeded <= CHANCE_PASSES)) + 1
    return max(by_chance, tried // TRIALS_PER_HIT)


def distance_table(points: FloatArray) -> tuple[Any, ...]:
    """Return what triangles are looked up in.

    All distances (m, m); each row's points by distance, those distances, and where these reach each step
    (`seeds.row_starts`); all pairs (P, 2) by distance, and those distances.
    """
    d = distances(points)
    row_order = np.argsort(d, axis=1)
    row_sorted = np.take_along_axis(d, row_order, axis=1)
    first, second = np.triu_indices(len(points), 1)
    between = d[first, second]
    order = np.argsort(between)
    pairs = np.column_stack((first[order], second[order]))
    return d, row_order, row_sorted, row_starts(row_sorted), pairs, between[order]


def point_grid(problem: Problem) -> tuple[Any, ...]:
    """Return the OTS points sorted into cells for `seeds.nearest`."""
    points, reach = problem.ots, WIDEST_REACH_SIGMAS * problem.sigma_mm
    low = points.min(axis=0) - reach
    extent = np.ptp(points, axis=0) + 2.0 * reach
    cell = max(LEAST_CELL_MM, float(extent.max()) / MOST_CELLS_PER_AXIS)
    shape = (extent / cell).astype(np.int64) + 1
    start, order, near = fill_grid(points, low, cell, shape, reach)
    return start, order, near, low, cell, shape


def refine(search: Search, matrix: FloatArray) -> Pose | None:
    """Fit a pose to all pairs it makes, repeatedly; None when too few remain or a known pair breaks."""
    problem = search.problem
    reaches = np.array(REFINING_SIGMAS) * problem.sigma_mm
    matrix, partner = refined(problem.ct, problem.ots, search.grid, matrix, reaches)
    if (partner >= 0).sum() < min(LEAST_PAIRS + max(search.needed, 1), len(problem.ct)):
        return None
    if (partner[problem.known[:, 0]] != problem.known[:, 1]).any():
        return None
    return Pose(matrix, partner, pose_log_evidence(problem, partner))


def pose_log_evidence(problem: Problem, partner: IntArray, taken: int = 0) -> float:
    """Return the log evidence of a pairing as in `evidence`, with markers as widely spread as the outliers.

    ``taken``: points of either set that belong to another body and could not have paired.
    """
    i = np.flatnonzero(partner >= 0)
    size, j = len(i), partner[i]
    variance = problem.ct_errors.variances[i] + problem.ots_errors.variances[j]
    index, weight = np.arange(size), np.tile(1.0 / variance, (size, 1))
    chi2, volume = fit(problem.ct[i], problem.ots[j], weight, index, index, size, math.inf)
    counts = (len(problem.ct) - taken, len(problem.ots) - taken)
    return (
        -math.log(min(counts))
        - log_pairings(*counts, size)
        + (size - 1) * math.log(problem.volume_mm3)
        - math.log(8.0 * math.pi**2)
        + (3.0 - 1.5 * size) * math.log(2.0 * math.pi)
        - 1.5 * float(np.log(variance).sum())
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
    if len(poses) > MOST_POSES:
        poses.sort(key=lambda one: -one.log_evidence)
        poses.pop()
