"""The robot in the scene of a head stands where the placement says, and only where there is one."""

import numpy as np
import pytest

from ronnaplan.case.folder import Case
from ronnaplan.scene.contents import things_of
from ronnaplan.scene.robot import in_room, robot_things
from ronnaplan.scene.shapes import box
from ronnaplan.scene.vtk import Workshop
from tests import cases
from tests.documents.placements import BASE, placed


def test_the_arm_stretched_touches_its_ring_and_stands_on_its_trolley() -> None:
    found = placed()
    in_scan = robot_things(found)
    shown = {one.name: one.body.vertices_mm.astype(float) for one in in_room(found, in_scan)}
    assert set(shown) == {"robot", "robot reach", "robot room", "robot other places"}
    turn = np.radians(BASE[3])
    forward = np.array([np.cos(turn), np.sin(turn), 0.0])
    assert float((shown["robot"] @ forward).max()) > BASE[:3] @ forward + 900.0  # the arm at zero points forwards
    ring = np.linalg.norm(shown["robot reach"][:, :2] - BASE[:2], axis=1)
    assert ring == pytest.approx(25.0 + 455.0 + np.hypot(420.0, 35.0) + 200.0, abs=10.0)
    assert shown["robot reach"][:, 2] == pytest.approx(BASE[2] + 400.0, abs=10.0)
    assert shown["robot"][:, 2].min() == pytest.approx(BASE[2] - 800.0, abs=1.0)
    assert shown["robot other places"].mean(axis=0) == pytest.approx(BASE[:3] + np.array([300.0, 0, 0]), abs=2.0)
    back = {one.name: one.body.vertices_mm for one in in_scan}
    table = back["robot room"].mean(axis=0)
    assert np.linalg.norm(table) > 100.0
    assert not np.allclose(back["robot"].mean(axis=0), shown["robot"].mean(axis=0), atol=50.0)


def test_a_case_shows_the_robot_only_where_it_is_asked_for(workshop: Workshop) -> None:
    case = Case(plan=cases.plan(), placement=placed())
    names = {one.name for one in things_of(workshop, case, robot=True)}
    assert {"robot", "robot reach"} <= names
    assert not any(one.name.startswith("robot") for one in things_of(workshop, case))
    assert robot_things(placed(robot_from_ct=(), status="blocked", blocked=("all",))) == []


def test_a_box_has_its_sides_and_looks_outwards() -> None:
    body = box((10.0, 20.0, 30.0), (4.0, 6.0, 8.0), 90.0)
    assert np.ptp(body.vertices_mm, axis=0) == pytest.approx([6.0, 4.0, 8.0], abs=1e-4)
    a, b, c = (body.vertices_mm[body.triangles[:, n]].astype(float) for n in range(3))
    middle = np.array([10.0, 20.0, 30.0])
    volume = float(np.einsum("ij,ij->i", a - middle, np.cross(b - middle, c - middle)).sum() / 6)
    assert volume == pytest.approx(4 * 6 * 8, rel=1e-4)
