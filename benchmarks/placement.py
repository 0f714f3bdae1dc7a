"""Places of the robot against random ones and a rule of thumb, probabilities against sampling, clearances against coal.

    python -m benchmarks.placement [--cases N] [--random N] [--tries N] [--draws N] [--configurations N] [--seed S]

Needs `coal` for the last. Random cases: 16 trajectories and 8 markers on an ellipsoid of a head, from the crown and the
forehead, with table, body, holder, trolley and tracker.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.collisions import Peer
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.forward import link_frames
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.placement.clearances import posture_margins, standing_on
from ronnaplan.robot.placement.job import Job
from ronnaplan.robot.placement.parking import probability
from ronnaplan.robot.placement.placement import CLOSER, COARSE, FINE, find_places
from ronnaplan.robot.placement.room import Floor, Parking, base_place, base_pose
from ronnaplan.robot.placement.search import Problem, refine, serves, worths
from ronnaplan.robot.placement.serving import serve
from tests.robot.placement.cases import CENTER_MM, job, room

FLOOR = Floor((-1100.0, 700.0), (-1100.0, 1100.0), (800.0, 1000.0), trolley=room().floor.trolley)
REACH_MM = 901.5
THUMB = 0.6
"""The rule of thumb: beside the head at this part of the reach, facing it."""
NOWHERE = np.full(3, -np.inf)
AROUND_MM = 60.0
REFINED = 12
"""Best random bases that are refined, to learn what can be reached at all."""
WIDE = Parking(60.0, 8.0)
"""Parking so careless that the probability is not simply one."""


@dataclass(frozen=True)
class Case:
    """What became of one random case; joints in degrees, NaN where there is nothing."""

    processor_s: float
    joint: float = np.nan
    worth: float = np.nan
    random: int = 0
    """Random bases that serve all."""
    random_joint: float = np.nan
    random_worth: float = np.nan
    """Of the best of them."""
    optimum: float = np.nan
    """The greatest worth that is known of, whoever found it."""
    thumb_joint: float = np.nan
    thumb_worth: float = np.nan
    off: tuple[float, ...] = ()
    """Probabilities minus what was counted."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--random", type=int, default=1000, help="random bases a case that serve all")
    parser.add_argument(
        "--tries", type=int, default=40_000, help="bases a case among which some that do are sought"
    )
    parser.add_argument("--draws", type=int, default=10_000, help="of Monte Carlo a case")
    parser.add_argument("--configurations", type=int, default=100_000, help="held against coal")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.configurations:
        print(collisions(arguments.configurations, arguments.seed), flush=True)
    cases = [
        one_case(seed, arguments.random, arguments.tries, arguments.draws)
        for seed in range(arguments.seed, arguments.seed + arguments.cases)
    ]
    if cases:
        print(summary(cases))


def one_case(seed: int, wanted: int, tries: int, draws: int) -> Case:
    """Return, and print, what becomes of a random case."""
    given, rng = job(seed, 16, 8, floor=FLOOR), np.random.default_rng(seed)
    coarse, closer, fine = map(given.problem, (COARSE, CLOSER, FINE))
    processor = time.process_time()
    found = find_places(given)
    processor = time.process_time() - processor
    bases = feasible_bases(coarse, rng, wanted, tries)
    if not found.places:
        blocked = f"{len(bases)} random bases serve all; {found.blocked[0]}"
        print(f"case {seed}: {processor:.1f} s of processor; none: {blocked}", flush=True)
        return Case(processor, random=len(bases))
    best = found.places[0]
    there = base_place(best.room_from_r)
    worth = float(worths(coarse, there[None])[0])
    random = worths(coarse, bases)
    thumb = thumb_bases()
    rule = worths(coarse, thumb)
    optimum = max([worth, *(refine(coarse, bases[n], float(random[n]))[1] for n in np.argsort(-random)[:REFINED])])
    off = []
    for parking in (Parking(), WIDE):
        strayed = np.tile(there, (draws, 1))
        strayed[:, [0, 1]] += rng.normal(0.0, parking.sigma_mm, (draws, 2))
        strayed[:, 3] += rng.normal(0.0, parking.sigma_deg, draws)
        served = serves(coarse, strayed)
        served[~served] = serves(fine, strayed[~served])
        off.append(probability(coarse, closer, there, parking) - float(served.mean()))
    told = Case(
        processor,
        best.worst_joint_deg,
        worth,
        len(bases),
        *kept_by(given, bases, random),
        optimum,
        *kept_by(given, thumb, rule),
        tuple(off),
    )
    print(f"case {seed}: {told}", flush=True)
    return told


def kept_by(given: Job, places: FloatArray, found: FloatArray) -> tuple[float, float]:
    """Return the least joint margin and the worth of the best of ``places`` (N, 4), of worths ``found`` (N,)."""
    if not (found >= 0).any():
        return np.nan, np.nan
    served = serve(given.problem(FINE), given.tasks, base_pose(places[found.argmax()]))
    joints = [one.joint_deg for one in served if one is not None]
    return (min(joints) if len(joints) == len(served) else np.nan), float(found.max())


def feasible_bases(problem: Problem, rng: np.random.Generator, wanted: int, tries: int) -> FloatArray:
    """Return up to ``wanted`` bases (N, 4) that serve all, evenly from all that do.

    ``tries`` anywhere on the floor show where they are; as many there, and `AROUND_MM` about it, bring the rest.
    """
    first = anywhere(rng, tries)
    first = first[serves(problem, first)]
    if not 1 < len(first) < wanted:
        return first[:wanted]
    near = anywhere(rng, tries, first[:, :3].min(axis=0) - AROUND_MM, first[:, :3].max(axis=0) + AROUND_MM)
    found = np.concatenate([np.empty((0, 4)), *_serving(problem, near, wanted)])
    return found[:wanted]


def anywhere(
    rng: np.random.Generator, count: int, low_mm: FloatArray = NOWHERE, high_mm: FloatArray = -NOWHERE
) -> FloatArray:
    """Return bases (N, 4) on the floor between two corners (3,), turned anyhow."""
    least, greatest = np.array([FLOOR.x_mm, FLOOR.y_mm, FLOOR.z_mm, FLOOR.turn_deg]).T
    least[:3], greatest[:3] = np.maximum(least[:3], low_mm), np.minimum(greatest[:3], high_mm)
    return rng.uniform(least, greatest, (count, 4))


def _serving(problem: Problem, places: FloatArray, wanted: int) -> Iterator[FloatArray]:
    """Return those of ``places`` (N, 4) that serve all, part by part until there are as many as are ``wanted``."""
    count = 0
    for part in np.array_split(places, 40):
        if count >= wanted:
            return
        kept = part[serves(problem, part)]
        count += len(kept)
        yield kept


def summary(cases: list[Case]) -> str:
    """Return what is told of all cases together."""
    placed = [one for one in cases if one.worth >= 0]
    times = [one.processor_s for one in cases]
    lines = [
        f"processor time: median {np.median(times):.1f} s, at most {max(times):.1f} s",
        f"{len(placed)} of {len(cases)} cases have a place; of the others "
        f"{sum(one.random > 0 and np.isnan(one.worth) for one in cases)} have a random base that serves all",
        f"random bases that serve all: {min(one.random for one in placed)} to {max(one.random for one in placed)}, "
        f"median {np.median([one.random for one in placed]):.0f}",
    ]

    def gain(name: str, ours: FloatArray, theirs: FloatArray) -> str:
        more = 100 * (ours / theirs - 1)
        more = more[np.isfinite(more)]
        if not len(more):
            return f"{name}: none to compare with"
        few, middle, many = np.percentile(more, (0, 50, 100))
        return (
            f"{name}: median {middle:+.1f} %, {few:+.1f} to {many:+.1f} %; 25 % or more in "
            f"{(more >= 25).sum()} of {len(more)}"
        )

    def of(name: str) -> FloatArray:
        return np.array([getattr(one, name) for one in placed], dtype=np.float64)

    lines += [
        gain("joint margin against the best random base's", of("joint"), of("random_joint")),
        gain("worth against the best random base's", of("worth"), of("random_worth")),
        gain("greatest worth known against the best random base's", of("optimum"), of("random_worth")),
        gain("worth against the greatest known", of("worth"), of("optimum")),
        f"the rule of thumb serves all in {np.isfinite(of('thumb_worth')).sum()} of {len(placed)}",
        gain("joint margin against the rule of thumb's", of("joint"), of("thumb_joint")),
    ]
    off = 100 * np.array([one.off for one in placed])
    lines.append(
        f"probability minus counted: mean {off.mean():+.2f} points, RMS {np.sqrt((off**2).mean()):.2f}, "
        f"at most {np.abs(off).max():.2f}; beyond 2 in {(np.abs(off) > 2).sum()} of {off.size}"
    )
    return "\n".join(lines)


def thumb_bases() -> FloatArray:
    """Return the rule of thumb's bases (6, 4): either side of the head and behind it, low and high."""
    away = THUMB * REACH_MM
    sides = ((0.0, -away, 90.0), (0.0, away, -90.0), (-away, 0.0, 0.0))
    return np.array([(CENTER_MM[0] + x, CENTER_MM[1] + y, z, turn) for x, y, turn in sides for z in FLOOR.z_mm])


def collisions(count: int, seed: int) -> str:
    """Return how many collisions, by coal, of random configurations were taken for clear; the head is an ellipsoid."""
    given, rng, arm = job(seed, 1, 0, floor=FLOOR), np.random.default_rng(seed), kr6_r900()
    problem = given.problem(COARSE)
    least, greatest = arm.limits_rad.T
    angles, bases = rng.uniform(least, greatest, (count, 6)), anywhere(rng, count)
    bases[:, :2] *= 0.6
    links = link_frames(arm, angles)
    peer = Peer(given, problem)
    missed, hit, needless = 0, 0, 0
    world = problem.world._replace(needs=np.array([0.0, 0.0, -1e9, 0.0]))
    for one, place, of_links in zip(angles, bases, links, strict=True):
        base = base_pose(place)
        standing, instrument = standing_on(problem.machine, base), problem.ways.instruments[0]
        near, _ = posture_margins(problem.machine, world, standing, instrument, one, np.inf, False)
        touching = peer.touches(base @ of_links, base)
        hit += touching
        missed += touching and near > 0.0
        needless += not touching and near <= 0.0
    told = f"{count} configurations: {hit} collide by coal, {missed} of them missed"
    return f"{told}, {needless} more taken for collisions"


if __name__ == "__main__":
    main()
