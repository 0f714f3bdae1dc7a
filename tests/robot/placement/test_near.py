"""What the flange carries never overlaps the wrist, and is told where it comes nearer than all else may."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from math import floor

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.forward import link_frames
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.placement.blocking import OVERLAP, Blocked
from ronnaplan.robot.placement.clearances import posture_margins, standing_on
from ronnaplan.robot.placement.job import Job
from ronnaplan.robot.placement.machine import FREE, Machine, machine_of
from ronnaplan.robot.placement.near import nearest_mm, what_comes_near
from ronnaplan.robot.placement.placement import COARSE, Place, check_parked, find_places
from ronnaplan.robot.placement.room import Capsule, Room, Tool, base_pose
from ronnaplan.transforms import transform_points
from tests.long import few_and_others
from tests.robot.placement.cases import job, room
from tests.robot.placement.test_placement import WIDE

REFERENCE_DEG = np.array([0.0, -120.0, 120.0, 0.0, 60.0, 0.0])
BENT_DEG = np.array([0.0, -120.0, 120.0, 0.0, 118.0, 0.0])
NAMES = (*(one.name for one in kr6_r900().bodies), "cameras")


def carrying(*bodies: Capsule, **changes: object) -> Room:
    return room(tool=Tool((0.0, 0.0, 120.0), bodies=bodies), **changes)


BESIDE = carrying(Capsule("cameras", (0.0, -70.0, 20.0), (0.0, 70.0, 20.0), 35.0))


def told(*ways: tuple[str, FloatArray], there: Room = BESIDE) -> tuple[str, ...]:
    return what_comes_near(machine_of(kr6_r900(), there), ways, NAMES, 20.0)


def sampled_mm(machine: Machine, posture_deg: FloatArray) -> FloatArray:
    """Least distances (T, A) by places along the capsules, 1 mm or less apart."""
    frames = link_frames(kr6_r900(), np.radians(posture_deg)[None])[0]
    along = np.linspace(0.0, 1.0, 500)[:, None]
    lines = [
        transform_points(frames[link], row[:3] + along * (row[3:6] - row[:3]))
        for link, row in zip(machine.links, machine.bodies, strict=True)
    ]
    count, radii = machine.tool_from, machine.bodies[:, 6]
    return np.array(
        [
            [cdist(lines[k], lines[j]).min() - radii[k] - radii[j] for j in range(count)]
            for k in range(count, len(lines))
        ]
    )


@few_and_others("seed", range(2), range(2, 5))
def test_how_near_they_come_is_that_of_places_along_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    machine = machine_of(kr6_r900(), room())
    posture_deg = rng.uniform(-110.0, 40.0, 6)
    assert nearest_mm(machine, posture_deg[None]) == pytest.approx(sampled_mm(machine, posture_deg), abs=0.01)


def test_cameras_that_a_bent_wrist_brings_to_the_forearm_are_told_once_and_where_they_are_nearest() -> None:
    less_deg = np.array([0.0, -120.0, 120.0, 0.0, 95.0, 0.0])
    more_deg = np.array([0.0, -120.0, 120.0, 0.0, 100.0, 0.0])
    machine = machine_of(kr6_r900(), BESIDE)
    left_mm = sampled_mm(machine, more_deg)[0, NAMES.index("forearm")]
    assert 1.0 < left_mm < sampled_mm(machine, less_deg)[0, NAMES.index("forearm")] < 20.0
    (sentence,) = told(
        ("on the way of A", np.array([REFERENCE_DEG, less_deg])), ("on the way of B", more_deg[None])
    )
    assert sentence == (
        f"cameras comes within {floor(left_mm)} mm of forearm on the way of B: the two are only kept from overlapping"
    )
    (sentence,) = told(("on the way of A", np.array([REFERENCE_DEG, less_deg])))
    assert "of forearm on the way of A" in sentence
    assert told(("on the way of A", REFERENCE_DEG[None])) == ()


def test_what_lies_between_two_postures_is_looked_at() -> None:
    machine, ends_deg = machine_of(kr6_r900(), BESIDE), np.array([BENT_DEG, BENT_DEG])
    ends_deg[:, 4] = -100.0, 118.0
    ends_deg[0, 5], ends_deg[1, 5] = 90.0, -90.0
    way_deg = np.linspace(ends_deg[0], ends_deg[1], 110)
    least_mm = np.min([sampled_mm(machine, one) for one in way_deg], axis=0)
    assert nearest_mm(machine, ends_deg) == pytest.approx(least_mm, abs=0.1)
    assert (least_mm < np.minimum(*(sampled_mm(machine, one) for one in ends_deg)) - 1.0).any()


def test_what_is_as_near_in_every_posture_is_how_the_tool_is_drawn_and_not_told() -> None:
    holder = carrying(Capsule("cameras", (0.0, 0.0, 0.0), (0.0, 0.0, 95.0), 25.0))
    apart_mm = [nearest_mm(machine_of(kr6_r900(), holder), one[None])[0] for one in (REFERENCE_DEG, BENT_DEG)]
    assert [one[NAMES.index("wrist")] for one in apart_mm] == pytest.approx([-45.0, -45.0], abs=20.0)
    assert not any("wrist" in sentence for sentence in told(("there", BENT_DEG[None]), there=holder))


def clearance_mm(given: Job, posture_deg: FloatArray, instrument: FloatArray) -> tuple[float, list[int]]:
    """Least distance that counts in a posture far from all else, and the two that are nearest."""
    problem = given.problem(COARSE)
    standing = standing_on(problem.machine, base_pose(np.array([-3000.0, 0.0, 900.0, 180.0])))
    standing = standing._replace(trolley=np.empty((0, 8)))
    angles = np.radians(posture_deg)
    near, _ = posture_margins(problem.machine, problem.world, standing, instrument, angles, np.inf, False)
    return near, standing.pair.tolist()


def test_a_posture_in_which_the_tool_overlaps_the_wrist_is_a_collision_and_named() -> None:
    given, none = job(0, 1, 0, floor=WIDE, tool=BESIDE.tool), np.zeros(7)
    assert clearance_mm(given, REFERENCE_DEG, none)[0] > given.room.margins.clearance_mm
    overlap_mm = -sampled_mm(machine_of(given.arm, given.room), BENT_DEG)[0, NAMES.index("forearm")]
    assert overlap_mm > 5.0
    near, pair = clearance_mm(given, BENT_DEG, none)
    assert near == pytest.approx(-overlap_mm, abs=0.01)
    assert [NAMES[k] for k in pair] == ["cameras", "forearm"]


def test_a_posture_in_which_an_instrument_overlaps_the_wrist_is_a_collision_though_the_tool_has_no_bodies() -> (
    None
):
    sideways = Tool((0.0, 0.0, 20.0), direction=(1.0, 0.0, 0.0))
    given = job(0, 1, 0, floor=WIDE, tool=sideways)
    instrument = given.problem(COARSE).ways.instruments[0]
    assert clearance_mm(given, REFERENCE_DEG, instrument)[0] > given.room.margins.clearance_mm
    drawn = machine_of(given.arm, carrying(Capsule("drill", (0.0, 0.0, 20.0), (180.0, 0.0, 20.0), 1.2)))
    overlap_mm = -sampled_mm(drawn, BENT_DEG)[0, NAMES.index("forearm")]
    assert overlap_mm > 5.0
    near, (body, other) = clearance_mm(given, BENT_DEG, instrument)
    assert near == pytest.approx(-overlap_mm, abs=0.01)
    assert (body, NAMES[other]) == (len(given.arm.bodies), "forearm")
    told_so = Blocked(OVERLAP, near, body, other).sentence(given, "from here")
    assert told_so == "the instrument would meet forearm from here"


@cache
def found(seed: int) -> tuple[Machine, tuple[Place, ...]]:
    """Return the machine of a random job, and the places that are found for it."""
    given = job(seed, 1, 0, floor=WIDE)
    return machine_of(given.arm, given.room), find_places(given).places


@few_and_others("seed", [3], [5])
def test_no_place_that_is_found_has_the_tool_overlap_the_wrist(seed: int) -> None:
    machine, places = found(seed)
    assert places
    kept = machine.kept[machine.tool_from : -1, : machine.tool_from] != FREE
    for place in places:
        ways = [one.angles_deg for one in place.served]
        ways += [np.array([a, b]) for (_, a), (_, b) in itertools.pairwise(place.route.corners)]
        assert min(nearest_mm(machine, way)[kept].min() for way in ways) > -0.5


@pytest.mark.parametrize(("seed", "is_near"), [(0, False), (3, True)])
def test_each_place_that_is_found_tells_it(seed: int, is_near: bool) -> None:
    machine, places = found(seed)
    assert places
    for place in places:
        postures = np.concatenate(
            [*(one.angles_deg for one in place.served), *(np.array([one]) for _, one in place.route.corners)]
        )
        least_mm = np.min([sampled_mm(machine, one)[:, NAMES.index("forearm")] for one in postures])
        assert (least_mm < 20.0) == is_near
        assert any(" of forearm " in sentence for sentence in place.near) == is_near


def test_a_tool_that_meets_the_wrist_with_any_roll_is_told() -> None:
    given = job(3, 1, 0, floor=WIDE, tracker=None)
    base = find_places(given).places[0].room_from_r
    spokes = [110.0 * np.array([np.cos(turn), np.sin(turn), 0.0]) for turn in np.arange(6) * np.pi / 6]
    star = [Capsule("spoke", (-x, -y, 20.0), (x, y, 20.0), 35.0) for x, y, _ in spokes]
    tool = Tool(
        (0.0, 0.0, 120.0), bodies=tuple(replace(one, name=f"{one.name} {n}") for n, one in enumerate(star))
    )
    (sentence,) = check_parked(replace(given, room=room(tool=tool)), base).blocked
    assert "would meet forearm from here; the nearest entry" in sentence
