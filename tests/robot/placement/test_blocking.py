"""What the arm meets in its reference posture is told by name, and only at a base where it meets it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.forward import link_frames
from ronnaplan.robot.placement.job import Job
from ronnaplan.robot.placement.placement import Place, check_parked, find_places
from ronnaplan.robot.placement.room import Box, Capsule, Floor
from ronnaplan.robot.placement.route import Route, plan_route
from ronnaplan.robot.placement.search import Problem
from ronnaplan.robot.placement.serving import Served
from ronnaplan.robot.placement.world import world_of
from ronnaplan.transforms import transform_points
from tests.robot.placement.cases import job

FLOOR = Floor((-1000.0, -600.0), (-700.0, -300.0), (850.0, 850.0))
UPRIGHT_DEG = (0.0, -90.0, 0.0, 0.0, 30.0, 0.0)


@pytest.fixture(scope="module")
def found() -> tuple[Job, Place]:
    """A task, and the best place for it, of an arm that stands upright between tasks."""
    given = job(0, 1, 0, floor=FLOOR, reference_deg=UPRIGHT_DEG, tracker=None)
    return given, find_places(given).places[0]


def beside(given: Job, *things: Box | Capsule) -> Job:
    boxes = (*given.room.boxes, *(one for one in things if isinstance(one, Box)))
    capsules = (*given.room.capsules, *(one for one in things if isinstance(one, Capsule)))
    there = replace(given.room, boxes=boxes, capsules=capsules)
    return replace(given, room=there, world=world_of(there, given.world.head[:, :3], None))


def highest_mm(given: Job, place: Place) -> tuple[FloatArray, str]:
    """Where the arm and its tool end upwards in the reference posture (3,), and the body that does."""
    arm, up = given.arm, np.array([0.0, 0.0, 1.0])
    frames = place.room_from_r @ link_frames(arm, np.radians(place.route.reference_deg)[None])[0]
    bodies = [(frames[one.link], one.name, one.start_mm, one.end_mm, one.radius_mm) for one in arm.bodies]
    bodies += [
        (frames[-1] @ arm.flange, one.name, np.array(one.start_mm), np.array(one.end_mm), one.radius_mm)
        for one in given.room.tool.bodies
    ]
    tops = [
        (end + radius_mm * up, name)
        for pose, name, *ends, radius_mm in bodies
        for end in transform_points(pose, np.array(ends))
    ]
    return max(tops, key=lambda top: float(top[0][2]))


def ceiling(at_mm: float) -> Box:
    return Box("ceiling", (-800.0, -500.0, at_mm + 50.0), (3000.0, 3000.0, 100.0))


def test_what_the_arm_meets_in_its_reference_posture_is_told_with_how_near(found: tuple[Job, Place]) -> None:
    given, place = found
    (_, _, top_mm), body = highest_mm(given, place)
    told = []
    for higher_mm in (-5.0, 7.5, 19.5, 20.5):
        (here,) = check_parked(beside(given, ceiling(top_mm + higher_mm)), place.room_from_r).places
        assert here.route.stuck == (() if here.at_reference is None else ("T0",))
        told.append(here.at_reference)
    assert told == [
        *(
            f"{body} {near} ceiling in the reference posture; 20 mm are asked for"
            for near in ("would meet", "comes within 7 mm of", "comes within 19 mm of")
        ),
        None,
    ]


def test_a_base_at_which_the_reference_posture_is_free_is_chosen_before_a_better_one(
    found: tuple[Job, Place],
) -> None:
    given, place = found
    top, _ = highest_mm(given, place)
    lamp = Capsule("lamp", tuple(top.tolist()), tuple((top + 1.0).tolist()), 10.0)
    with_lamp = beside(given, lamp)
    (there,) = check_parked(with_lamp, place.room_from_r).places
    assert "lamp" in (there.at_reference or "")
    best = find_places(with_lamp).places[0]
    assert (best.route.stuck, best.at_reference) == ((), None)


def test_bases_with_no_free_way_at_all_are_told_apart_by_whether_the_reference_posture_is_free(
    found: tuple[Job, Place], monkeypatch: pytest.MonkeyPatch
) -> None:
    given, _ = found
    bases: list[FloatArray] = []

    def stuck(problem: Problem, base: FloatArray, *others: Any) -> tuple[Route, tuple[Served, ...]]:
        route, turned = plan_route(problem, base, *others)
        return replace(route, stuck=("T0",)), turned

    def met_at_first(_job: Job, _problem: Problem, base: FloatArray, _posture: FloatArray) -> str | None:
        bases.append(base)
        return "it meets a lamp" if len(bases) < 3 else None

    monkeypatch.setattr("ronnaplan.robot.placement.placement.plan_route", stuck)
    monkeypatch.setattr("ronnaplan.robot.placement.placement.blocking.at_reference", met_at_first)
    monkeypatch.setattr("ronnaplan.robot.placement.placement.in_threads", map)  # threads end in any order
    places = find_places(given).places
    assert all(one.at_reference is None for one in places)
    assert bases[2].tolist() in [one.room_from_r.tolist() for one in places]


def test_where_it_is_free_at_no_base_what_it_meets_at_the_best_is_told(found: tuple[Job, Place]) -> None:
    given, place = found
    (_, _, top_mm), body = highest_mm(given, place)
    places = find_places(beside(given, ceiling(top_mm + 5.0))).places
    assert {one.at_reference for one in places} == {
        f"{body} comes within 5 mm of ceiling in the reference posture; 20 mm are asked for"
    }
