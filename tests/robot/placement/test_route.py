"""Ways through the tasks: by whichever whole turns of the joints are shortest and free."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.arm.urdf import read_urdf
from ronnaplan.robot.placement.placement import COARSE
from ronnaplan.robot.placement.room import base_pose
from ronnaplan.robot.placement.route import Route, plan_route
from ronnaplan.robot.placement.search import Problem
from ronnaplan.robot.placement.serving import Served
from ronnaplan.robot.placement.world import world_of
from tests.robot.arm.arms import UR5E_M, ur
from tests.robot.placement.cases import job

BASE = base_pose(np.array([-1500.0, -900.0, 900.0, 0.0]))
"""So far from the head that nothing is near the arm but its trolley."""
REFERENCE_DEG = np.array([0.0, -90.0, 90.0, -90.0, -90.0, 0.0])


@cache
def ur5e() -> SerialArm:
    with TemporaryDirectory() as folder:
        (Path(folder) / "arm.urdf").write_text(ur(UR5E_M))
        return read_urdf(Path(folder) / "arm.urdf").arm


@cache
def problem(arm: SerialArm) -> Problem:
    given = job(0, 1, 0, reference_deg=tuple(REFERENCE_DEG.tolist()))
    placed = replace(given.room, boxes=())
    return replace(given, arm=arm, room=placed, world=world_of(placed, given.world.head[:, :3], None)).problem(
        COARSE
    )


def served(name: str, *angles_deg: float, margin_deg: float = 30.0) -> Served:
    way = np.array([angles_deg, np.add(angles_deg, [0.0, 5.0, 0.0, 0.0, 0.0, 0.0])])
    return Served(name, "trajectory", way, margin_deg, 60.0, 40.0, np.inf)


def moved_deg(route: Route) -> float:
    postures = np.array([posture for _, posture in route.corners])
    return float(np.abs(np.diff(postures, axis=0)).max(axis=1).sum())


def routed(given: Problem, *tasks: Served) -> tuple[Route, list[FloatArray]]:
    route, turned = plan_route(given, BASE, tasks, REFERENCE_DEG)
    return route, [one.angles_deg for one in turned]


def test_a_joint_goes_on_through_half_a_turn_within_its_limits() -> None:
    task = [0.0, -90.0, 90.0, -90.0, -90.0]
    route, (one, other) = routed(problem(ur5e()), served("A", *task, 100.0), served("B", *task, -170.0))
    assert route.travel_deg == pytest.approx(100.0 + 90.0 + 190.0)
    assert [name for name, _ in route.corners] == ["the reference posture", *route.order, "the reference posture"]
    assert moved_deg(route) == pytest.approx(route.travel_deg)
    np.testing.assert_allclose(sorted([one[0, 5], other[0, 5]]), [100.0, 190.0])
    assert route.stuck == ()


def test_where_no_straight_way_is_free_it_goes_by_the_reference_posture(monkeypatch: pytest.MonkeyPatch) -> None:
    reference = np.radians(routed(problem(ur5e()))[0].reference_deg)

    def is_at_the_reference(*given: Any) -> bool:
        return any(np.allclose(end[1:], reference[1:]) for end in given[3])

    monkeypatch.setattr("ronnaplan.robot.placement.route.is_free", is_at_the_reference)
    task = [0.0, -90.0, 80.0, -90.0, -90.0]
    route, _ = routed(problem(ur5e()), served("A", *task, 40.0), served("B", *task, -30.0))
    first, second = route.order
    rest = "the reference posture"
    assert route.by_reference == (second,)
    assert [name for name, _ in route.corners] == [rest, first, rest, second, rest]
    assert moved_deg(route) == pytest.approx(route.travel_deg) == pytest.approx(2 * 40.0 + 2 * 30.0)


def test_a_task_that_one_turn_cannot_reach_freely_is_reached_by_another_all_along_its_way() -> None:
    """Joint 4 turned up through 240 degrees would bring the tool through the arm."""
    task = served("A", 0.0, -90.0, 90.0, 150.0, -90.0, 0.0)
    route, turned = plan_route(problem(ur5e()), BASE, [task], REFERENCE_DEG)
    assert (route.order, route.stuck) == (("A",), ())
    np.testing.assert_allclose(turned[0].angles_deg, task.angles_deg - [0, 0, 0, 360, 0, 0])
    assert route.travel_deg == pytest.approx(2 * 120.0)


def test_the_margin_of_a_task_is_that_of_its_turn() -> None:
    reference = np.add(REFERENCE_DEG, [0, 0, 0, 0, 0, 150.0])
    task = served("A", *REFERENCE_DEG[:5].tolist(), -100.0)
    route, (turned,) = plan_route(problem(ur5e()), BASE, [task], reference)
    assert route.travel_deg == pytest.approx(2 * 110.0)
    np.testing.assert_allclose(turned.angles_deg[:, 5], 260.0)
    assert turned.joint_deg == pytest.approx(np.degrees(3.1415) - 90.0, abs=0.01)


def test_no_turn_takes_a_joint_nearer_to_a_limit_than_the_least_of_all_tasks() -> None:
    reference = np.add(REFERENCE_DEG, [0, 0, 0, 0, 0, 150.0])
    task = served("A", *REFERENCE_DEG[:5].tolist(), -150.0, margin_deg=160.0)
    route, (kept,) = plan_route(problem(ur5e()), BASE, [task], reference)
    assert kept is task
    assert route.travel_deg == pytest.approx(2 * 300.0)


def test_joint_1_of_the_reference_is_amid_tasks_on_both_sides_of_half_a_turn() -> None:
    rest = REFERENCE_DEG[1:].tolist()
    tasks = served("A", 163.0, *rest), served("B", -170.0, *rest), served("C", -150.0, *rest)
    route, _ = routed(problem(ur5e()), *tasks)
    assert abs(route.reference_deg[0]) == pytest.approx(170.0)
    assert route.travel_deg == pytest.approx(2 * 47.0)


def test_an_arm_that_cannot_turn_round_has_its_reference_between_its_tasks() -> None:
    rest = [-120.0, 120.0, 0.0, 60.0, 0.0]
    route, _ = routed(problem(kr6_r900()), served("A", 150.0, *rest), served("B", -150.0, *rest))
    assert route.reference_deg[0] == pytest.approx(0.0)
