"""``ronnaplan robot place`` from a plan and a room to a placement, or to what stands in the way."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk

from phantoms.fast import render
from phantoms.output import write_phantom
from phantoms.stack import axial_stack
from ronnaplan.case.placed import placement_doubts
from ronnaplan.cli import main
from ronnaplan.ct import read_ct
from ronnaplan.documents.placement import read_placement
from ronnaplan.documents.room import read_room
from ronnaplan.documents.room_example import EXAMPLE
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.inverse import inverse
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.placement.room import Room, base_place
from ronnaplan.robot.placement.world import World, world_of
from ronnaplan.transforms import cross_matrix
from tests import cases
from tests.cli.chains import parked_chain
from tests.documents.test_room import with_arm_body
from tests.long import few_and_others
from tests.planning.heads import layered_head
from tests.robot.arm.arms import KR6, UR5E_M, UR10E_M, iiwa, ur

POINTS = ["--entry", "-20", "10", "77", "--target", "-10", "5", "20", "--coordinates", "LPS"]
NARROW = {
    "x = [-1100, 700]": "x = [-800, -700]",
    "y = [-1100, 1100]": "y = [-600, -500]",
    "[800, 1000]": "[900, 900]",
}
HEAD_MM = np.array([0.0, 0.0, 1050.0])
"""Where the example puts the head's middle in the room."""


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the arguments that name plan, scan and room."""
    folder = tmp_path_factory.mktemp("case")
    stack = axial_stack(start_mm=-20, stop_mm=90, spacing_mm=2.0, matrix=128, field_of_view_mm=190.0)
    write_phantom(folder / "ct", layered_head(), stack, render(layered_head(), stack, seed=1))
    plan, room = folder / "plan.json", folder / "room.toml"
    text = EXAMPLE
    for old, new in NARROW.items():
        assert old in text
        text = text.replace(old, new)
    room.write_text(text)
    assert main(["plan", "new", str(folder / "ct"), "-o", str(plan)]) == 0
    assert main(["plan", "add", str(plan), "LH", "--ct", str(folder / "ct"), *POINTS]) == 0
    return ["robot", "place", "--plan", str(plan), "--ct", str(folder / "ct"), "--scene", str(room)]


def test_a_place_is_found_and_checked_after_parking(
    case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "placement.json"
    assert main([*case, "-o", str(output)]) == 0
    assert "serves all after parking with probability" in capsys.readouterr().err
    found = read_placement(output)
    assert found.status == "placed"
    assert [(one.name, one.length_mm) for one in found.trajectories] == [("LH", 200.0)]
    assert found.markers == ()
    pose = np.array(found.robot_from_ct[0].room_from_r)
    turn = np.degrees(np.arctan2(pose[1, 0], pose[0, 0]))
    parked = [f"{value:.3f}" for value in (*pose[:3, 3], turn)]
    assert main([*case, "--parked", *parked, "-o", str(output)]) == 0
    again = read_placement(output)
    assert (again.status, again.revision, again.robot_from_ct[0].probability) == ("parked", 1, None)
    chain = parked_chain(found.source.model_dump(), found.robot_from_ct[0].r_from_ct)
    chain["notes"] = ["readings without a partner: 2"] * 2  # as a registration's, which the case tells, too
    (tmp_path / "chain.json").write_text(json.dumps(chain))
    assert main([*case, "--chain", str(tmp_path / "chain.json"), "-o", str(output)]) == 0
    measured = read_placement(output)
    assert measured.status == "parked"
    unviewed, other = measured.notes
    assert unviewed.startswith("no markers are named, so that no view of any is looked for; give --fiducials")
    assert other == "readings without a partner: 2"
    np.testing.assert_allclose(measured.robot_from_ct[0].room_from_r, pose, atol=1e-6)
    r_from_room = np.linalg.inv(pose)
    head_mm = r_from_room[:3, :3] @ HEAD_MM + r_from_room[:3, 3]
    off_mm = 0.02 * np.linalg.norm(head_mm)
    for about_mm in (np.zeros(3), head_mm):  # so that the head errs, and so that the base does
        moved = np.vstack([0.02 * np.eye(3), 0.02 * cross_matrix(about_mm)])
        covariance = (moved @ moved.T + 1e-6 * np.eye(6)).tolist()
        coarse = {**chain, "robot_from_ct": {**chain["robot_from_ct"], "covariance": covariance}}
        (tmp_path / "chain.json").write_text(json.dumps(coarse))
        assert main([*case, "--chain", str(tmp_path / "chain.json"), "-o", str(output)]) == 0
        told = f"head and base were measured against each other with a standard error of {off_mm:.1f} mm along the wor"
        assert told in read_placement(output).notes[-1]
    turned = np.diag([1.0, -1, -1, 1]) @ np.array(found.robot_from_ct[0].r_from_ct)
    chain["robot_from_ct"]["matrix"] = turned.tolist()
    (tmp_path / "chain.json").write_text(json.dumps(chain))
    assert main([*case, "--chain", str(tmp_path / "chain.json"), "-o", str(output)]) == 1
    assert "the robot's base is tilted by 180 degrees" in capsys.readouterr().err
    in_m = np.array(found.robot_from_ct[0].r_from_ct)
    in_m[:3, 3] /= 1000
    chain["robot_from_ct"]["matrix"] = in_m.tolist()
    (tmp_path / "chain.json").write_text(json.dumps(chain))
    assert main([*case, "--chain", str(tmp_path / "chain.json"), "-o", str(output)]) == 1
    assert (
        "mm from the robot's, as if it were in m; expected mm" in capsys.readouterr().err
    )  # not what blocks there
    chain["source"]["frame_of_reference_uid"] = "1.2.3"
    (tmp_path / "chain.json").write_text(json.dumps(chain))
    assert main([*case, "--chain", str(tmp_path / "chain.json"), "-o", str(output)]) == 1
    assert "1.2.3" in capsys.readouterr().err


@pytest.fixture(scope="module")
def parked(case: list[str], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return plan, chain, and the placement at the base that it measured, with a tool turned in its flange."""
    folder = tmp_path_factory.mktemp("parked")
    files = {name: folder / f"{name}.json" for name in ("chain", "placement")}
    files["room"] = folder / "room.toml"
    files["plan"] = Path(case[case.index("--plan") + 1])
    shown = "# x_axis = [1, 0, 0] "
    files["room"].write_text(Path(case[-1]).read_text().replace(shown, "x_axis = [3, -4, 0] "))
    assert "x_axis = [3, -4, 0] " in files["room"].read_text()
    command = [*case[:-1], str(files["room"]), "-o", str(files["placement"])]
    assert main([*command, "--parked", "-800", "-600", "900", "61"]) == 0
    found = read_placement(files["placement"])
    chain = parked_chain(found.source.model_dump(), found.robot_from_ct[0].r_from_ct)
    files["chain"].write_text(json.dumps(chain))
    assert main([*command, "--chain", str(files["chain"])]) == 0
    return files


def export(parked: dict[str, Path], *options: str, **others: Path) -> int:
    files = {**parked, **others}
    asked = ["robot", "export", str(files["chain"]), str(files["plan"])]
    return main([*asked, "--placement", str(files["placement"]), *options])


def test_what_is_exported_by_a_placement_brings_the_arm_into_its_posture(
    parked: dict[str, Path], tmp_path: Path
) -> None:
    """The flange that the exported tool asks for, in closed form, and only with the roll that was looked at."""
    out = tmp_path / "points.json"
    assert export(parked, "-o", str(out)) == 0
    (served,) = read_placement(parked["placement"]).robot_from_ct[0].tasks
    (path,) = json.loads(out.read_text())["trajectories"]
    flange_from_tip = np.eye(4)
    flange_from_tip[:3, :3] = [[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]
    flange_from_tip[2, 3] = 120.0 + 200.0  # the holder's and the instrument's, of the room and the plan
    tips = np.array([path["approach"], path["target"]["robot_from_tool"]["matrix"]])
    angles = np.degrees(inverse(kr6_r900(), tips @ np.linalg.inv(flange_from_tip)).angles_rad)
    expected = np.array([served.joints_deg[0], served.joints_deg[-1]])
    apart = np.abs((angles - expected[:, None] + 180.0) % 360.0 - 180.0).max(axis=-1)
    assert np.nanmin(apart, axis=1) == pytest.approx([0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        (("status",), "placed", "the placement is placed; expected one from where the robot was parked"),
        (("source", "frame_of_reference_uid"), "1.2.3", "1.2.3"),
        (("robot_from_ct", 0, "r_from_ct", 0, 3), 1.0, "the placement has the scan elsewhere in R than the chain"),
        (("trajectories", 0, "length_mm"), 150.0, "the placement does not serve LH as planned now"),
        (("robot_from_ct", 0, "route", "stuck"), ["LH"], "has no free way from the reference posture to LH"),
        (("robot_from_ct", 0, "tasks", 0, "x_axis"), None, "state x_axis in [tool] of the room"),
        (("robot_from_ct", 0, "tasks", 0, "x_axis"), [0.0, 0.0, 1.0], "is not perpendicular to its trajectory"),
        (("robot_from_ct", 0, "tasks", 0, "name"), "RH", "has an x_axis, but is none of the trajectories"),
    ],
)
def test_rolls_of_another_placement_are_refused(
    parked: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    place: tuple[str | int, ...],
    value: object,
    told: str,
) -> None:
    written = json.loads(parked["placement"].read_text())
    within = written
    for key in place[:-1]:
        within = within[key]
    within[place[-1]] = value
    (tmp_path / "placement.json").write_text(json.dumps(written))
    assert export(parked, placement=tmp_path / "placement.json") == 1
    assert told in capsys.readouterr().err


def test_an_export_by_a_placement_begins_no_further_out_than_that_looked(
    parked: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(parked, "--approach", "30") == 0
    assert export(parked, "--approach", "30.5") == 1
    assert "--approach 30.5 lies further out than" in capsys.readouterr().err
    assert export(parked, "--x-axis", "0", "1", "0") == 2
    assert "not allowed with argument" in capsys.readouterr().err


def test_what_stands_in_the_way_is_written_and_refused(
    case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "placement.json"
    assert main([*case, "--parked", "3000", "0", "900", "0", "-o", str(output)]) == 3
    assert "trajectory LH: out of the arm's reach from here" in capsys.readouterr().err
    assert read_placement(output).status == "blocked"


def test_a_place_from_where_the_way_is_not_free_is_written_and_refused(
    case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An arm whose reference posture lies within what stands about gets nowhere; it is told what it meets there."""
    room, output = tmp_path / "room.toml", tmp_path / "placement.json"
    text = Path(case[-1]).read_text()
    assert "reference_deg = [0, -120, 120, 0, 60, 0]" in text
    room.write_text(text.replace("[0, -120, 120, 0, 60, 0]", "[0, 40, 120, 0, 60, 0]"))
    asked, place = [*case[:-1], str(room), "-o", str(output)], list[str]()
    for status in ("placed", "parked"):
        assert main([*asked, *place]) == 3
        told = capsys.readouterr().err
        found = read_placement(output)
        best = found.robot_from_ct[0]
        assert (found.status, best.route.stuck) == (status, ("LH",))
        assert best.at_reference == "forearm would meet base in the reference posture; 20 mm are asked for"
        assert f"the robot has no free way to any task: {best.at_reference}; state another reference_deg" in told
        assert told.count("no free way") == 2  # of the place, and why it is refused
        assert not [word for word in ("probability", "order", "between the reference posture and") if word in told]
        doubts = placement_doubts(found, (), None)
        assert [one for one in doubts if "free" in one] == [
            f"the robot has no free way to any task: {best.at_reference}"
        ]
        place = ["--parked", *map(str, base_place(np.array(best.room_from_r)))]


def test_a_task_that_no_free_way_leads_to_is_told_by_name(
    case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def leads_nowhere(*given: Any) -> bool:
        return bool((given[3][0] == given[3][1]).all())

    monkeypatch.setattr("ronnaplan.robot.placement.route.is_free", leads_nowhere)
    output = tmp_path / "placement.json"
    assert main([*case, "-o", str(output)]) == 3
    told = capsys.readouterr().err
    assert "the robot has no free way from the reference posture to LH; state another reference_deg" in told
    assert read_placement(output).robot_from_ct[0].at_reference is None


@pytest.mark.parametrize(
    "parked", [["-1072", "-117", "833", "1e17"], ["-1072", "1.1e5", "833", "0"], ["0", "0", "800", "-361"]]
)
def test_a_base_that_no_room_holds_is_wrong_usage(
    parked: list[str], case: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*case, "--parked", *parked]) == 2
    assert "expected up to 100000 mm and 360 degrees either way" in capsys.readouterr().err


def test_a_base_in_metres_is_refused_by_where_its_trolley_would_end(
    case: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """It was out of reach, and another entry was proposed in its place."""
    assert main([*case, "--parked", "-1.095", "-0.1", "0.806", "31"]) == 1
    told = "trolley would end 799 mm beneath the floor with the base at z = 0.806; expected z"
    assert told in capsys.readouterr().err


def test_a_chain_of_another_scan_is_refused_also_where_no_frame_of_reference_tells_it(
    case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of NIfTI; by the voxels, which every document holds."""
    scan, plan, chain = tmp_path / "scan.nii", tmp_path / "plan.json", tmp_path / "chain.json"
    sitk.WriteImage(read_ct(case[case.index("--ct") + 1]).to_sitk(), scan)
    assert main(["plan", "new", str(scan), "-o", str(plan)]) == 0
    assert main(["plan", "add", str(plan), "LH", "--ct", str(scan), *POINTS]) == 0
    asked = ["robot", "place", "--plan", str(plan), "--ct", str(scan), *case[case.index("--scene") :]]
    asked += ["--chain", str(chain), "-o", str(tmp_path / "placement.json")]
    for voxels, told in (
        (read_ct(scan).voxel_sha256, "the robot's base is tilted"),
        ("0" * 64, "their voxels differ"),
    ):
        chain.write_text(json.dumps(parked_chain({"voxel_sha256": voxels}, np.eye(4))))
        assert main(asked) == 1
        assert told in capsys.readouterr().err


def test_what_documents_tell_of_the_markers_is_taken_and_what_they_do_not_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their sizes, that they were found anew since they were registered, and what else stands out of the scalp."""
    balls = []

    def spied(
        room: Room,
        head_mm: FloatArray,
        tracker_mm: FloatArray | None,
        markers_mm: FloatArray,
        beside_mm: FloatArray,
    ) -> World:
        balls.append((markers_mm, beside_mm))
        return world_of(room, head_mm, tracker_mm, markers_mm, beside_mm)

    def told(*names: str) -> str:
        documents = [f"--{name}={tmp_path / name}.json" for name in ("plan", "registration", *names)]
        scene = [f"--scene={tmp_path / 'room.toml'}", "-o", str(tmp_path / "placement.json")]
        out_of_reach = ["--parked", "90000", "0", "800", "0"]  # what is told of the documents comes before
        assert main(["robot", "place", "--ct", str(cases.CT), *documents, *scene, *out_of_reach]) == 3
        return capsys.readouterr().err

    monkeypatch.setattr("ronnaplan.robot.placement.job.world_of", spied)
    cases.write_case(tmp_path)
    (tmp_path / "room.toml").write_text(EXAMPLE)
    anew = "warning: the registration has marker F1 at another place; register again"
    usual = "the markers are, so that they count as balls of 12 mm; give --fiducials"
    with_fiducials = told("fiducials")
    assert anew not in with_fiducials
    assert usual not in with_fiducials
    ((markers_mm, beside_mm),) = balls
    assert len(beside_mm) > 1000
    found = json.loads((tmp_path / "fiducials.json").read_text())
    assert markers_mm[:, 3] == pytest.approx([one["diameter_mm"] / 2 for one in found["fiducials"]])
    assert usual in told()  # the registration has their places only
    found["fiducials"][0]["center"][0] += 3.0
    (tmp_path / "fiducials.json").write_text(json.dumps(found))
    assert anew in told("fiducials")
    kept = {one.label: list(one.center) for one in read_placement(tmp_path / "placement.json").markers}
    assert kept == {one["label"]: one["center"] for one in found["fiducials"]}  # that the report can tell it, too


def test_what_is_missing_is_named(case: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "place", "--example"]) == 0
    assert capsys.readouterr().out == EXAMPLE
    assert main(case[:-2]) == 2
    assert "robot place needs --scene" in capsys.readouterr().err
    assert main([*case, "--arm", "nowhere.urdf"]) == 1
    assert (
        "nowhere.urdf cannot be read: there is no such file; expected a URDF file, or kr6r900"
        in capsys.readouterr().err
    )
    for asked in (case, ["robot", "place", "--example"]):
        assert main([*asked, "--tip", "tool0"]) == 2
        assert "--tip is a link of a URDF file" in capsys.readouterr().err
    assert main(["robot", "place", "--example", "--hold", "A1=0"]) == 1
    assert "kr6r900 has 5 joints" in capsys.readouterr().err


def test_a_base_that_stands_apart_from_the_root_is_told_until_one_of_both_is_named(
    case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of UR's robots, whose controllers report poses half a turn from the root of their description."""
    arm, output = tmp_path / "arm.urdf", str(tmp_path / "placement.json")
    link = '<link name="base"/><joint name="r" type="fixed"><origin rpy="0 0 3.1415926"/>'
    link += '<parent link="foot"/><child link="base"/></joint></robot>'
    arm.write_text(KR6.replace('"base"', '"foot"').replace("</robot>", link))
    far = ["--arm", str(arm), "--parked", "3000", "0", "900", "0", "-o", output]
    told = []
    for base in ([], ["--base", "base"], ["--base", "foot"]):
        assert main([*case, *far, *base]) == 3
        told.append(any("its link base stands elsewhere" in note for note in read_placement(output).notes))
    assert told == [True, False, False]
    capsys.readouterr()
    assert main([*case, "--base", "base"]) == 2
    assert "--base is a link of a URDF file" in capsys.readouterr().err


def test_the_example_for_an_arm_of_meshes_asks_for_the_radius_of_each_link(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All but a few published descriptions have meshes only, and were refused until somebody had drawn every link."""
    arm, room = tmp_path / "arm.urdf", tmp_path / "room.toml"
    ask = ["robot", "place", "--example", "--arm", str(arm)]
    arm.write_text(iiwa().replace('<cylinder length="0.12" radius="0.08"/>', '<mesh filename="x.stl"/>'))
    assert main(ask) == 1
    assert "has 7 joints, a closed form needs six; hold one where it shall stay" in capsys.readouterr().err
    assert main([*ask, "--hold", "joint_a3=0"]) == 0
    text = capsys.readouterr().out
    room.write_text(text)
    with pytest.raises(InputError, match=r"arm_body.0.radius: Input should be greater than 0"):
        read_room(room)
    room.write_text(text.replace("radius = 0 ", "radius = 75 "))
    read = read_room(room)
    bodies = [(link, one.name, one.end_mm) for link, one in read.arm_bodies]
    assert bodies[0] == (0, "foot to joint_a1", (0, 0, 180))
    assert bodies[7] == (7, "joint_a7 to flange", (0, 0, 126))
    assert [link for link, _, _ in bodies] == list(range(8))
    assert read.reference_deg[0] == 0
    assert abs(read.reference_deg[2]) > 30  # the elbow
    assert "of joint_a1, joint_a2, joint_a4, joint_a5, joint_a6, joint_a7." in text
    arm.write_text(KR6.replace('<mesh filename="base.stl"/>', '<sphere radius="0.1"/>'))
    assert main(ask) == 0
    room.write_text(capsys.readouterr().out)
    assert not read_room(room).arm_bodies
    assert read_room(room).reference_deg == (0, -92, 113, 0, 39, 0)


@few_and_others("lengths_m", [UR5E_M], [UR10E_M])
def test_the_example_for_another_arm_has_a_posture_that_it_can_go_by(
    lengths_m: tuple[float, ...], case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The middles of a UR's limits are zeros, where it lies stretched: no way led from there, which took a search."""
    arm, room, output = tmp_path / "arm.urdf", tmp_path / "room.toml", tmp_path / "placement.json"
    arm.write_text(ur(lengths_m))
    assert main(["robot", "place", "--example", "--arm", str(arm)]) == 0
    room.write_text(capsys.readouterr().out)
    there = ["--arm", str(arm), "--parked", "-820", "-300", "880", "40", "-o", str(output)]
    assert main([*case[:-1], str(room), *there]) == 0
    route = read_placement(output).robot_from_ct[0].route
    assert (route.order, route.stuck) == (("LH",), ())


def test_a_flange_that_nobody_named_is_told_and_one_whose_z_points_elsewhere(
    case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of a Meca500, whose last link has x out of the flange, and of grippers whose jaw is the last that turns."""
    arm, room, output = tmp_path / "arm.urdf", tmp_path / "room.toml", str(tmp_path / "placement.json")
    end = KR6.index('<joint name="flange"')
    bare = KR6[:end].replace('<link name="tool0"/><link name="camera"/>', "") + "</robot>"
    arm.write_text(bare)
    far = ["--arm", str(arm), "--parked", "3000", "0", "900", "0", "-o", output]
    assert main([*case, *far]) == 3
    taken, aside = (
        next(note for note in read_placement(output).notes if told in note) for told in ("taken", "about")
    )
    assert taken.startswith(
        "no link is called tool0, so that the flange is taken to be l6, the last that turns; name"
    )
    assert aside.startswith(
        "A6 does not turn about z of the flange l6 but about its x, and the tool of the scene poi"
    )
    assert main([*case, *far, "--tip", "l6"]) == 3
    assert [note for note in read_placement(output).notes if "flange" in note] == [aside]
    text = Path(case[-1]).read_text()
    assert "direction = [0, 0, 1]\nstandoff_mm" in text
    room.write_text(text.replace("direction = [0, 0, 1]\nstandoff_mm", "direction = [1, 0, 0.5]\nstandoff_mm"))
    assert main([*case[:-1], str(room), *far, "--tip", "l6"]) == 3
    assert not [note for note in read_placement(output).notes if "flange" in note]
    grip = '<joint name="grip" type="continuous"><parent link="l6"/><child link="jaw"/></joint>'
    arm.write_text(bare.replace("</robot>", f'<link name="jaw"/>{grip}</robot>'))
    capsys.readouterr()
    assert main([*case, *far]) == 1
    told = capsys.readouterr().err
    assert "taken to be jaw" in told
    assert "has 7 joints" in told


def test_ends_that_are_not_in_the_head_are_refused_and_what_makes_them_doubtful_is_told(
    case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of a plan that another program wrote: a target 0.3 m beside the head was given a place."""
    plan, output = tmp_path / "plan.json", tmp_path / "placement.json"
    written = json.loads(Path(case[3]).read_text())
    far = ["--parked", "3000", "0", "900", "0", "-o", str(output)]

    def asked(**changes: object) -> int:
        plan.write_text(
            json.dumps({**written, "trajectories": [{**one, **changes} for one in written["trajectories"]]})
        )
        return main([*case[:3], str(plan), *case[4:], *far])

    assert asked(entry=[300.0, 10.0, 77.0], target=[310.0, 5.0, 20.0]) == 1
    assert "the entry of LH at LPS (300.0, 10.0, 77.0) lies outside the scan" in capsys.readouterr().err
    (only,) = written["trajectories"]
    assert asked(entry=only["target"], target=[*only["entry"][:2], 88.0]) == 1
    assert "choose a place in the head" in capsys.readouterr().err
    assert not output.exists()
    assert asked(name="left", entry=[-14.0, 7.0, 45.0], target=[-12.0, 5.0, 20.0]) == 3
    deep, side, *_ = read_placement(output).notes
    assert deep.startswith("left: the entry lies ")
    assert side.startswith("left: it is named left but lies on the patient's right side")


def test_links_of_meshes_are_named_unless_the_room_states_bodies(
    case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm, room, output = tmp_path / "arm.urdf", tmp_path / "room.toml", str(tmp_path / "placement.json")
    arm.write_text(KR6)
    far = ["--arm", str(arm), "--parked", "3000", "0", "900", "0", "-o", output]
    assert main([*case, *far]) == 3
    assert "collisions of base are not or not wholly looked at" in capsys.readouterr().err
    notes = read_placement(output).notes  # who reads the clearances later has to know
    assert any(note.startswith("collisions of base are not") for note in notes)
    one = with_arm_body(EXAMPLE)
    body = one[one.index("[[arm_body]]") : one.index("[camera]")]
    small = body.replace("[455, 0, 0]", "[9, 0, 0]").replace("radius = 95", "radius = 5")
    others = [small.replace("link = 2", f"link = {n}").replace("upper arm", f"part {n}") for n in (0, 1, 3, 4, 5)]
    every = one.replace(body, "\n".join([body, *others]))
    for arm_named in (far, far[2:]):  # of its file, and built in
        room.write_text(one)
        assert main([*case[:-1], str(room), *arm_named]) == 3
        assert "none of link 0, 1, 3, 4, 5: collisions of these are not looked at" in capsys.readouterr().err
        room.write_text(every)
        assert main([*case[:-1], str(room), *arm_named]) == 3
        assert "collisions of" not in capsys.readouterr().err


def test_an_arm_of_seven_joints_is_served_with_one_held_and_refused_with_the_way_out_otherwise(
    case: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm, room, output = tmp_path / "arm.urdf", tmp_path / "room.toml", tmp_path / "placement.json"
    arm.write_text(iiwa())
    room.write_text(
        EXAMPLE.replace("reference_deg = [0, -120, 120, 0, 60, 0]", "reference_deg = [0, -30, 90, 0, 60, 0]")
    )
    there = [*case[:-1], str(room), "--arm", str(arm), "--parked", "-700", "-500", "900", "60", "-o", str(output)]
    assert main(there) == 1
    assert (
        "has 7 joints, a closed form needs six; hold one where it shall stay (--hold joint_a3=0 or --hold joint_a7=0)"
        in (capsys.readouterr().err)
    )
    assert main([*there, "--hold", "joint_a3=0"]) == 0
    assert "iiwa, joint_a3 held at 0 degrees" in capsys.readouterr().err
    found = read_placement(output)
    assert found.joints == ("joint_a1", "joint_a2", "joint_a4", "joint_a5", "joint_a6", "joint_a7")
    assert [(one.joint, one.angle_deg) for one in found.held] == [("joint_a3", 0.0)]
    assert main([*there, "--hold", "joint_a3=171"]) == 1
    assert "joint_a3 of iiwa cannot be held at 171 degrees; expected -170 to 170" in capsys.readouterr().err
    assert main([*there, "--hold", "joint_a3=0", "--hold", "joint_a3=1"]) == 1
    assert "turns no joint 'joint_a3'" in capsys.readouterr().err


@pytest.mark.parametrize("held", ["joint_a3", "=3", "joint_a3=", "joint_a3=1,5", "joint_a3=nan"])
def test_what_names_no_joint_and_angle_is_wrong_usage(
    held: str, case: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*case, "--hold", held]) == 2
    assert "expected a joint of the arm and degrees, as joint_3=0" in capsys.readouterr().err
