"""Where the robot shall stand: what is found holds when looked at by other means, and what blocks is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import binary_erosion
from scipy.spatial.distance import pdist

from ronnaplan.ct.volume import SeriesSource
from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.placement import placement_text
from ronnaplan.documents.placement_made import placement_document
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import FloatArray, Frame, Points
from ronnaplan.planning import Plan, Trajectory
from ronnaplan.planning.beside import beside
from ronnaplan.planning.head import SKIN_HU, Head
from ronnaplan.robot.arm.forward import forward
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.arm.quality import joint_margins_deg, singularity_deg
from ronnaplan.robot.placement.blocking import turned_entries
from ronnaplan.robot.placement.clearances import to_head
from ronnaplan.robot.placement.job import Job
from ronnaplan.robot.placement.machine import machine_of
from ronnaplan.robot.placement.most import served_each
from ronnaplan.robot.placement.parking import strayed
from ronnaplan.robot.placement.placement import COARSE, Placement, check_parked, find_places
from ronnaplan.robot.placement.room import Box, Capsule, Floor, HeadPose, Margins, Parking, Tool, base_pose
from ronnaplan.robot.placement.route import Route, plan_route
from ronnaplan.robot.placement.search import Problem, asking, grid, within, worths
from ronnaplan.robot.placement.serving import Served, serve, served_by_each
from ronnaplan.robot.placement.tasks import drill_task
from ronnaplan.robot.placement.world import world_of
from ronnaplan.transforms import transform_points
from tests import cases
from tests.long import few_and_others, few_or_all
from tests.robot.arm.arms import KR6, UR5E_M, UR10E_M, calibrated_ur5e, hanging, iiwa, panda, ur
from tests.robot.arm.test_kinematics import read
from tests.robot.placement.cases import CENTER_MM, HEAD_MM, job, room, surface

SMALL = Floor((-800.0, -650.0), (-600.0, -500.0), (850.0, 900.0))
CEILING = Floor((-800.0, -650.0), (-300.0, -200.0), (1750.0, 1850.0))


@pytest.fixture
def few_further_bases_and_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thousands that serve nothing take half a minute, and 180 entries in the place of a blocked one seconds."""
    monkeypatch.setattr("ronnaplan.robot.placement.placement.SCATTERED", 64)
    monkeypatch.setattr("ronnaplan.robot.placement.blocking.TURNS_DEG", np.array([15.0, 45.0]))


@pytest.fixture(scope="module")
def found() -> tuple[Job, Placement]:
    given = job(0, 3, 2, floor=replace(SMALL, trolley=room().floor.trolley))
    return given, find_places(given)


def test_every_task_is_reached_all_along_its_way_within_the_margins(found: tuple[Job, Placement]) -> None:
    given, placement = found
    place, arm, asked = placement.places[0], kr6_r900(), given.room.margins
    for task, served in zip(given.tasks, place.served, strict=True):
        tips = (place.room_from_r @ forward(arm, np.radians(served.angles_deg)) @ task.flange_from_tip)[:, :3]
        ends = np.array([task.starts_mm, task.ends_mm])
        way = np.linalg.norm(tips[[0, -1], :, 3][:, None] - ends, axis=-1).max(axis=0).argmin()
        start, end = task.starts_mm[way], task.ends_mm[way]
        inward = (end - start) / np.linalg.norm(end - start)
        np.testing.assert_allclose(tips[[0, -1], :, 3], [start, end], atol=1e-6)
        assert np.abs(np.cross(tips[:, :, 3] - start, inward)).max() < 1e-6
        assert np.abs(tips[:, :, 2] - inward).max() < 1e-9
        assert np.linalg.norm(np.diff(tips[:, :, 3], axis=0), axis=1).max() <= 5.0 + 1e-9
        assert np.abs(np.diff(served.angles_deg, axis=0)).max() < 20
        angles = np.radians(served.angles_deg)
        assert joint_margins_deg(arm, angles).min() == pytest.approx(served.joint_deg, abs=1e-6)
        assert singularity_deg(arm, angles).min() == pytest.approx(served.singularity_deg, abs=1e-6)
        assert served.joint_deg >= asked.joint_deg
        assert served.singularity_deg >= asked.singularity_deg
        assert served.clearance_mm >= asked.clearance_mm
        assert served.tracker_deg >= asked.tracker_deg
    assert place.worst_joint_deg == min(one.joint_deg for one in place.served)
    assert set(place.route.order) | set(place.route.stuck) == {task.name for task in given.tasks}
    assert [name[0] for name in place.route.order] == sorted(name[0] for name in place.route.order)


OTHERS = {
    "ur": (ur(UR10E_M), (), (0.0, -120.0, 120.0, -90.0, -90.0, 0.0)),
    "calibrated": (calibrated_ur5e(), (), (0.0, -120.0, 120.0, -90.0, -90.0, 0.0)),
    "iiwa": (iiwa(), ("joint_a3",), (0.0, -30.0, 90.0, 0.0, 60.0, 0.0)),
    "panda": (panda(), ("panda_joint7",), (0.0, -45.0, 0.0, -135.0, 0.0, 90.0)),
    "hanging": (hanging(KR6), (), (0.0, -120.0, 120.0, 0.0, 60.0, 0.0)),
}
"""Arms of other kinds, and one under a ceiling, which of their joints are held, and their postures of reference."""


@few_and_others("name", ["calibrated", "hanging"], ["ur", "iiwa", "panda"])
def test_other_arms_are_placed_and_reach_every_task_by_their_own_joints(name: str, tmp_path: Path) -> None:
    text, held, reference_deg = OTHERS[name]
    whole = read(text, tmp_path)
    arm = whole
    for joint in held:
        arm = arm.holding(joint, 0.0)
    floor = CEILING if name == "hanging" else SMALL
    given = replace(job(0, 2, 1, floor=floor, reference_deg=reference_deg), arm=arm)
    placement = find_places(given)
    place = placement.places[0]
    drawn = placement_document(placement, given.room, arm, Source()).robot_from_ct[0].robot
    assert drawn is not None
    assert drawn.shoulder[:2] == pytest.approx(place.room_from_r[:2, 3])
    for task, served in zip(given.tasks, place.served, strict=True):
        every_deg = served.angles_deg
        for joint in held:
            every_deg = np.insert(every_deg, whole.joints.index(joint), 0.0, axis=1)
        flanges = place.room_from_r @ forward(whole, np.radians(every_deg))
        holders_mm = flanges[:, :3, :3] @ given.room.tool.start_mm + flanges[:, :3, 3]
        assert np.linalg.norm(holders_mm - drawn.shoulder, axis=1).max() <= drawn.reach
        tips = flanges @ task.flange_from_tip
        away = np.linalg.norm(tips[[0, -1], None, :3, 3] - np.array([task.starts_mm, task.ends_mm]), axis=-1)
        assert away.max(axis=0).min() < 1e-6
        assert joint_margins_deg(whole, np.radians(every_deg)).min() >= served.joint_deg - 1e-6
        assert singularity_deg(arm, np.radians(served.angles_deg)).min() == pytest.approx(served.singularity_deg)
        assert served.singularity_deg >= given.room.margins.singularity_deg
        assert served.clearance_mm >= given.room.margins.clearance_mm


@pytest.mark.usefixtures("few_further_bases_and_entries")
def test_what_blocks_a_held_arm_is_told_by_the_names_of_its_joints_and_links(tmp_path: Path) -> None:
    text, (joint,), reference_deg = OTHERS["iiwa"]
    arm = read(text, tmp_path).holding(joint, 0.0)
    on_last = Capsule("fist", (0.0, 0.0, 0.0), (0.0, 0.0, 100.0), 400.0)
    given = replace(job(0, 1, 0, floor=SMALL, reference_deg=reference_deg), arm=arm)
    base = base_pose(np.array([-800.0, -600.0, 900.0, 102.0]))
    assert check_parked(given, base).places
    told = check_parked(replace(given, room=replace(given.room, arm_bodies=((7, on_last),))), base)
    assert "fist would meet" in told.blocked[0]
    tight = replace(given.room, margins=Margins(joint_deg=89.0))
    told = check_parked(replace(given, room=tight, world=world_of(tight, given.world.head[:, :3], None)), base)
    assert "joint joint_a" in told.blocked[0]


@pytest.mark.usefixtures("few_further_bases_and_entries")
def test_what_blocks_is_named_by_the_two_that_are_nearest_to_each_other() -> None:
    """What came too near to the instrument was named, and not what the arm would stand in."""
    given = job(0, 1, 0, floor=SMALL)
    place = np.array([-800.0, -600.0, 900.0, 102.0])
    assert check_parked(given, base_pose(place)).places
    start, end = given.tasks[0].starts_mm[0], given.tasks[0].ends_mm[0]
    side = np.cross(end - start, [0.0, 0.0, 1.0])
    x, y, z = start + 25.0 * side / np.linalg.norm(side)
    pillar = Box("pillar", (-800.0, -600.0, 1300.0), (100.0, 100.0, 100.0))
    lamp = Capsule("lamp", (x, y, z), (x, y, z), 5.0)
    for boxes, named in (((), "the instrument comes within 18 mm of lamp"), ((pillar,), "would meet pillar")):
        crowded = replace(given.room, boxes=boxes, capsules=(lamp,))
        world = world_of(crowded, given.world.head[:, :3], None)
        told = check_parked(replace(given, room=crowded, world=world), base_pose(place))
        assert named in told.blocked[0]


def test_no_place_of_the_floor_is_better(found: tuple[Job, Placement]) -> None:
    given, placement = found
    coarse, rng = given.problem(COARSE), np.random.default_rng(1)
    floor = given.room.floor
    least, greatest = np.array([floor.x_mm, floor.y_mm, floor.z_mm, (0.0, 90.0)]).T
    (best,) = worths(coarse, place_of(placement.places[0].room_from_r))
    assert worths(coarse, rng.uniform(least, greatest, (40, 4))).max() <= best + 1e-9


def test_places_that_the_tracker_sees_as_poorly_are_told_apart_by_the_joints() -> None:
    """The view depends on the roll about the axis, hardly on the base: what it allows for is the same everywhere."""
    tool = room().tool
    assert tool.marker is not None
    given = job(
        0,
        1,
        0,
        floor=SMALL,
        tool=replace(tool, marker=replace(tool.marker, seen_deg=24.0)),
        margins=Margins(tracker_deg=1.0),
    )
    (place, *_) = find_places(given).places
    coarse, rng = given.problem(COARSE), np.random.default_rng(1)
    there = place_of(place.room_from_r)
    (worth,) = worths(coarse, there)
    least, greatest = np.array([SMALL.x_mm, SMALL.y_mm, SMALL.z_mm, (0.0, 90.0)]).T
    others = rng.uniform(least, greatest, (60, 4))
    found = worths(coarse, others)
    alike = found > worth - 0.01
    assert alike.sum() > 10
    joints = [min(one.joint_deg, one.singularity_deg) for one in place.served]
    assert min(joints) > 2 * worth
    assert worths(asking(coarse, worth), others[alike]).max() <= worths(asking(coarse, worth), there)[0]


@few_and_others("allowed", [(0.0, 1.0), (0.1, 0.3)], [(-1.0, 0.0), (360.0, 360.0)])
def test_where_only_a_few_turns_are_allowed_these_are_tried(
    allowed: tuple[float, float], found: tuple[Job, Placement]
) -> None:
    """Of turns that a place is found with, some that no place of the grid faces the head at."""
    given, placement = found
    turn = float(np.degrees(np.arctan2(*placement.places[0].room_from_r[[1, 0], 0])))
    ends = (turn + allowed[0], turn + allowed[1])
    floor = replace(given.room.floor, turn_deg=ends)
    narrow = replace(given, room=replace(given.room, floor=floor))
    bases = grid(narrow.problem(COARSE))
    assert len(bases) >= 12
    assert len(np.unique(bases, axis=0)) == len(bases)
    assert ((bases[:, 3] >= ends[0]) & (bases[:, 3] <= ends[1])).all()
    np.testing.assert_array_equal(within(floor, bases), bases)
    assert find_places(narrow).places


def test_a_turn_that_is_not_allowed_becomes_the_nearer_end_of_those_that_are(found: tuple[Job, Placement]) -> None:
    given, _ = found
    every = grid(given.problem(COARSE))
    floor = replace(given.room.floor, turn_deg=(-20.0, 60.0))
    some = grid(replace(given, room=replace(given.room, floor=floor)).problem(COARSE))
    from_middle = np.mod(every[:, 3] - 20.0 + 180.0, 360.0) - 180.0
    assert (np.abs(from_middle) > 40.0).any()
    expected = np.column_stack([every[:, :3], 20.0 + np.clip(from_middle, -40.0, 40.0)])
    assert {tuple(row) for row in some.round(6)} == {tuple(row) for row in expected.round(6)}


def test_a_floor_far_wider_than_the_arm_is_searched_where_the_arm_reaches(found: tuple[Job, Placement]) -> None:
    given, _ = found
    wide = replace(given.room.floor, x_mm=(-1e5, 1e5), y_mm=(-1e5, 1e5), z_mm=(-1e5, 1e5))
    bases = grid(replace(given, room=replace(given.room, floor=wide)).problem(COARSE))
    assert 0 < len(bases) < 1e6


def test_a_reference_posture_beyond_the_arm_is_refused_by_the_joint(found: tuple[Job, Placement]) -> None:
    given, _ = found
    for reference, told in (
        ((360.0, -360.0, 120.0, 0.0, 60.0, 0.0), r"-360 degrees for joint 2 of .*; expected -190\.0 to 45\.0"),
        ((0.0, -120.0, 120.0, 0.0, 130.0, 0.0), r"130 degrees for joint 5 of .*; expected -120\.0 to 120\.0"),
    ):
        with pytest.raises(InputError, match=told):
            find_places(replace(given, room=replace(given.room, reference_deg=reference)))


def test_a_reference_posture_in_which_the_robot_meets_itself_is_refused_before_all_else(tmp_path: Path) -> None:
    """The middles of a UR's limits, with which an example begins; and one that is nearer to itself than asked for."""
    given = replace(job(0, 1, 0, floor=SMALL, reference_deg=(0.0,) * 6), arm=read(ur(UR5E_M), tmp_path))
    with pytest.raises(
        InputError, match="of the room cameras would meet l4, so that no way leads from it; state a"
    ):
        find_places(given)
    given = job(0, 1, 0, floor=SMALL, margins=Margins(clearance_mm=400.0))
    with pytest.raises(
        InputError, match=r"comes within \d+ mm of .*; state a posture in which they are 400 mm apart"
    ):
        find_places(given)


def test_links_that_are_drawn_so_thickly_that_no_posture_parts_them_are_named(tmp_path: Path) -> None:
    """Another posture was asked for, and there is none: a UR5e's wrist is 140 mm from joint 4 to its last link."""
    arm = read(ur(UR5E_M), tmp_path)
    for radius_mm, told in (
        (75.0, r"flange would meet forearm in 512 postures .*; 20 mm are asked for"),
        (40.0, ""),
    ):
        forearm, flange = (
            (link, Capsule(name, (0.0, 0.0, 0.0), end, radius_mm))
            for link, name, end in ((3, "forearm", (-392.2, 0.0, 133.3)), (6, "flange", (0.0, 0.0, 20.0)))
        )
        posture = (0.0, -79.0, 80.0, 60.0, 81.0, -17.0)
        placed = room(reference_deg=posture, arm_bodies=(forearm, flange), tool=Tool((0.0, 0.0, 120.0)))
        if told:
            with pytest.raises(InputError, match=told):
                machine_of(arm, placed)
        else:
            machine_of(arm, placed)


def test_a_reference_posture_may_be_at_a_limit() -> None:
    limits_deg = np.array([[-170, 170], [-120, 120], [-100, 120], [-185, 185], [-120, 120], [-350, 350]])
    arm = replace(kr6_r900(), limits_rad=np.radians(limits_deg))
    assert machine_of(arm, room()).tool_from == len(arm.bodies)


def place_of(base: FloatArray) -> FloatArray:
    return np.array([[*base[:3, 3], np.degrees(np.arctan2(base[1, 0], base[0, 0]))]])


def test_what_lies_between_the_places_of_the_grid_is_found(
    found: tuple[Job, Placement], monkeypatch: pytest.MonkeyPatch
) -> None:
    given, placement = found
    useless = np.array([[-1000.0, -800.0, 850.0, -180.0]])
    monkeypatch.setattr("ronnaplan.robot.placement.placement.grid", lambda _: useless)
    monkeypatch.setattr("ronnaplan.robot.placement.placement.SCATTERED", 512)
    again = find_places(given)
    assert again.places
    assert again.places[0].worst_joint_deg > 0.5 * placement.places[0].worst_joint_deg


WIDE = replace(SMALL, x_mm=(-1000.0, -700.0), y_mm=(-700.0, -300.0))


def test_what_a_base_leaves_unserved_shows_the_way_to_one_that_serves_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """It lies in a few millimetres at times, where none of thousands of bases all over the floor comes to lie."""
    given = job(0, 3, 2, floor=WIDE)
    problem = given.problem(COARSE)
    bases = grid(problem)
    counts = served_each(problem, bases).sum(axis=1)
    beside = bases[(counts > 0) & (counts < len(problem))][:1]
    assert len(beside)
    monkeypatch.setattr("ronnaplan.robot.placement.placement.grid", lambda _: beside)
    monkeypatch.setattr("ronnaplan.robot.placement.placement.scattered", lambda *_: np.empty((0, 4)))
    assert find_places(given).places


def test_alternatives_stand_apart_where_the_best_ones_lie_around_one_place() -> None:
    given = job(0, 1, 0, floor=WIDE)
    places = find_places(given).places
    at = np.array([place.room_from_r[:3, 3] for place in places])
    assert len(places) == 3
    assert pdist(at).min() >= 150.0
    assert all(one.joint_deg > 45.0 for place in places for one in place.served)  # refined as the best is


def test_a_base_from_where_all_ways_are_free_comes_before_one_that_is_better_but_stuck(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bases: list[FloatArray] = []

    def stuck_at_first(problem: Problem, base: FloatArray, *given: Any) -> tuple[Route, tuple[Served, ...]]:
        route, turned = plan_route(problem, base, *given)
        bases.append(base)
        return replace(route, stuck=("T0",)) if len(bases) == 1 else route, turned

    monkeypatch.setattr("ronnaplan.robot.placement.placement.plan_route", stuck_at_first)
    monkeypatch.setattr("ronnaplan.robot.placement.placement.in_threads", map)  # threads end in any order
    places = find_places(job(0, 1, 0, floor=WIDE)).places
    assert [place.room_from_r.tolist() for place in places] == [bases[n].tolist() for n in (1, 2, 3)]


def test_a_base_whose_tasks_are_reached_by_worse_ways_alone_comes_after_those_that_are_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bases: list[FloatArray] = []

    def worse_at_first(problem: Problem, base: FloatArray, *given: Any) -> tuple[Route, tuple[Served, ...]]:
        route, turned = plan_route(problem, base, *given)
        bases.append(base)
        return route, tuple(replace(one, joint_deg=6.0) for one in turned) if len(bases) == 1 else turned

    monkeypatch.setattr("ronnaplan.robot.placement.placement.plan_route", worse_at_first)
    monkeypatch.setattr("ronnaplan.robot.placement.placement.in_threads", map)  # threads end in any order
    places = find_places(job(0, 1, 0, floor=WIDE)).places
    assert [place.room_from_r.tolist() for place in places][-1] == bases[0].tolist()
    assert len(places) == 3


def test_a_task_whose_best_ways_no_free_move_reaches_is_taken_by_another(
    found: tuple[Job, Placement], monkeypatch: pytest.MonkeyPatch
) -> None:
    given, placement = found
    base, problem, task = placement.places[0].room_from_r, given.problem(COARSE), given.tasks[0]
    served = serve(problem, given.tasks, base)
    best = tuple(one for one in served if one is not None)
    barred = np.radians(best[0].angles_deg[0])
    again = next(served_by_each(problem, task, 0, base))
    np.testing.assert_array_equal(again.angles_deg, best[0].angles_deg)

    def leads_elsewhere(*given: Any) -> bool:
        return not any((np.cos(end - barred) > np.cos(np.radians(25.0))).all() for end in given[3])

    monkeypatch.setattr("ronnaplan.robot.placement.route.is_free", leads_elsewhere)
    route, (taken, *others) = plan_route(problem, base, best, np.array(given.room.reference_deg))
    assert route.stuck == ()
    assert "T0" in route.order
    apart_deg = taken.angles_deg[0] - best[0].angles_deg[0]
    assert np.abs((apart_deg + 180.0) % 360.0 - 180.0).max() > 25.0
    tips = (base @ forward(kr6_r900(), np.radians(taken.angles_deg)) @ task.flange_from_tip)[:, :3, 3]
    np.testing.assert_allclose(tips[[0, -1]], [task.starts_mm[0], task.ends_mm[0]], atol=1e-6)
    asked = given.room.margins
    assert taken.joint_deg >= asked.joint_deg
    assert taken.clearance_mm >= asked.clearance_mm
    assert [one.clearance_mm for one in others] == [one.clearance_mm for one in best[1:]]


def test_the_document_says_the_same(found: tuple[Job, Placement]) -> None:
    given, placement = found
    document = placement_document(placement, given.room, given.arm, Source())
    assert document.status == "placed"
    (first, *_) = document.robot_from_ct
    np.testing.assert_allclose(
        np.array(first.room_from_r) @ np.array(first.r_from_ct), given.room_from_ct, atol=1e-9
    )
    assert "place 1: x" in placement_text(document)


@pytest.mark.usefixtures("few_further_bases_and_entries")
def test_a_base_that_was_measured_is_checked(found: tuple[Job, Placement]) -> None:
    given, placement = found
    moved = placement.places[0].room_from_r.copy()
    moved[0, 3] += 3.0
    here = check_parked(given, moved)
    assert here.places[0].probability is None
    far = moved.copy()
    far[0, 3] -= 900.0
    blocked = check_parked(given, far)
    assert not blocked.places
    assert any("T0: out of the arm's reach from here" in sentence for sentence in blocked.blocked)


def test_parking_strays_as_it_is_told() -> None:
    places = strayed(np.array([100.0, 200, 900, 30]), Parking(20.0, 3.0), 1024)
    np.testing.assert_allclose(places.mean(axis=0), [100, 200, 900, 30], atol=0.5)
    np.testing.assert_allclose(places.std(axis=0), [20, 20, 0, 3], rtol=0.03, atol=1e-12)


@pytest.mark.usefixtures("few_further_bases_and_entries")
def test_the_one_base_of_a_floor_is_found_where_only_rolls_between_those_of_the_search_serve(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It was refused, though as the base that was measured there it serves all."""
    monkeypatch.setattr("ronnaplan.robot.placement.placement.probability", lambda *_: None)
    given, (x, y, z, turn) = job(730007, 16, 8), (-780.0, -188.0, 801.0, 91.0)
    floor = replace(given.room.floor, x_mm=(x, x), y_mm=(y, y), z_mm=(z, z), turn_deg=(turn, turn))
    given = replace(given, room=replace(given.room, floor=floor), tasks=given.tasks[3:4])
    assert check_parked(given, base_pose(np.array([x, y, z, turn]))).places
    assert find_places(given).places


def blocked(trajectory: tuple[FloatArray, FloatArray], **changes: object) -> str:
    given = job(0, 1, 0, floor=SMALL, **changes)
    task = drill_task("LH", *trajectory, given.room.tool, 180.0, 2.4)
    told = find_places(replace(given, tasks=(task,)))
    assert not told.places
    (sentence,) = told.blocked
    return sentence


ABOVE_MM, FAR_MM = np.array([0.0, 0, 95]), np.array([1500.0, 0, 0])
FROM_ABOVE = (CENTER_MM + ABOVE_MM, CENTER_MM)


@pytest.mark.usefixtures("few_further_bases_and_entries")
def test_what_blocks_is_told() -> None:
    assert "out of the arm's reach" in blocked((CENTER_MM + 1.1 * FAR_MM, CENTER_MM + FAR_MM))
    assert "a singular posture" in blocked(FROM_ABOVE, margins=Margins(singularity_deg=89.0))
    assert "its limit for every base that was tried; 80 are asked for" in blocked(
        FROM_ABOVE, margins=Margins(joint_deg=80.0)
    )
    assert "the tracker does not see" in blocked(FROM_ABOVE, margins=Margins(tracker_deg=74.0))
    from_below = blocked((CENTER_MM - ABOVE_MM, CENTER_MM))
    assert from_below.startswith("trajectory LH: ")
    assert "nearest entry that works is turned by" in from_below or "works either" in from_below


@pytest.mark.usefixtures("few_further_bases_and_entries")
def test_an_instrument_too_short_meets_the_head_with_its_holder() -> None:
    given = job(0, 1, 0, floor=SMALL, tracker=None)
    task = drill_task("LH", *FROM_ABOVE, given.room.tool, 95.0, 2.4)
    (sentence,) = find_places(replace(given, tasks=(task,))).blocked
    assert "holder would meet the head for every base that was tried; 20 mm are asked for" in sentence


@pytest.mark.usefixtures("few_further_bases_and_entries")
def test_what_a_body_would_meet_is_named_though_the_tracker_sees_not_every_roll() -> None:
    board = Box("board", (0.0, 0.0, 1190.0), (400.0, 400.0, 20.0))
    sentence = blocked(FROM_ABOVE, boxes=(*room().boxes, board))
    assert "board for every base that was tried; 20 mm are asked for" in sentence
    low = Capsule("rail", (-150.0, -300.0, 1180.0), (-150.0, 300.0, 1180.0), 200.0)
    assert "would meet rail" in blocked(FROM_ABOVE, boxes=(), capsules=(low,))


@pytest.mark.usefixtures("few_further_bases_and_entries")
def test_a_trolley_that_cannot_stand_there_is_named_from_a_base_that_was_measured(
    found: tuple[Job, Placement],
) -> None:
    given, placement = found
    base = placement.places[0].room_from_r
    cart = Box("cart", (*base[:2, 3], 200.0), (200.0, 200.0, 200.0))
    placed = replace(given.room, boxes=(*given.room.boxes, cart))
    blocked_by = check_parked(
        replace(given, room=placed, world=world_of(placed, given.world.head[:, :3], None)), base
    )
    assert "the trolley would stand nearer than 20 mm" in blocked_by.blocked[0]


def test_the_entry_that_is_proposed_lies_as_deep_beneath_the_scalp() -> None:
    target = CENTER_MM + np.array([30.0, 10, -5])
    head = world_of(room(), surface(np.random.default_rng(1)), None).head[:, :3]
    starts, _ = turned_entries(CENTER_MM + np.array([0.0, 0, HEAD_MM[2] + 30]), target, head)
    away_mm = np.linalg.norm(starts - target, axis=1)
    out, inside = (starts - target) / away_mm[:, None] / HEAD_MM, (target - CENTER_MM) / HEAD_MM
    half, square = out @ inside, (out**2).sum(axis=1)
    scalp_mm = (-half + np.sqrt(half**2 + square * (1 - inside @ inside))) / square
    assert np.ptp(scalp_mm) > 40.0
    np.testing.assert_allclose(away_mm - scalp_mm, 30.0, atol=3.0)


def test_the_head_lies_in_the_room_as_stated() -> None:
    axes = HeadPose((0.0, 0.0, 1000.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)).room_from_ct(np.array([1.0, 2, 3]))
    np.testing.assert_allclose(axes @ [1, 2, 3, 1], [0, 0, 1000, 1], atol=1e-12)
    assert np.linalg.det(axes[:3, :3]) == pytest.approx(1)
    np.testing.assert_allclose(axes[:3, :3] @ [0, -1, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(axes[:3, :3] @ [0, 0, 1], [-1, 0, 0], atol=1e-12)
    with pytest.raises(InputError, match="not perpendicular"):
        HeadPose((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.5, 1.0)).room_from_ct(np.zeros(3))


def test_a_plan_becomes_tasks_in_the_room() -> None:
    plan = Plan(SeriesSource(frame_of_reference_uid="1.2"), None)
    surface, center = np.random.default_rng(0).normal(size=(500, 3)) * 80, np.zeros(3)
    with pytest.raises(InputError, match="no trajectories"):
        Job.of_plan(kr6_r900(), room(), plan, None, surface, center)
    plan = plan.add(Trajectory("LH", np.array([20.0, 10, 90]), np.array([5.0, 6, 7]), plan.frame))
    markers = Points(np.array([[0.0, -80, 60]]), np.zeros((1, 3, 3)), ("F1",), plan.frame)
    ots_from_ct = np.eye(4)
    ots_from_ct[:3, 3] = (0, 0, 1500)
    made = Job.of_plan(kr6_r900(), room(), plan, markers, surface, center, ots_from_ct)
    assert [task.name for task in made.tasks] == ["LH", "F1"]
    np.testing.assert_allclose(made.tasks[0].ends_mm, [CENTER_MM + np.array([-7.0, 5, -6])], atol=1e-9)
    np.testing.assert_allclose(made.world.tracker, CENTER_MM + FAR_MM, atol=1e-9)
    with pytest.raises(FrameMismatchError):
        Job.of_plan(kr6_r900(), room(), plan, replace(markers, frame=Frame("CT", "1.3")), surface, center)


def test_arm_and_tool_are_kept_from_a_marker_wherever_it_stands_on_the_scalp() -> None:
    plan = Plan(SeriesSource(frame_of_reference_uid="1.2"), None)
    plan = plan.add(Trajectory("LH", np.array([20.0, 10, 90]), np.array([5.0, 6, 7]), plan.frame))
    scalp = surface(np.random.default_rng(2)) - CENTER_MM
    out = scalp[:50] / np.linalg.norm(scalp[:50], axis=1, keepdims=True)
    for at in scalp[:50] + 7.0 * out:  # the middle of a ball of 11.5 mm that is glued to it
        markers = Points(at[None], np.zeros((1, 3, 3)), ("F1",), plan.frame)
        made = Job.of_plan(kr6_r900(), room(), plan, markers, scalp, np.zeros(3))
        placed = made.room_from_ct[:3, :3] @ at + made.room_from_ct[:3, 3]
        assert np.linalg.norm(made.world.head[:, :3] - placed, axis=1).min() < 1e-9
        middle, reach = made.world.head_ball[:3], made.world.head_ball[3]
        assert np.linalg.norm(placed - middle) <= reach - 6.0 + 1e-9


def test_a_large_marker_is_kept_clear_of_by_its_own_radius() -> None:
    """A ball of 40 mm on the crown: a rod beside it is as far from it as it looks."""
    plan = Plan(SeriesSource(frame_of_reference_uid="1.2"), None)
    plan = plan.add(Trajectory("LH", np.array([20.0, 10, 90]), np.array([5.0, 6, 7]), plan.frame))
    scalp = surface(np.random.default_rng(2)) - CENTER_MM
    at = np.array([0.0, 0.0, HEAD_MM[0] + 20.0])  # the crown points along +z in LPS
    markers = Points(at[None], np.zeros((1, 3, 3)), ("F1",), plan.frame)
    made = Job.of_plan(kr6_r900(), room(), plan, markers, scalp, np.zeros(3), radii_mm=np.array([20.0]))
    placed = made.tasks[1].ends_mm[0]
    out = (placed - CENTER_MM) / np.linalg.norm(placed - CENTER_MM)
    rod = np.array([*(placed + 50.0 * out), *(placed + 90.0 * out), 5.0])
    assert to_head(made.world, rod, np.inf) == pytest.approx(50.0 - 20.0 - 5.0)
    assert made.world.head_ball[3] >= np.linalg.norm(placed - made.world.head_ball[:3]) + 20.0 - 1e-9


@few_or_all("rods", 60, 200)
def test_arm_and_tool_are_never_nearer_to_what_stands_out_of_the_scalp_than_told(rods: int) -> None:
    """Rods on all sides against every voxel of the synthetic head, with its posts, screws and decoys."""
    volume = cases.volume()
    head, rng = Head.of(volume), np.random.default_rng(3)
    plan = Plan(volume.source, None)
    plan = plan.add(Trajectory("LH", cases.ENTRY_MM, cases.TARGET_MM, plan.frame))
    dense = volume.voxels_hu > SKIN_HU
    edge = np.argwhere(dense & ~binary_erosion(dense)).astype(np.float64)
    told_mm, true_mm = [], []
    made = Job.of_plan(kr6_r900(), room(), plan, None, head.boundary_mm, head.center_mm, beside_ct_mm=beside(head))
    voxels_mm = transform_points(made.room_from_ct, volume.grid.positions_mm(edge))
    for out in rng.normal(size=(rods, 3)):
        out /= np.linalg.norm(out)
        start = CENTER_MM + rng.uniform(95.0, 150.0) * out
        end = start + 80.0 * out + rng.normal(scale=30.0, size=3)
        told_mm.append(to_head(made.world, np.array([*start, *end, 5.0]), np.inf))
        along = np.clip((voxels_mm - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
        true_mm.append(np.linalg.norm(voxels_mm - start - along[:, None] * (end - start), axis=1).min() - 5.0)
    over = np.array(told_mm) - true_mm
    assert over.max() <= 0.0
    assert over.min() > -10.0


def test_what_stands_out_of_the_scalp_changes_no_depth_beneath_it() -> None:
    scalp, markers = surface(np.random.default_rng(2)), np.array([[*CENTER_MM, 6.0]])
    alone, among = world_of(room(), scalp, None), world_of(room(), scalp, None, markers, markers + 10.0)
    assert len(among.head) == len(alone.head) + 2
    np.testing.assert_array_equal(among.head[: among.scalp], alone.head[: alone.scalp])
