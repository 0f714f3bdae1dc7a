"""What blocks from every base is told before any is sought, and only what does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.inverse import inverse
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.placement.beforehand import ANYWHERE, beyond_reach, blocked_anywhere, in_the_way
from ronnaplan.robot.placement.blocking import is_parked
from ronnaplan.robot.placement.job import Job
from ronnaplan.robot.placement.placement import COARSE, check_parked, find_places
from ronnaplan.robot.placement.room import Box, Capsule, Floor, base_pose
from ronnaplan.robot.placement.tasks import drill_task, ways_of
from ronnaplan.transforms import invert
from tests.long import few_and_others, few_or_all
from tests.robot.arm import arms
from tests.robot.arm.test_kinematics import read
from tests.robot.placement.cases import CENTER_MM, job, room

TROLLEY = room().floor.trolley
FLOOR = Floor((-900.0, -800.0), (-500.0, -400.0), (850.0, 900.0), (-40.0, 30.0), TROLLEY)
BARE = replace(FLOOR, trolley=())
OUT_MM = np.array([30.0, 30.0, 95.0])


def told(floor: Floor, *things: Box | Capsule) -> str | None:
    boxes, capsules = (tuple(one for one in things if isinstance(one, kind)) for kind in (Box, Capsule))
    given = job(0, 1, 0, floor=floor, boxes=boxes, capsules=capsules)
    return in_the_way(given, given.problem(COARSE), floor, ANYWHERE)


@pytest.fixture
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    def sought(*_: object) -> None:
        raise AssertionError("a base was judged")

    monkeypatch.setattr("ronnaplan.robot.placement.placement.worths", sought)
    monkeypatch.setattr("ronnaplan.robot.placement.placement.serving_most", sought)


@pytest.mark.usefixtures("no_search")
def test_what_blocks_from_every_base_is_told_before_any_is_judged() -> None:
    """It took a search, half a minute of a processor, and was told once for each task."""
    slab = Box("slab", (-850.0, -450.0, 400.0), (300.0, 300.0, 800.0))
    shelf = Box("shelf", (-850.0, -450.0, 1400.0), (900.0, 900.0, 60.0))  # foot: to 1290 mm, shoulder: 1355
    lid = Box("lid", (-850.0, -450.0, 1400.0), (900.0, 900.0, 500.0))
    for floor, thing, expected in (
        (FLOOR, slab, "the trolley would stand nearer than 20 mm to slab for every base on the floor"),
        (BARE, lid, "base would meet lid for every base on the floor; 20 mm are asked for"),
        (BARE, shelf, "shoulder comes within 15 mm of shelf for every base on the floor; 20 mm are asked for"),
    ):
        given = job(1, 2, 1, floor=floor, boxes=(thing,))
        placement = find_places(given)
        assert (placement.places, placement.blocked) == ((), (expected,))


@pytest.mark.usefixtures("no_search")
def test_tasks_that_no_base_of_the_floor_reaches_are_told_before_any_is_judged() -> None:
    given = job(1, 2, 1, floor=replace(BARE, x_mm=(-1900.0, -1500.0)))
    placement = find_places(given)
    rest = "no entry turned by up to 45 degrees about the target works either"
    assert placement.blocked == (
        f"trajectory T0: out of the arm's reach for every base on the floor; {rest}",
        f"trajectory T1: out of the arm's reach for every base on the floor; {rest}",
        "marker M0: out of the arm's reach for every base on the floor",
    )


def test_a_thing_that_one_corner_of_the_floor_keeps_clear_of_is_left_to_the_search() -> None:
    """The trolley is 250 mm to all sides; from the farthest corner, at x = -900, unturned, it ends at -650."""
    straight = replace(FLOOR, turn_deg=(0.0, 0.0))
    # turned it reaches farther: the corner that is unturned decides, to within what a step of the turns moves it
    for floor, gap_mm, is_told in (
        (straight, 19.0, True),
        (FLOOR, 16.0, True),
        (straight, 21, False),
        (FLOOR, 21, False),
    ):
        wall = Box("wall", (gap_mm - 150.0, -450.0, 500.0), (1000.0, 2000.0, 1000.0))
        assert (told(floor, wall) is not None) is is_told
        rail = Capsule("rail", (gap_mm - 590.0, -900.0, 400.0), (gap_mm - 590.0, 200.0, 400.0), 60.0)
        assert (told(floor, rail) is not None) is is_told


@few_or_all("rooms", 30, 60)
def test_what_is_told_of_a_floor_holds_for_bases_drawn_from_it(rooms: int) -> None:
    rng, counts = np.random.default_rng(5), [0, 0]
    for _ in range(rooms):
        center, size = rng.uniform((-1200, -800, 100), (-500, -100, 700)), rng.uniform(100, 900, 3)
        given = job(0, 1, 0, floor=FLOOR, boxes=(Box("thing", tuple(center), tuple(size)),), capsules=())
        problem = given.problem(COARSE)
        x, y, z, turn = (rng.uniform(*ends, 200) for ends in (FLOOR.x_mm, FLOOR.y_mm, FLOOR.z_mm, FLOOR.turn_deg))
        free = is_parked(problem, np.column_stack([x, y, z, turn]))
        is_told = in_the_way(given, problem, FLOOR, ANYWHERE) is not None
        assert not (is_told and free)
        counts[0] += is_told
        counts[1] += not free
    assert counts[0] >= rooms / 6
    assert (
        counts[0] >= 0.8 * counts[1]
    )  # few are left to the search: those that need another of several bases each


ARMS: dict[str, Callable[[Path], SerialArm]] = {
    "KR 6": lambda _: kr6_r900(),
    "UR5e": lambda path: read(arms.ur(arms.UR5E_M), path),
    "calibrated UR5e": lambda path: read(arms.calibrated_ur5e(), path),
    "Panda": lambda path: read(arms.panda(), path).holding("panda_joint7", np.pi / 4),
}


@few_and_others("name", ["KR 6", "calibrated UR5e"], ["UR5e", "Panda"])
def test_a_task_beyond_reach_is_reached_from_no_base_and_one_that_is_reached_is_not_beyond(
    name: str, tmp_path: Path
) -> None:
    """By the arm's postures at bases drawn from the floor, the nearest ones among them."""
    arm = ARMS[name](tmp_path)
    rng, floor, beyond, reached = np.random.default_rng(7), replace(BARE, turn_deg=(-180.0, 180.0)), [], []
    for away in np.linspace(300.0, 2200.0, 39):
        out = np.array([away, 0.3 * away, 100.0])
        target = np.array([-800.0, -400.0, 900.0]) + out
        task = drill_task("T", target - OUT_MM, target, room().tool, 180.0, 2.4)
        ways = ways_of([task], arm, COARSE)
        beyond.append(bool(beyond_reach(arm, ways, floor)[0]))
        bases = rng.uniform((-900, -500, 850, -180), (-800, -400, 900, 180), (40, 4))
        bases[::2, :3] = -800.0, -400.0, 900.0
        flanges = ways.flanges[:, : ways.steps[0]]
        whole = (
            ~np.isnan(
                inverse(arm, (invert(base_pose(base)) @ flanges).reshape(-1, 4, 4)).angles_rad[:, :, 0]
            ).reshape(*flanges.shape[:2], 8)
            for base in bases
        )
        reached.append(bool(any(one.all(axis=1).any() for one in whole)))  # the first that does is enough
    assert not (np.array(beyond) & np.array(reached)).any()
    assert any(reached)
    assert 0 < sum(beyond) <= len(beyond) - sum(reached)
    farthest, first = np.flatnonzero(reached)[-1], np.flatnonzero(beyond)[0]
    assert first - farthest <= (6 if "calibrated" in name else 3)  # 50 mm each


def test_a_trajectory_beside_which_an_entry_is_in_reach_is_left_to_the_search() -> None:
    """As the search proposes it; those that come from beyond the head are told."""
    given, seen = job(0, 1, 0, floor=replace(BARE, x_mm=(-900.0, -900.0)), tracker=None), set()
    for tilt in np.radians(np.arange(0.0, 181.0, 15.0)):
        entry = CENTER_MM + 95.0 * np.array([np.cos(tilt), 0.0, np.sin(tilt)])
        one = replace(given, tasks=(drill_task("T", entry, CENTER_MM, given.room.tool, 180.0, 2.4),))
        problem = one.problem(COARSE)
        (beyond,) = beyond_reach(one.arm, problem.ways, one.room.floor)
        seen.add((bool(beyond), bool(blocked_anywhere(one, problem, COARSE))))
    assert seen == {(False, False), (True, False), (True, True)}


def test_what_stands_where_the_robot_was_parked_is_told_once_and_by_name() -> None:
    """It was told of each task, and of entries that do not work either."""
    given: Job = job(1, 3, 2, floor=FLOOR)
    base: FloatArray = base_pose(np.array([-850.0, -450.0, 860.0, 10.0]))
    cart = Box("cart", (-850.0, -450.0, 200.0), (200.0, 200.0, 200.0))
    blocked = check_parked(job(1, 3, 2, floor=FLOOR, boxes=(*given.room.boxes, cart)), base).blocked
    assert blocked == ("the trolley would stand nearer than 20 mm to cart from here",)
