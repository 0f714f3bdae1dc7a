"""The robot in the scene of a head stands where the placement says, and only where there is one."""

import base64
from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.case.folder import Case
from ronnaplan.documents.fiducials import FiducialsDocument, Source
from ronnaplan.documents.placement import HeldEntry, MarkerEntry, PlacementDocument
from ronnaplan.documents.placement_made import placement_document
from ronnaplan.errors import FrameMismatchError
from ronnaplan.planning import Plan
from ronnaplan.report.html import html_of
from ronnaplan.report.overview import View
from ronnaplan.report.placement_part import placement_part
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.placement.placement import Place, Placement
from ronnaplan.robot.placement.room import base_pose
from ronnaplan.robot.placement.route import Route
from ronnaplan.robot.placement.serving import Served
from ronnaplan.scene.contents import things_of
from ronnaplan.scene.robot import in_room, robot_things
from ronnaplan.scene.shapes import box
from ronnaplan.scene.vtk import Workshop
from tests import cases
from tests.robot.placement.cases import room

BASE = np.array([-700.0, -300.0, 900.0, 30.0])
STRETCHED = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
UNDRAWN = View([], b"", b"")
"""Of a report of which no picture is looked at: to draw one takes two seconds."""
NEAR = ("cameras comes within 0 mm of forearm between F6 and F2: the two are only kept from overlapping",)


def document(**changes: object) -> PlacementDocument:
    room_from_ct = np.array([[0.0, 0, -1, 10], [-1, 0, 0, 20], [0, 1, 0, 1050], [0, 0, 0, 1]])
    served = Served("left", "trajectory", np.zeros((2, 6)), 20.0, 30.0, 40.0, np.inf)
    route = Route(("left",), 90.0, (), ("left",), STRETCHED, ())
    places = tuple(
        Place(base_pose(BASE + shift), (served,), route, 0.9, NEAR) for shift in (0.0, [300.0, 0, 0, 0])
    )
    source = Source(**cases.fiducials().source.model_dump())
    found = placement_document(Placement(room_from_ct, places, ()), room(), kr6_r900(), source, cases.plan())
    return found.model_copy(update=changes)


def test_the_arm_stretched_touches_its_ring_and_stands_on_its_trolley() -> None:
    found = document()
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
    case = Case(plan=cases.plan(), placement=document())
    names = {one.name for one in things_of(workshop, case, robot=True)}
    assert {"robot", "robot reach"} <= names
    assert not any(one.name.startswith("robot") for one in things_of(workshop, case))
    assert robot_things(document(robot_from_ct=(), status="blocked", blocked=("all",))) == []


def test_a_placement_of_another_scan_is_refused() -> None:
    other = document(source=Source(frame_of_reference_uid="1.2.3.4", voxel_sha256="0" * 64))
    with pytest.raises(FrameMismatchError, match=r"placement\.json is in frame"):
        Case(plan=cases.plan(), placement=other)


def test_the_report_tells_places_margins_and_what_they_do_not_cover() -> None:
    plan = cases.plan()
    plan = plan.add(replace(plan.trajectory("left"), name="later"))
    part = placement_part(Case(plan=plan, placement=document()))
    told = "".join(html_of(part.body))
    for text in ("place 2", "0.900", "least joint margin", "data:image/png", "joints turn by 90 degrees"):
        assert text in told
    assert part.warnings[:2] == ["the robot has no free way to left", f"on the robot, {NEAR[0]}"]
    assert [one for one in part.warnings if "trajectory" in one] == [
        "nothing says that the robot's place serves trajectory later as it is now; run 'robot place' again"
    ]
    part = placement_part(Case(plan=plan, placement=document()), View([], b"", b"beside the head"))
    assert base64.b64encode(b"beside the head").decode() in "".join(html_of(part.body))
    noted = document(notes=("collisions of base are not looked at",))
    part = placement_part(Case(plan=plan, placement=noted), UNDRAWN)
    assert "the robot's place: collisions of base are not looked at" in part.warnings
    held = document(joints=tuple("abcdef"), held=(HeldEntry(joint="g", angle_deg=12.5),))
    assert (
        "kr6r900, g held at 12.5 degrees; R is its link base, its flange the link flange; coordinates"
        in "".join(html_of(placement_part(Case(plan=plan, placement=held), UNDRAWN).body))
    )
    blocked = document(robot_from_ct=(), status="blocked", blocked=("joint 5 is beyond its limit",))
    part = placement_part(Case(plan=cases.plan(), placement=blocked))
    assert part.warnings == ["no place of the robot serves all: joint 5 is beyond its limit"]
    assert not placement_part(Case(plan=cases.plan())).body


def test_a_trajectory_that_was_changed_since_is_not_said_to_be_served() -> None:
    plan, left = cases.plan(), cases.plan().trajectory("left")
    longer = replace(left.instrument, length_mm=left.instrument.length_mm + 1.0)

    def told(given: Plan, placement: PlacementDocument) -> list[str]:
        warnings = placement_part(Case(plan=given, placement=placement), UNDRAWN).warnings
        return [one for one in warnings if "trajectory" in one]

    sentence = "nothing says that the robot's place serves trajectory left as it is now; run 'robot place' again"
    assert told(plan.edit("left", target_mm=left.target_mm * 1.001), document()) == [sentence]
    assert told(plan.edit("left", entry_mm=left.entry_mm * 0.999), document()) == [sentence]
    assert told(plan.edit("left", instrument=longer), document()) == [sentence]
    assert told(plan, document(trajectories=())) == [sentence]  # as older versions wrote it
    assert told(plan.edit("left", notes="looked at twice"), document()) == []


def test_markers_that_were_found_anew_since_are_not_said_to_be_served() -> None:
    found = cases.fiducials()
    served = document()
    tasks = tuple(
        served.robot_from_ct[0].tasks[0].model_copy(update={"name": one.label, "kind": "marker"})
        for one in found.fiducials
    )
    places = tuple(one.model_copy(update={"tasks": (*one.tasks, *tasks)}) for one in served.robot_from_ct)
    known = document(robot_from_ct=places, markers=tuple(map(MarkerEntry.of, found.fiducials)))

    def told(given: FiducialsDocument, placement: PlacementDocument) -> list[str]:
        seen = Case(plan=cases.plan(), fiducials=given, placement=placement)
        warnings = placement_part(seen, UNDRAWN).warnings
        return [one for one in warnings if "marker" in one]

    first, *rest = found.fiducials
    moved = first.model_copy(update={"center": tuple(value + 0.5 for value in first.center)})
    other = found.model_copy(update={"fiducials": (moved, *rest)})
    sentence = (
        f"nothing says that the robot's place serves marker {first.label} as it is now; run 'robot place' again"
    )
    assert told(found, known) == []
    assert told(other, known) == [sentence]
    assert len(told(found, known.model_copy(update={"markers": ()}))) == len(found.fiducials)  # of older versions
    assert told(other, served) == []  # no marker was to be served


def test_a_box_has_its_sides_and_looks_outwards() -> None:
    body = box((10.0, 20.0, 30.0), (4.0, 6.0, 8.0), 90.0)
    assert np.ptp(body.vertices_mm, axis=0) == pytest.approx([6.0, 4.0, 8.0], abs=1e-4)
    a, b, c = (body.vertices_mm[body.triangles[:, n]].astype(float) for n in range(3))
    middle = np.array([10.0, 20.0, 30.0])
    volume = float(np.einsum("ij,ij->i", a - middle, np.cross(b - middle, c - middle)).sum() / 6)
    assert volume == pytest.approx(4 * 6 * 8, rel=1e-4)
