"""The search for poses: triangles drawn alike from all, until an equal of the best can hardly have been missed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.special import comb

from ronnaplan.correspondence.chance import Chance
from ronnaplan.correspondence.lookup import Grid, Table, distance_table, point_grid
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.problem import Problem
from ronnaplan.correspondence.refining import REFINING_SIGMAS, refined
from ronnaplan.correspondence.seeds import MOST_TRIANGLES, first_in_order, poses_of_seeds, seed_stream
from ronnaplan.correspondence.told import LEAST_PAIRS
from ronnaplan.correspondence.trials import (
    MOST_TRIALS,
    REACH_SIGMAS,
    STOPPED,
    WIDEST_REACH_SIGMAS,
    at_least,
    needed_hits,
)
from ronnaplan.correspondence.weighing import PairedPose, add_pose, poses_of
from ronnaplan.geometry import FloatArray
from ronnaplan.threads import cores

SIDES_CHI2 = (2.5, 12.0)
"""Triangles agree up to this sum of squared differences of their sides, in variances of a side's difference: where
seeds are drawn, a strict limit finds more in a given time; where every triangle is, a wide one loses none."""

SEED_SUCCESS = ((0.25, 0.4), (0.6, 0.75))
SUCCESS_SIZES = (14.0, 40.0)
"""Share of the triangles within a body of so many points that lead to its pose, for these two limits, where enough of
the points tried are of the body.  `scripts/fit_seed_success.py` measures 0.5 and 0.92 and more for 40 points on balls,
heads, plates and rods; rivals of 14 points planted in a test are found at 0.3."""

PREDICTED = 0.6
"""Share of a body's points whose place one of its triangles predicts well enough to try them."""

CROWDING_SIGMAS = 15.0
"""How crowded the OTS points are is told from their neighbours within this."""

FIRST_BATCH, LEAST_BATCH, LARGEST_BATCH = 16, 32, 1024
BATCH_SHARE = 0.2
TRIAL_ORDERS = 32
"""Seeds looked up at once, so many that they take this share of the work that is left; and orders of the trial points
among them."""

WORK_PER_POINT, WORK_POWER = 60_000.0, 1.5
"""The search is given up after this work (1 to 2 ns each) times the larger set's size to this power."""

PARTS = 2
"""Seeds are looked up in so many threads."""

LEAST_SHARED_WORK = 3e5
"""Seeds at once are looked up in one thread where no more work is expected: to hand half of them over takes about a
tenth of it.  How many seeds there are tells nothing: among 1,000 dense points one takes 40 ms."""

REFINING_WORK = 1_000
"""Work of refining a pose, for each CT point."""

MISSED_FOR_SURE = 0.01
"""Bodies that are missed with less than this probability are called sure to be seen."""


@dataclass(frozen=True, eq=False)
class Found:
    """The distinct poses, best first; the probability that an equal of the best was missed; how far it was sought.

    ``complete``: every triangle was drawn.  ``least_sure``: a pose with so many pairs would not have been missed.
    ``work``: what was done, see `WORK_PER_POINT`.  ``chance``: what tells the poses' pairs from chance.
    """

    poses: list[PairedPose]
    missed: float
    complete: bool
    least_sure: int
    work: float
    chance: Chance


@dataclass(frozen=True, eq=False)
class Search:
    """What all seeds share: the problem's distances and cells, the hits a pose needs, and if every seed is drawn."""

    problem: Problem
    grid: Grid
    needed: tuple[IntArray, IntArray]
    hit_chance: float
    every: bool

    @classmethod
    def of(cls, problem: Problem, every: bool) -> Search:
        """Return the search in which ``every`` seed is drawn, or only some."""
        reach, farthest = (sigmas * problem.sigma_mm for sigmas in (WIDEST_REACH_SIGMAS, max(REFINING_SIGMAS)))
        grid = point_grid(problem.ots, problem.sigma_mm, reach, farthest)
        hit_chance = chance_of_hit(problem)
        needed = needed_hits(len(problem.ct) - 3, hit_chance, every)
        return cls(problem, grid, needed, hit_chance, every)

    @cached_property
    def table(self) -> Table:
        """The OTS points' distances, by which seeds are looked up."""
        return distance_table(self.problem.ots, self.problem.sigma_mm)

    @property
    def needed_of_all(self) -> tuple[int, int]:
        """The hits that are needed, at first and then, by a seed that predicts every point."""
        rest = len(self.problem.ct) - 3
        return int(self.needed[0][min(MOST_TRIALS, rest)]), int(self.needed[1][rest])

    @property
    def sides_chi2(self) -> float:
        """How well triangles have to agree."""
        return SIDES_CHI2[self.every]

    def missed(self, sizes: ArrayLike, drawn: float) -> FloatArray:
        """Return the probability that a pose of each of ``sizes`` pairs was missed by the seeds drawn.

        ``drawn`` is the share of all triangles that were drawn.  A body of so many of the n CT points holds
        C(size, 3) of them; one is found out where enough of the points tried are of the body.
        """
        size = np.asarray(sizes, dtype=np.float64)
        return np.asarray((1.0 - drawn * self.found_out(size)) ** comb(size, 3))

    def to_draw(self, size: float, acceptable: float) -> float:
        """Return the share of all triangles to draw until a pose of ``size`` pairs is missed so rarely, or more."""
        if size < LEAST_PAIRS:  # nothing is sought
            return math.inf
        each = 1.0 - acceptable ** (1.0 / comb(size, 3))
        return float(each) / max(float(self.found_out(np.asarray(size))), 1e-9)

    def found_out(self, size: FloatArray) -> FloatArray:
        """Return the probability (...) that a triangle in a body of ``size`` points, once drawn, leads to its pose."""
        return np.asarray(np.interp(size, SUCCESS_SIZES, SEED_SUCCESS[self.every]) * self.passes(size))

    def passes(self, size: FloatArray) -> FloatArray:
        """Return the probability that enough of the points tried are of a body of ``size`` (...) points."""
        rest, of_body = len(self.problem.ct) - 3, np.maximum(size - 3.0, 0.0)
        tried, share = min(MOST_TRIALS, rest), self.share(size)
        enough = np.asarray(of_body >= max(self.needed_of_all))
        if self.every:  # not every triangle predicts every point: of small cubes and rows other orders were missed
            shown = at_least(max(self.needed_of_all), np.round(of_body).astype(np.int64), PREDICTED)
            return np.where(size < SUCCESS_SIZES[0], shown, enough)
        if tried == rest:
            return np.asarray((1.0 - STOPPED) * enough, dtype=np.float64)
        first, all_points = (
            at_least(n, count, share) for n, count in zip(self.needed_of_all, (tried, rest), strict=True)
        )
        return np.asarray(first * all_points * (1.0 - STOPPED))

    def share(self, size: FloatArray | float) -> FloatArray:
        """Return the share of the trial points that are of a body of ``size`` (...) points, and tried."""
        return np.asarray(PREDICTED * np.maximum(np.asarray(size) - 3.0, 0.0) / max(len(self.problem.ct) - 3, 1))


def work_allowed(problem: Problem) -> float:
    """Return the work that a search for poses may take."""
    return float(WORK_PER_POINT * max(problem.counts) ** WORK_POWER)


def find_poses(
    problem: Problem,
    acceptable: float,
    least_size: int = 0,
    work_done: float = 0.0,
    before: Sequence[PairedPose] = (),
) -> Found:
    """Return the poses that pair more points than chance would, those found ``before`` with other errors among them.

    Seeds are drawn until a pose with as many right pairs as the best, and with ``least_size``, is missed with at most
    the ``acceptable`` probability, or the work allowed, less the ``work_done`` before, is done.  They are triangles
    drawn alike from all of the CT points', so that any body is found, compact or wide.
    """
    triangles = math.comb(len(problem.ct), 3)
    search = Search.of(problem, triangles <= MOST_TRIANGLES)
    rng = np.random.default_rng(len(problem.ct) * 10_007 + len(problem.ots))
    work_left = work_allowed(problem) - work_done
    poses = refined_poses(search, before)
    chance, best, size = Chance.of(problem), None, float(least_size)
    done, batch, wanted = 0, FIRST_BATCH, triangles * search.to_draw(size, acceptable)
    draw = seed_stream(rng, len(problem.ct))
    with ThreadPoolExecutor(PARTS - 1) as pool:
        expected = work_left * FIRST_BATCH / LARGEST_BATCH
        while len(seeds := draw(batch)):
            trials = first_in_order(rng.random((TRIAL_ORDERS, len(problem.ct))), MOST_TRIALS + 3)
            known = np.array([pose.partner for pose in poses], dtype=np.int64).reshape(-1, len(problem.ct))
            others = pool if expected > LEAST_SHARED_WORK and cores() > 1 else None
            found, work, finished = looked_up(search, seeds, trials, known, size, work_left, others)
            done += len(seeds) if finished else 0
            for pose in found:
                add_pose(poses, pose)
            work_left -= work
            if poses and (top := max(poses, key=lambda pose: pose.log_evidence)) is not best:
                best, size = top, max(chance.right_pairs(top), least_size)
                wanted = triangles * search.to_draw(size, acceptable)
            if done >= wanted or work_left <= 0:
                break
            promised = max(BATCH_SHARE * work_left * len(seeds) / max(work, 1), LEAST_BATCH)
            batch = math.ceil(min(promised, LARGEST_BATCH, wanted - done))
            expected = work * batch / len(seeds)
    poses.sort(key=lambda pose: -pose.log_evidence)
    *missed, of_size = search.missed([*range(len(problem.ct)), size], min(done / triangles, 1.0))
    sure = int(np.flatnonzero(np.array(missed) >= MISSED_FOR_SURE).max(initial=LEAST_PAIRS - 1)) + 1
    return Found(poses, float(of_size), done >= triangles, sure, work_allowed(problem) - work_left, chance)


def weighed_with(found: Found, poses: Sequence[PairedPose]) -> Found:
    """Return what was found with more ``poses``, which were found with other errors or among some points only."""
    kept = list(found.poses)  # as they are: refined once more, a pose of dense points may lose some of its pairs
    for pose in refined_poses(Search.of(found.chance.problem, every=False), poses):
        add_pose(kept, pose)
    return replace(found, poses=sorted(kept, key=lambda pose: -pose.log_evidence))


def refined_poses(search: Search, poses: Sequence[PairedPose]) -> list[PairedPose]:
    """Return the distinct ones of ``poses`` that were found with other errors, refined with the search's."""
    anew: list[PairedPose] = []
    for pose in refine(search, np.array([pose.matrix for pose in poses]).reshape(-1, 3, 4), 1):
        add_pose(anew, pose)
    return anew


def looked_up(
    search: Search,
    seeds: IntArray,
    trials: IntArray,
    known: IntArray,
    size: float,
    most_work: float,
    others: Executor | None,
) -> tuple[list[PairedPose], float, bool]:
    """Return the refined poses that seeds (S, 3) lead to, the work, and whether all of it was done.

    Poses are left soon that do not promise as many pairs as ``size``, or as any that could be handed on.
    In `PARTS` parts, however many cores there are: every machine finds the same. All but the first are left to
    ``others``, if there are any.
    """
    problem, table = search.problem, search.table
    share = 0.0 if search.every else float(search.share(max(size, search.needed_of_all[1] + 3)))

    def of_part(part: IntArray) -> tuple[list[PairedPose], float, bool]:
        matrices, hits, work, finished = poses_of_seeds(
            problem.ct, problem.ots, search.grid, part, trials, search.needed, (search.hit_chance, share),
            table, problem.sigma_mm, search.sides_chi2, known, most_work / PARTS,
        )  # fmt: skip
        found = matrices[hits > 0]
        return (
            refine(search, found, max(search.needed_of_all[1], 1)),
            work + REFINING_WORK * len(problem.ct) * len(found),
            finished,
        )

    ends = [math.ceil(len(seeds) * part / PARTS) for part in range(PARTS + 1)]
    parts = [seeds[first:end] for first, end in pairwise(ends)]
    begun = [others.submit(of_part, part) for part in parts[1:]] if others else []
    results = [of_part(parts[0]), *([one.result() for one in begun] if others else map(of_part, parts[1:]))]
    poses = [pose for found, _, _ in results for pose in found]
    return poses, sum(work for _, work, _ in results), all(finished for *_, finished in results)


def chance_of_hit(problem: Problem) -> float:
    """Return how often a point meets an OTS point by chance.

    It does about as often as the points of the set with its outliers crowded meet their neighbours.
    """
    tree = cKDTree(problem.ots)
    reach, wide = 1.5 * REACH_SIGMAS * problem.sigma_mm, CROWDING_SIGMAS * problem.sigma_mm
    crowding = (tree.count_neighbors(tree, wide) / len(problem.ots) - 1.0) * (reach / wide) ** 3
    return float(min(max(crowding, 1e-6), 0.5))


def refine(search: Search, matrices: FloatArray, needed: int) -> list[PairedPose]:
    """Fit poses (K, 3, 4) to their pairs; those go that break a known one, or make too few, ``needed`` and a seed's."""
    if len(matrices) == 0:
        return []
    problem = search.problem
    reaches = np.array(REFINING_SIGMAS) * problem.sigma_mm
    matrices, partners = refined(problem.ct, problem.ots, search.grid, matrices, reaches)
    enough = (partners >= 0).sum(axis=1) >= min(LEAST_PAIRS + needed, len(problem.ct))
    holds = (partners[:, problem.known[:, 0]] == problem.known[:, 1]).all(axis=1)
    kept = enough & holds
    return poses_of(problem, matrices[kept], partners[kept])
