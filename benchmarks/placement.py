"""Places of the robot against random ones and a rule of thumb, probabilities against sampling, clearances against coal.

    python -m benchmarks.placement [--cases N] [--tries N] [--draws N] [--configurations N] [--seed S]

Needs `coal` for the last. Random cases: 16 trajectories and 8 markers on an ellipsoid of a head, from the crown and the
forehead, with table, body, holder, trolley and tracker.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.forward import link_frames
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.placement.clearances import APART_LINKS, place_trolley, posture_margins
from ronnaplan.robot.placement.parking import probability
from ronnaplan.robot.placement.placement import COARSE, FINE, Job, find_places
from ronnaplan.robot.placement.room import Floor, Parking
from ronnaplan.robot.placement.search import Problem, base_pose, serves, worths
from ronnaplan.robot.placement.serving import serve
from tests.robot.placement.cases import CENTER_MM, HEAD_MM, job, room

FLOOR = Floor((-1100.0, 700.0), (-1100.0, 1100.0), (800.0, 1000.0), trolley=room().floor.trolley)
REACH_MM = 901.5
THUMB = 0.6
"""The rule of thumb: beside the head at this part of the reach, facing it."""
WIDE = Parking(60.0, 8.0)
"""Parking so careless that the probability is not simply one."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--tries", type=int, default=100_000, help="random bases a case, of which some serve all")
    parser.add_argument("--draws", type=int, default=10_000, help="of Monte Carlo a case")
    parser.add_argument("--configurations", type=int, default=100_000, help="held against coal")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.configurations:
        print(collisions(arguments.configurations, arguments.seed), flush=True)
    for case in range(arguments.cases):
        print(one_case(arguments.seed + case, arguments.tries, arguments.draws), flush=True)


def one_case(seed: int, tries: int, draws: int) -> str:
    """Return a line about a random case."""
    given, rng = job(seed, 16, 8, floor=FLOOR), np.random.default_rng(seed)
    processor, wall = time.process_time(), time.perf_counter()
    found = find_places(given)
    processor, wall = time.process_time() - processor, time.perf_counter() - wall
    told = f"case {seed}: {processor:.1f} s of processor, {wall:.1f} s; "
    if not found.places:
        return told + found.blocked[0]
    coarse, best = given.problem(COARSE), found.places[0]
    there = np.array([*best.room_from_r[:3, 3], np.degrees(np.arctan2(*best.room_from_r[1::-1, 0]))])
    told += f"joints {best.worst_joint_deg:.1f}, worth {float(worths(coarse, there[None])[0]):.1f}; "
    bases = random_bases(rng, tries)
    bases = bases[serves(coarse, bases)]
    random = worths(coarse, bases) if len(bases) else np.array([-1.0])
    told += f"best of {len(bases)} random that serve all: {tell(given, bases, random)}; "
    thumb = thumb_bases()
    rule = worths(coarse, thumb)
    told += f"rule of thumb: {tell(given, thumb, rule)}; "
    for parking in (Parking(), WIDE):
        strayed = np.tile(there, (draws, 1))
        strayed[:, [0, 1]] += rng.normal(0.0, parking.sigma_mm, (draws, 2))
        strayed[:, 3] += rng.normal(0.0, parking.sigma_deg, draws)
        counted = float(serves(coarse, strayed).mean())
        told += f"probability {probability(coarse, there, parking):.3f} (counted {counted:.3f}); "
    return told


def tell(given: Job, places: FloatArray, found: FloatArray) -> str:
    """Return what the base of the greatest worth, of ``found`` (N,) at ``places`` (N, 4), keeps."""
    worth = float(found.max())
    if worth < 0:
        return "none"
    served = serve(given.problem(FINE), given.tasks, base_pose(places[found.argmax()]))
    joints = [one.joint_deg for one in served if one is not None]
    whole = "" if len(joints) == len(served) else " (not all along the ways)"
    return f"joints {min(joints):.1f}, worth {worth:.1f}{whole}"


def random_bases(rng: np.random.Generator, count: int) -> FloatArray:
    """Return bases (N, 4) anywhere on the floor."""
    least, greatest = np.array([FLOOR.x_mm, FLOOR.y_mm, FLOOR.z_mm, FLOOR.turn_deg]).T
    return rng.uniform(least, greatest, (count, 4))


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
    angles, bases = rng.uniform(least, greatest, (count, 6)), random_bases(rng, count)
    bases[:, :2] *= 0.6
    links = link_frames(arm, angles)
    peer = Peer(given, problem)
    frames, bodies = np.empty((7, 4, 4)), np.empty((len(problem.machine.links) + 1, 7))
    pair, missed, hit, needless = np.zeros(2, dtype=np.int64), 0, 0, 0
    world = problem.world._replace(needs=np.array([0.0, 0.0, -1e9, 0.0]))
    for one, place, of_links in zip(angles, bases, links, strict=True):
        base = base_pose(place)
        frames[0] = base
        trolley = place_trolley(problem.machine, base)
        near, _ = posture_margins(
            problem.machine, world, trolley, problem.ways.instruments[0], one, frames, bodies, pair, False
        )
        touching = peer.touches(base @ of_links, base)
        hit += touching
        missed += touching and near > 0.0
        needless += not touching and near <= 0.0
    told = f"{count} configurations: {hit} collide by coal, {missed} of them missed"
    return f"{told}, {needless} more taken for collisions"


class Peer:
    """The same room and robot, put together from coal's own shapes."""

    def __init__(self, given: Job, problem: Problem) -> None:
        import coal

        self.coal: Any = coal
        self.machine = problem.machine
        turned = given.room.boxes
        self.things = [(coal.Box(*one.size_mm), self._at(np.eye(3), np.array(one.center_mm))) for one in turned]
        self.things += [
            self._capsule(np.array([*one.start_mm, *one.end_mm, one.radius_mm])) for one in given.room.capsules
        ]
        self.head = (coal.Ellipsoid(*HEAD_MM), self._at(np.eye(3), CENTER_MM))
        instrument = problem.ways.instruments[0]
        self.bodies = [*problem.machine.bodies, instrument]
        self.links = [*problem.machine.links, 6]
        self.trolley = given.room.floor.trolley

    def touches(self, frames: FloatArray, base: FloatArray) -> bool:
        """Whether anything touches that counts, with the links at ``frames`` (7, 4, 4) in the room."""
        placed = [
            self._capsule(self._moved(frames[link], row))
            for link, row in zip(self.links, self.bodies, strict=True)
        ]
        under = [
            (self.coal.Box(*one.size_mm), self._at(base[:3, :3], (base @ [*one.center_mm, 1])[:3]))
            for one in self.trolley
        ]
        for k, (body, link) in enumerate(zip(placed, self.links, strict=True)):
            things = self.things + (under if link >= 2 else []) + ([self.head] if k < len(placed) - 1 else [])
            things += [
                placed[j]
                for j in range(min(k, len(placed) - 1))
                if link - self.links[j] >= APART_LINKS and k < len(placed) - 1
            ]
            if any(self._meet(body, thing) for thing in things):
                return True
        return False

    def _meet(self, one: tuple[Any, Any], other: tuple[Any, Any]) -> bool:
        return bool(self.coal.collide(*one, *other, self.coal.CollisionRequest(), self.coal.CollisionResult()))

    def _at(self, turn: FloatArray, place: FloatArray) -> Any:
        return self.coal.Transform3s(np.ascontiguousarray(turn), np.asarray(place, dtype=np.float64))

    def _moved(self, frame: FloatArray, row: FloatArray) -> FloatArray:
        return np.array([*(row[:6].reshape(2, 3) @ frame[:3, :3].T + frame[:3, 3]).ravel(), row[6]])

    def _capsule(self, row: FloatArray) -> tuple[Any, Any]:
        axis = row[3:6] - row[:3]
        length = float(np.linalg.norm(axis))
        z = axis / length
        x = np.cross(np.eye(3)[int(np.abs(z).argmin())], z)
        x /= np.linalg.norm(x)
        return self.coal.Capsule(row[6], length), self._at(
            np.column_stack([x, np.cross(z, x), z]), row[:3] + axis / 2
        )


if __name__ == "__main__":
    main()
