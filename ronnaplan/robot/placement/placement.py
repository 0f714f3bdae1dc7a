"""Where the robot shall stand for a plan: the whole search, as it is told."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement import blocking
from ronnaplan.robot.placement.beforehand import blocked_anywhere, in_the_way
from ronnaplan.robot.placement.job import Job
from ronnaplan.robot.placement.most import Climbed, served_each, serving_most
from ronnaplan.robot.placement.near import what_comes_near
from ronnaplan.robot.placement.parking import probability
from ronnaplan.robot.placement.room import Floor, base_place, base_pose
from ronnaplan.robot.placement.route import Route, plan_route
from ronnaplan.robot.placement.search import (
    Problem,
    alternatives,
    best_apart,
    grid,
    refined,
    scattered,
    worths,
)
from ronnaplan.robot.placement.serving import Served, least_worth, serve
from ronnaplan.robot.placement.tasks import Fineness, Task
from ronnaplan.threads import in_threads
from ronnaplan.transforms import invert, transform_points

COARSE = Fineness(24, 60.0)
"""What bases are searched with."""
FINE = Fineness(72, 5.0)
"""What is told of a base is measured with; the search's rolls are among these: what serves there serves here."""
CLOSER = replace(COARSE, rolls=FINE.rolls)
"""What is asked of places where the search's rolls do not serve: as many rolls as after parking."""
PLACES, TRIED = 3, 6
"""The best base and its alternatives; so many are looked at closely until as many have free ways to all tasks."""
TRIED_ALL = "for every base that was tried"
SCATTERED = 16_384
"""Further bases that are tried where neither one of the grid serves all nor one that steps lead to."""


@dataclass(frozen=True, eq=False)
class Place:
    """One base: ``room_from_r`` (4, 4), how it serves every task, by which route, and how surely after parking."""

    room_from_r: FloatArray
    served: tuple[Served, ...]
    route: Route
    probability: float | None
    """None where the base was measured."""
    near: tuple[str, ...]
    """What of the tool comes near the wrist on the way, in sentences."""
    at_reference: str | None
    """What the arm meets in its reference posture, a sentence; None where that is free."""

    @property
    def worst_joint_deg(self) -> float:
        """The least margin of any joint, on the way of any task."""
        return min(one.joint_deg for one in self.served)


@dataclass(frozen=True, eq=False)
class Placement:
    """The places found, the best first, with ``room_from_ct`` (4, 4); or what stands in the way, in sentences."""

    room_from_ct: FloatArray
    places: tuple[Place, ...]
    blocked: tuple[str, ...]

    def r_from_ct(self, place: Place) -> FloatArray:
        """Return R from CT (4, 4)."""
        return invert(place.room_from_r) @ self.room_from_ct


def find_places(job: Job) -> Placement:
    """Return the best bases on the room's floor, apart from each other, or what stands in the way.

    One with free ways to all tasks comes before any that has none to some, and these before any at which the reference
    posture is not free.
    """
    coarse = job.problem(COARSE)
    places = grid(coarse)
    if not len(places):
        return Placement(job.room_from_ct, (), ("no base on the floor is within the arm's reach of the head",))
    if blocked := blocked_anywhere(job, coarse, COARSE):
        return Placement(job.room_from_ct, (), blocked)
    closer, fine = job.problem(CLOSER), job.problem(FINE)
    search, values = coarse, worths(coarse, places)
    if not (values >= 0.0).any():
        climbed = serving_most(coarse, places)
        search, places, values = _further(coarse, closer, places, climbed)
        if not (values >= 0.0).any():
            return Placement(job.room_from_ct, (), _blocked(job, coarse, climbed))
    tops, better = refined(search, places, values)
    best = [tops[n] for n in best_apart(tops, better, TRIED)]
    others = alternatives(replace(search, taken=tuple(best)), places, values)
    tried = itertools.islice(itertools.chain(best, others), TRIED)

    def looked_at(place: FloatArray) -> Place | list[int]:
        return _place(job, fine, base_pose(place), probability(coarse, closer, place, job.room.parking))

    found: list[Place] = []
    missing = PLACES
    while looked := list(itertools.islice(tried, missing)):
        found += [one for one in in_threads(looked_at, looked) if isinstance(one, Place)]
        missing = PLACES - sum(not one.route.stuck for one in found)
    if not found:
        return Placement(job.room_from_ct, (), ("looked at closely, no base serves every task all along its way",))
    found.sort(
        key=lambda one: (one.at_reference is not None, len(one.route.stuck), -least_worth(job.world, one.served))
    )
    return Placement(job.room_from_ct, tuple(found[:PLACES]), ())


def _further(
    coarse: Problem, closer: Problem, places: FloatArray, climbed: Climbed
) -> tuple[Problem, FloatArray, FloatArray]:
    """Return the rolls and the places (N, 4) to go on with where none of the grid's serves all, and their worths (N,).

    ``climbed`` is what `serving_most` returns of the grid's ``places``.
    """
    further = climbed.places if climbed.served.all(axis=1).any() else scattered(coarse, SCATTERED)
    values = worths(coarse, further)
    if (values >= 0.0).any():
        return coarse, further, values
    # A floor of one base is not refused for rolls by which that base, once parked, serves all.
    asked = np.concatenate([places, climbed.tops])
    return closer, asked, worths(closer, asked)


def check_parked(job: Job, room_from_r: FloatArray) -> Placement:
    """Return how a base that was measured, ``room_from_r`` (4, 4), serves all, or what stands in the way there.

    Raises `InputError` for one that is so low that its trolley would be in the floor.
    """
    job.room.floor.require_above(float(room_from_r[2, 3]))
    fine = job.problem(FINE)
    place = _place(job, fine, room_from_r, None)
    if isinstance(place, Place):
        return Placement(job.room_from_ct, (place,), ())
    here = base_place(room_from_r)[None]
    if near := in_the_way(job, fine, Floor(*((value, value) for value in here[0].tolist())), "from here"):
        return Placement(job.room_from_ct, (), (near,))
    told = [_sentence(job, fine, n, here, "from here", here) for n in place]
    return Placement(job.room_from_ct, (), tuple(told))


def _place(job: Job, fine: Problem, room_from_r: FloatArray, sure: float | None) -> Place | list[int]:
    """Return the base looked at closely, or the numbers of the tasks that it does not serve."""
    served = serve(fine, job.tasks, room_from_r)
    missing = [n for n, one in enumerate(served) if one is None]
    if missing:
        return missing
    whole = tuple(one for one in served if one is not None)
    route, turned = plan_route(fine, room_from_r, whole, np.array(job.room.reference_deg))
    passages = [(f"on the way of {one.name}", one.angles_deg) for one in turned]
    passages += [
        (f"between {a} and {b}", np.array([start, end]))
        for (a, start), (b, end) in itertools.pairwise(route.corners)
    ]
    near = what_comes_near(fine.machine, passages, job.body_names, job.room.margins.clearance_mm)
    met = blocking.at_reference(job, fine, room_from_r, route.reference_deg) if route.stuck else None
    return Place(room_from_r, turned, route, sure, near, met)


def _blocked(job: Job, coarse: Problem, climbed: Climbed) -> tuple[str, ...]:
    """Say why none of the places that were ``climbed`` from and to serves everything.

    That is what no base serves at all, or what the best of them leaves out.
    """
    places, served = climbed.places, climbed.served
    if not blocking.is_parked(coarse, places):
        return (blocking.Blocked(blocking.UNPARKED, -np.inf, 0, 0).sentence(job, TRIED_ALL),)
    most = int(served.sum(axis=1).argmax())
    best = places[[most]]
    never = np.flatnonzero(~served.any(axis=0))
    if len(never):
        return tuple(_sentence(job, coarse, int(n), places, TRIED_ALL, best) for n in never)
    told = [
        _sentence(job, coarse, int(n), best, "from the base that serves most", best)
        for n in np.flatnonzero(~served[most])
    ]
    return ("each task is served by some base, but no base that was tried serves all", *told)


def _sentence(job: Job, problem: Problem, number: int, places: FloatArray, where: str, best: FloatArray) -> str:
    task = job.tasks[number]
    why = blocking.best_of(problem, number, places).sentence(job, where)
    told = f"{task.kind} {task.name}: {why}"
    if task.kind == "marker":
        return told
    return f"{told}; {_other_entry(job, task, best)}"


def _other_entry(job: Job, task: Task, best: FloatArray) -> str:
    """Say which entry near that of a blocked trajectory is served from the ``best`` place (1, 4)."""
    target = task.ends_mm[0]
    entries, turns = blocking.entries_beside(task, job.world)
    for turn in np.unique(turns):
        ring = [entries[n] for n in np.flatnonzero(turns == turn)]
        problem = job.problem(COARSE, ring)
        (works,) = served_each(problem, best)
        if works.any():
            start = ring[works.argmax()].starts_mm[0]
            inward = (target - start) / np.linalg.norm(target - start)
            (entry,) = transform_points(
                invert(job.room_from_ct), (start + job.room.tool.standoff_mm * inward)[None]
            )
            place = ", ".join(f"{value:.1f}" for value in entry)
            return f"the nearest entry that works is turned by {turn:.0f} degrees about the target: ({place}) LPS"
    return blocking.no_entry_works(turns)
