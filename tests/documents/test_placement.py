"""placement.json of an arm of which a joint is held; and that nothing else is written where none is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.placement import PlacementDocument, placement_text, read_placement
from ronnaplan.documents.placement_made import placement_document
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import InputError
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import link_frames
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.arm.urdf import read_urdf
from ronnaplan.robot.placement.placement import Place, Placement
from ronnaplan.robot.placement.room import Capsule, base_pose
from ronnaplan.robot.placement.route import Route
from ronnaplan.robot.placement.serving import Served
from ronnaplan.transforms import transform_points
from tests.robot.arm.arms import IIWA_M, KR6, UR5E_M, iiwa, ur
from tests.robot.arm.test_kinematics import read
from tests.robot.placement.cases import room

BASE = base_pose(np.array([-700.0, -300.0, 900.0, 30.0]))
REFERENCE_DEG = np.array([10.0, -30.0, 90.0, 20.0, 60.0, 40.0])


def document(arm: SerialArm, *bodies: tuple[int, Capsule], near: tuple[str, ...] = ()) -> PlacementDocument:
    """Return the document of ``arm`` at `BASE`, in the posture `REFERENCE_DEG`."""
    served = Served("left", "trajectory", np.zeros((2, 6)), 20.0, 30.0, 40.0, np.inf)
    place = Place(BASE, (served,), Route(("left",), 90.0, (), (), REFERENCE_DEG, ()), 0.9, near, None)
    there = room(reference_deg=tuple(REFERENCE_DEG.tolist()), arm_bodies=bodies)
    return placement_document(Placement(np.eye(4), (place,), ()), there, arm, Source())


def test_angles_stand_with_the_joints_that_they_are_of_and_those_that_are_held(tmp_path: Path) -> None:
    arm = read(iiwa(), tmp_path).holding("joint_a3", 0.0)
    text = to_json(document(arm))
    written = json.loads(text)
    assert written["joints"] == [f"joint_a{n}" for n in (1, 2, 4, 5, 6, 7)]
    assert written["held"] == [{"joint": "joint_a3", "angle_deg": 0.0}]
    (tmp_path / "placement.json").write_text(text)
    found = read_placement(tmp_path / "placement.json")
    assert to_json(found) == text
    assert placement_text(found).splitlines()[0] == (
        "iiwa, joint_a3 held at 0 degrees; R is its link l0, its flange the link tool0"
    )
    for missing in ("joints", "held"):
        (tmp_path / "placement.json").write_text(
            json.dumps({**written, missing: None if missing == "joints" else []})
        )
        with pytest.raises(InputError, match="joints that turn and joints that are held do not stand together"):
            read_placement(tmp_path / "placement.json")
    written["held"][0]["joint"] = "joint_a4"
    (tmp_path / "placement.json").write_text(json.dumps(written))
    with pytest.raises(InputError, match="two joints have the same name"):
        read_placement(tmp_path / "placement.json")


def test_where_nothing_is_held_what_is_written_is_as_it_was(tmp_path: Path) -> None:
    found = document(kr6_r900())
    written = json.loads(to_json(found))
    assert not {"joints", "held"} & set(written)
    (tmp_path / "placement.json").write_text(json.dumps(written))
    assert read_placement(tmp_path / "placement.json") == found
    assert placement_text(found).splitlines()[1].startswith("place 1: ")


def test_the_links_that_the_poses_are_of_are_told_and_files_without_them_are_read(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(KR6)
    arm = read_urdf(tmp_path / "arm.urdf", tip="camera", base="l1").arm
    assert (arm.base_link, arm.flange_link) == ("l1", "camera")
    content = json.loads(to_json(document(replace(kr6_r900(), base_link="l1", flange_link="camera"))))
    assert (content["arm"], content["links"]) == ("kr6r900", {"base": "l1", "flange": "camera"})
    told = []
    for links in (content, {name: value for name, value in content.items() if name != "links"}):
        (tmp_path / "placement.json").write_text(json.dumps(links))
        told.append(placement_text(read_placement(tmp_path / "placement.json")).splitlines()[0])
    assert told == ["kr6r900; R is its link l1, its flange the link camera", "kr6r900"]


def test_a_held_arm_is_drawn_as_the_whole_arm_stands_with_that_joint_at_its_angle(tmp_path: Path) -> None:
    """The capsules of its file, and those that the room tells, which count its links as before."""
    whole = read(iiwa(), tmp_path)
    frames = BASE @ link_frames(whole, np.radians(np.insert(REFERENCE_DEG, 2, 0.0)))
    held = whole.holding("joint_a3", 0.0)
    of_file = [(one.link, one.start_mm, one.end_mm) for one in whole.bodies]
    told = [(link, Capsule(f"c{link}", (10.0 * link, 0.0, 5.0), (0.0, 20.0, 50.0), 30.0)) for link in range(8)]
    of_room = [(link, np.array(one.start_mm), np.array(one.end_mm)) for link, one in told]
    for found, expected in ((document(held), of_file), (document(held, *told), of_room)):
        robot = found.robot_from_ct[0].robot
        assert robot is not None
        assert len(robot.bodies) == len(expected) + len(room().tool.bodies)
        for drawn, (link, start_mm, end_mm) in zip(robot.bodies, expected, strict=False):
            places = transform_points(frames[link], np.stack([start_mm, end_mm]))
            np.testing.assert_allclose([drawn.start, drawn.end], places, atol=1e-9)


def test_the_ring_lies_about_axis_2_and_as_far_as_the_arm_reaches(tmp_path: Path) -> None:
    tool_mm = room().tool.start_mm[2]
    foot, upper, fore, end = (1000.0 * length for length in IIWA_M)
    robot = document(read(iiwa(), tmp_path).holding("joint_a3", 0.0)).robot_from_ct[0].robot
    assert robot is not None
    assert robot.shoulder == pytest.approx((-700.0, -300.0, 900.0 + foot))
    assert robot.reach == pytest.approx(upper + fore + end + tool_mm)
    foot, upper, fore, side, wrist, end = (1000.0 * length for length in UR5E_M)
    robot = document(read(ur(UR5E_M), tmp_path)).robot_from_ct[0].robot
    assert robot is not None
    assert robot.shoulder == pytest.approx((-700.0, -300.0, 900.0 + foot))
    assert robot.reach == pytest.approx(np.hypot(upper + fore + wrist, side) + end + tool_mm)


def test_what_comes_near_on_the_robot_is_written_and_told_and_only_there(tmp_path: Path) -> None:
    near = ("cameras comes within 8 mm of forearm on the way of left: the two are only kept from overlapping",)
    text = to_json(document(kr6_r900(), near=near))
    (tmp_path / "placement.json").write_text(text)
    found = read_placement(tmp_path / "placement.json")
    assert found.robot_from_ct[0].near == near
    assert to_json(found) == text
    assert placement_text(found).splitlines()[-1] == f"  {near[0]}"
    assert "near" not in json.loads(to_json(document(kr6_r900())))["robot_from_ct"][0]
