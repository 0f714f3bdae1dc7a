"""From recordings to points in the robot's coordinates, as the page on the robot prints it."""

from __future__ import annotations

import csv
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image
from scipy.spatial.transform import Rotation

from phantoms.robot_session import write_session
from ronnaplan.cli import main
from ronnaplan.documents.krl import krl_angles
from ronnaplan.documents.plan import write_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.documents.registration_made import registration_document
from ronnaplan.documents.rig import read_rig
from ronnaplan.documents.template import read_template_document
from ronnaplan.documents.tool import read_hand_eye, read_pivot
from ronnaplan.errors import InputError, RefusedError
from ronnaplan.registration.marker_registration import register_markers
from ronnaplan.robot.hand_eye import calibrate_hand_eye, with_tip
from ronnaplan.robot.pivot import calibrate_pivot
from ronnaplan.robot.stereo.calibration import require_size
from ronnaplan.robot.stereo.images import read_pairs
from ronnaplan.robot.stereo.markers import in_rig
from ronnaplan.tracking import find_markers, read_recording
from tests import cases
from tests.robot.misreadings import MISREAD, misread
from tests.robot.stereo.boards import find_once
from tests.robot.test_pivot import recording

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "robot.md").read_text(encoding="utf-8")
CASE = ROOT / "data" / "synthetic_ct"


def commands() -> list[list[str]]:
    tutorial = PAGE.split("## From recordings")[1].split("\n## ")[0]
    block = "\n".join(line[4:] for line in tutorial.splitlines() if line.startswith("    "))
    lines = block.replace("\\\n", " ").splitlines()
    return [shlex.split(line)[1:] for line in lines if line.startswith("ronnaplan robot")]


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder after the tutorial; the README's documents are made from the phantom's truth."""
    folder = tmp_path_factory.mktemp("robot")
    write_session(CASE, folder / "session")
    fiducials = cases.fiducials()
    (folder / "fiducials.json").write_text(to_json(fiducials))
    readings = find_markers(read_recording(CASE / "readings.csv")).points
    found = register_markers(fiducials.points, readings)
    (folder / "registration.json").write_text(to_json(registration_document(found, fiducials.source)))
    write_plan(folder / "plan.json", cases.plan())
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        find_once(patch)
        run = commands()
        assert {arguments[1] for arguments in run} >= {
            "pivot",
            "hand-eye",
            "stereo-calibrate",
            "relocate",
            "chain",
        }
        for arguments in run:
            assert main(arguments) == 0, arguments
    return folder


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def matrix(entry: Any) -> np.ndarray:
    return np.array(entry["matrix"])


def test_the_tutorial_brings_the_plan_to_where_it_is_in_the_robots_frame(home: Path) -> None:
    """Within the error stated: chi-square of three coordinates, 99.9 %."""
    truth = np.array(read(home / "session" / "truth.json")["robot_from_ct"])
    plan = cases.plan()
    for way in ("chain.json", "final.json"):
        chain = read(home / way)
        for one in plan.trajectories:
            off = (matrix(chain["robot_from_ct"]) - truth)[:3] @ [*one.target_mm, 1]
            at = matrix(chain["robot_from_ct"])[:3] @ [*one.target_mm, 1]
            x, y, z = at
            jacobian = np.hstack([[[0, z, -y], [-z, 0, x], [y, -x, 0]], np.eye(3)])
            spread = jacobian @ np.array(chain["robot_from_ct"]["covariance"]) @ jacobian.T
            assert off @ np.linalg.solve(spread, off) < 16.3


def test_the_scatter_of_a_pivot_is_told_of_the_poses_that_were_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left_out = "over {} of 600 poses; left out as slipped: frames {}\n"
    one, many = left_out.format(599, "1100"), left_out.format(560, "1100-1139")
    for slipped, told in ((0, "over 600 poses\n"), (1, one), (40, many)):
        poses = recording(2)
        poses[100 : 100 + slipped, :3, 3] += (6.0, -4.0, 5.0)
        numbered = np.column_stack([np.arange(1000, 1600), poses.reshape(-1, 16)])
        header = "frame," + ",".join(f"m{row}{column}" for row in range(4) for column in range(4))
        formats = ["%d", *["%.18g"] * 16]
        np.savetxt(tmp_path / "poses.csv", numbered, formats, delimiter=",", header=header, comments="")
        assert main(["robot", "pivot", str(tmp_path / "poses.csv"), "-o", str(tmp_path / "pivot.json")]) == 0
        assert told in "".join(capsys.readouterr())


@pytest.mark.parametrize(("off_mm", "status"), [(0.0, 0), (15.0, 0), (90.0, 3)])
def test_poses_that_contradict_the_others_are_named_by_their_frames(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], off_mm: float, status: int
) -> None:
    """Also where they are off by so much that all is refused."""
    session = home / "session"
    header, *rows = (session / "hand_eye_tracker.csv").read_text("utf-8").splitlines()
    column, frame = (header.split(",").index(name) for name in ("m03", "frame"))
    cells = rows[7].split(",")
    cells[column] = str(float(cells[column]) + off_mm)
    tracker = tmp_path / "tracker.csv"
    tracker.write_text("\n".join([header, *rows[:7], ",".join(cells), *rows[8:]]), "utf-8")
    both = [str(tracker), str(session / "hand_eye_robot.csv")]
    assert main(["robot", "hand-eye", *both, "-o", str(tmp_path / "hand-eye.json")]) == status
    assert (f"(frames {cells[frame]})" in capsys.readouterr().err) == (off_mm > 0)


def test_from_which_frame_on_the_base_was_moved_is_told_and_written(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session, out = home / "session", tmp_path / "hand-eye.json"
    header, *rows = (session / "hand_eye_tracker.csv").read_text("utf-8").splitlines()
    column, frame = (header.split(",").index(name) for name in ("m03", "frame"))
    cells = [row.split(",") for row in rows]
    for row in cells[17:]:
        row[column] = str(float(row[column]) + 4.0)
    (tmp_path / "tracker.csv").write_text("\n".join([header, *map(",".join, cells)]), "utf-8")
    both = [str(tmp_path / "tracker.csv"), str(session / "hand_eye_robot.csv")]
    assert main(["robot", "hand-eye", *both, "-o", str(out)]) == 0
    told = f"from frame {cells[17][frame]} on robot and tracker stand otherwise to each other than before"
    assert told in capsys.readouterr().err
    assert any(note.startswith(told) for note in read(out)["notes"])


def test_the_commands_write_what_the_functions_return(home: Path) -> None:
    session = home / "session"
    pivot = calibrate_pivot(read_recording(session / "pivot.csv").poses("tool"))
    written = read_pivot(home / "pivot.json")
    np.testing.assert_allclose(written.tip_mm, pivot.tip_mm, atol=1e-12)
    np.testing.assert_allclose(written.tip_covariance_mm2, pivot.tip_covariance_mm2, atol=1e-15)
    tracker, robot = (
        read_recording(session / f"hand_eye_{who}.csv").poses("tool") for who in ("tracker", "robot")
    )
    tool = with_tip(calibrate_hand_eye(tracker, robot), pivot.tip_mm, pivot.tip_covariance_mm2).m_from_tcp
    found = read_hand_eye(home / "hand-eye.json").tcp_in_m
    np.testing.assert_allclose(found.matrix, tool.matrix, atol=1e-12)
    np.testing.assert_allclose(found.covariance, tool.covariance, atol=1e-15)


def test_every_export_says_the_same_points(home: Path) -> None:
    points = read(home / "points.json")
    chain = matrix(read(home / "final.json")["robot_from_ct"])
    poses = {
        (one["name"], end): matrix(one[end]["robot_from_tool"])
        for one in points["trajectories"]
        for end in ("entry", "target")
    }
    poses |= {(one["name"], "approach"): np.array(one["approach"]) for one in points["trajectories"]}
    for one in cases.plan().trajectories:
        np.testing.assert_allclose(poses[one.name, "target"][:3, 3], chain[:3] @ [*one.target_mm, 1], atol=1e-9)
    for message in yaml.safe_load((home / "points.yaml").read_text()):
        pose = message["pose"]["pose"]
        name, end = message["name"].rsplit(" ", 1)
        np.testing.assert_allclose([pose["position"][k] * 1000 for k in "xyz"], poses[name, end][:3, 3], atol=1e-6)
        turn = Rotation.from_quat([pose["orientation"][k] for k in "xyzw"]).as_matrix()
        np.testing.assert_allclose(turn, poses[name, end][:3, :3], atol=1e-9)
        covariance = np.array(message["pose"]["covariance"]).reshape(6, 6)
        errors = {
            (t["name"], e): t[e]["expected_error"] for t in points["trajectories"] for e in ("entry", "target")
        }
        error = np.sqrt(np.trace(covariance[:3, :3])) * 1000
        x, y, z = poses[name, end][:3, 3]
        lever = np.hstack([[[0, z, -y], [-z, 0, x], [y, -x, 0]], np.eye(3)])
        stated = lever @ np.array(read(home / "final.json")["robot_from_ct"]["covariance"]) @ lever.T
        assert error == pytest.approx(np.sqrt(np.trace(stated)), rel=1e-6)
        assert error == pytest.approx(errors.get((name, end), error), rel=1e-6)
    krl = (home / "points.dat").read_text()
    assert krl.splitlines()[-1] == "ENDDAT"
    assert krl.splitlines()[1] == "DEFDAT POINTS PUBLIC"  # the controller takes the file's name for it
    assert "Research use only" in krl
    frames = re.findall(r"FRAME (\w+)_TGT=\{X (\S+),Y (\S+),Z (\S+),A (\S+),B (\S+),C (\S+)\}", krl)
    assert len(frames) == len(points["trajectories"])
    for (_, *numbers), one in zip(frames, points["trajectories"], strict=True):
        x, y, z, a, b, c = map(float, numbers)
        about = [
            Rotation.from_euler(axis, angle, degrees=True).as_matrix()
            for axis, angle in zip("zyx", (a, b, c), strict=True)
        ]
        target = poses[one["name"], "target"]
        np.testing.assert_allclose([x, y, z], target[:3, 3], atol=1e-5)
        np.testing.assert_allclose(about[0] @ about[1] @ about[2], target[:3, :3], atol=1e-6)


@pytest.mark.parametrize(("names", "status"), [(("左", "右"), 1), (("Ärm", "Örm"), 1), (("左 1", "右 2"), 0)])
def test_trajectories_that_a_kukas_letters_do_not_tell_apart_are_refused(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], names: tuple[str, str], status: int
) -> None:
    """They came out as T and T_2, and as question marks in the comments: left for right."""
    plan, (first, *_) = cases.plan(), cases.plan().trajectories
    for name in names:
        plan = plan.add(replace(first, name=name, colour=""))
    write_plan(tmp_path / "plan.json", plan)
    out = str(tmp_path / "points.dat")
    assert (
        main(["robot", "export", str(home / "final.json"), str(tmp_path / "plan.json"), "--to", "krl", "-o", out])
        == status
    )
    told = capsys.readouterr().err
    assert (f"{names[0]} and {names[1]} look alike" in told) == bool(status)


def test_names_in_any_script_are_read_from_yaml_as_they_were_given(home: Path, tmp_path: Path) -> None:
    name = 'left "STN" \N{BRAIN} \N{CJK UNIFIED IDEOGRAPH-5DE6}: #1'
    first = cases.plan().trajectories[0]
    write_plan(tmp_path / "plan.json", replace(cases.plan(), trajectories=(replace(first, name=name),)))
    out = tmp_path / "points.yaml"
    assert (
        main(
            [
                "robot",
                "export",
                str(home / "final.json"),
                str(tmp_path / "plan.json"),
                "--to",
                "ros",
                "-o",
                str(out),
            ]
        )
        == 0
    )
    messages = yaml.safe_load(out.read_text(encoding="utf-8"))
    assert {message["name"].removesuffix(" target") for message in messages} >= {name}


def test_no_trajectory_s_name_folds_away_the_lines_that_follow(home: Path, tmp_path: Path) -> None:
    """Editors of KRL begin a fold at a comment whose first word is FOLD, and end one at ENDFOLD."""
    first = cases.plan().trajectories[0]
    named = tuple(replace(first, name=name, colour="") for name in ("FOLD left", "ENDFOLD"))
    write_plan(tmp_path / "plan.json", replace(cases.plan(), trajectories=named))
    out = tmp_path / "points.dat"
    inputs = (str(home / "final.json"), str(tmp_path / "plan.json"))
    assert main(["robot", "export", *inputs, "--to", "krl", "-o", str(out)]) == 0
    lines = out.read_text().splitlines()
    assert sum("FOLD left" in line or "ENDFOLD:" in line for line in lines) == 2
    assert not any(re.match(r"\s*;\s*(END)?FOLD\b", line) for line in lines)


@pytest.mark.parametrize(
    ("name", "listed"), [("frame.dat", "T_FRAME"), ("pos.dat", "T_POS"), ("frames.dat", "FRAMES")]
)
def test_a_data_list_is_not_called_what_is_a_word_of_the_language(home: Path, name: str, listed: str) -> None:
    named = ("-o", str(home / name))
    assert main(["robot", "export", str(home / "final.json"), str(home / "plan.json"), "--to", "krl", *named]) == 0
    lines = (home / name).read_text().splitlines()
    assert lines[1] == f"DEFDAT {listed} PUBLIC"
    assert f"; For the controller the file's name is {listed}.dat." in lines


@pytest.mark.parametrize("name", ["points.txt", "points", "points.dat.json"])
def test_a_data_list_has_the_ending_by_which_the_controller_takes_it(
    home: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    named = ("-o", str(home / name))
    assert main(["robot", "export", str(home / "final.json"), str(home / "plan.json"), "--to", "krl", *named]) == 2
    assert "expected a name that ends in .dat" in capsys.readouterr().err
    assert not (home / name).exists()
    named = ("-o", str(home / "Other.DAT"))
    assert main(["robot", "export", str(home / "final.json"), str(home / "plan.json"), "--to", "krl", *named]) == 0


@pytest.mark.parametrize(
    ("option", "way"),
    [("--sigma-ct", "tracker"), ("--expected", "tracker"), ("--sigma-ots", "stereo"), ("--frame", "stereo")],
)
def test_an_option_of_the_other_way_is_no_option_of_this(
    home: Path, capsys: pytest.CaptureFixture[str], option: str, way: str
) -> None:
    """It changed nothing, without a word: least of all the stated errors."""
    session, out = home / "session", home / "none.json"
    ways = {
        "tracker": {
            **{"registration": home / "registration.json", "hand-eye": home / "hand-eye.json"},
            **{"tracker": session / "rest_tracker.csv", "geometry": session / "tool.json"},
            "robot": session / "rest_robot.csv",
        },
        "stereo": {"fiducials": home / "fiducials.json", "spheres": home / "spheres.json"},
    }
    named = [f"--{name}={path}" for name, path in ways[way].items()]
    assert main(["robot", "chain", *named, f"{option}=3", "-o", str(out)]) == 2
    assert f"{option} belongs to the way by the" in capsys.readouterr().err
    assert not out.exists()


def test_the_table_is_one_row_a_point(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "export", str(home / "final.json"), str(home / "plan.json"), "--to", "csv"]) == 0
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert len(rows) == 3 * len(cases.plan().trajectories)
    targets = {
        row["trajectory"]: [float(row[f"{axis}_mm"]) for axis in "xyz"] for row in rows if row["point"] == "target"
    }
    for one in read(home / "points.json")["trajectories"]:
        np.testing.assert_allclose(
            targets[one["name"]], matrix(one["target"]["robot_from_tool"])[:3, 3], atol=1e-7
        )
    assert all("Research use only" in row["notice"] for row in rows)


def test_the_angles_of_a_kuka_are_told_where_two_of_its_axes_meet() -> None:
    for b in (90.0, -90.0, 30.0):
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_euler("ZYX", (40.0, b, -70.0), degrees=True).as_matrix()
        angles = krl_angles(matrix)
        again = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
        np.testing.assert_allclose(again, matrix[:3, :3], atol=1e-12)
        assert angles[1] == pytest.approx(b, abs=1e-6)


def test_what_does_not_belong_together_is_refused(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def told(*arguments: object) -> tuple[int, str]:
        status = main(["robot", *map(str, arguments)])
        return status, capsys.readouterr().err

    session = home / "session"
    status, text = told("hand-eye", session / "hand_eye_tracker.csv", session / "markers_robot.csv")
    assert status in (1, 3)
    assert "contradict each other" in text
    assert "as tracker from tool and robot from TCP" in text  # the other way round is likelier than other moments
    status, text = told("chain", "--registration", home / "registration.json", "--spheres", home / "spheres.json")
    assert status == 2
    assert "one of two ways" in text
    moved = ("--tracker", session / "hand_eye_tracker.csv", "--robot", session / "hand_eye_robot.csv")
    by_tracker = ("--registration", home / "registration.json", "--hand-eye", home / "hand-eye.json")
    status, text = told("chain", *by_tracker, "--geometry", session / "tool.json", *moved)
    assert status == 3
    assert "moved while it was recorded" in text
    assert "let it rest, or name one frame (--frame)" in text
    other = read(home / "hand-eye.json")
    (home / "other.json").write_text(json.dumps({**other, "tool": "another"}))
    by_tracker = ("--registration", home / "registration.json", "--hand-eye", home / "other.json")
    rested = ("--frame", 0, "-o", home / "other chain.json")
    status, text = told("chain", *by_tracker, "--geometry", session / "tool.json", *moved, *rested)
    assert status == 0
    assert f"the calibration is of the tool 'another', the tracker's recording of '{other['tool']}'" in text
    pivot = {**read(home / "pivot.json"), "tool": "pointer", "notes": ["3 poses are none"]}
    (home / "other pivot.json").write_text(json.dumps(pivot))
    seen = (session / "hand_eye_tracker.csv", session / "hand_eye_robot.csv", "--pivot", home / "other pivot.json")
    status, text = told("hand-eye", *seen, "-o", home / "other hand-eye.json")
    assert status == 0
    assert f"the calibration is of the tool 'pointer', the tracker's recording of '{other['tool']}'" in text
    assert "3 poses are none" in read(home / "other hand-eye.json")["notes"]  # a chain hands them on
    status, text = told(
        "relocate",
        session / "sphere",
        session / "markers_robot.csv",
        "--rig",
        home / "rig.json",
        "--diameter",
        11.5,
    )
    assert status == 1
    assert "no pose of frame 6" in text
    status, text = told(
        "relocate", session / "markers", session / "markers_robot.csv", "--rig", home / "rig.json", "--diameter", 9
    )
    assert status == 1
    assert "frame 0: no sphere of 9 mm" in text


def test_looks_at_one_sphere_tell_that_something_moved_or_how_poses_were_misread(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    driven = read_recording(home / "session" / "sphere_robot.csv")
    poses = np.array([one.matrix for one in driven.tools])
    moved = poses.copy()
    moved[5, 0, 3] += 0.6
    asked = [
        "relocate",
        str(home / "session" / "sphere"),
        str(tmp_path / "robot.csv"),
        "--rig",
        str(home / "rig.json"),
    ]
    header = ",".join(["frame", *(f"m{row}{column}" for row in range(4) for column in range(4))])
    told = []
    for status, given in ((0, poses), (0, moved), (3, misread(poses, "scalar last"))):
        numbered = np.column_stack([np.arange(len(given)), given.reshape(-1, 16)])
        np.savetxt(tmp_path / "robot.csv", numbered, ["%d", *["%.12g"] * 16], ",", header=header, comments="")
        output = ["--diameter", "11.5", "-o", str(tmp_path / "spheres.json")]
        assert main(["robot", *asked, *output]) == status
        told.append((capsys.readouterr().err, read(tmp_path / "spheres.json")["notes"]))
    (_, nothing), (warned, (note,)), (refused, _) = told
    assert nothing == []
    assert "frames 5 and" in note or "and 5 (and" in note
    assert "show one sphere at places 0.6" in note
    assert note in warned
    assert f"robot's poses {MISREAD['scalar last']}" in refused or f"in them {MISREAD['scalar last']}" in refused


def test_recordings_that_are_mixed_up_are_refused_or_doubted(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def told(*arguments: object) -> tuple[int, str]:
        status = main(["robot", *map(str, arguments)])
        return status, capsys.readouterr().err

    session, swapped = home / "session", tmp_path / "swapped.json"
    tracker, robot = session / "hand_eye_tracker.csv", session / "hand_eye_robot.csv"
    status, text = told("hand-eye", robot, tracker, "-o", swapped)
    assert (status, "as if the TCP were what the tracker sees" in text) == (0, True)
    assert "are the same; expected a recording of either" in told("hand-eye", tracker, tracker)[1]
    chain = ("chain", "--registration", home / "registration.json", "--geometry", session / "tool.json")
    rest = ("--tracker", session / "rest_tracker.csv", "--robot", session / "rest_robot.csv")
    changed = "and as in it if the tracker's and the robot's poses change places, here or in that calibration"
    status, text = told(*chain, *rest, "--hand-eye", swapped)
    assert (status, changed in text) == (3, True)
    (tmp_path / "rest.csv").write_text("\n".join(rest[1].read_text("utf-8").splitlines()[:2]), "utf-8")
    status, text = told(
        *chain, "--tracker", rest[3], "--robot", tmp_path / "rest.csv", "--hand-eye", home / "hand-eye.json"
    )
    assert (status, changed in text) == (3, True)
    header, *rows = tracker.read_text("utf-8").splitlines()
    of_tracker = tmp_path / "named.csv"
    of_tracker.write_text("\n".join([f"{header},tool", *(f"{row},ToolToTracker" for row in rows)]), "utf-8")
    assert told("hand-eye", of_tracker, robot)[0] == 0
    asked: tuple[object, ...]
    for asked in (
        ("hand-eye", tracker, of_tracker),
        (*chain, *rest[:3], of_tracker, "--hand-eye", home / "hand-eye.json"),
        ("relocate", session / "markers", of_tracker, "--rig", home / "rig.json", "--diameter", 11.5),
    ):
        status, text = told(*asked)
        assert (status, "holds poses of ToolToTracker, as a tracker tells them; expected the robot's" in text) == (
            1,
            True,
        )
    driven = tmp_path / "driven.csv"
    driven.write_text("\n".join([f"{header},tool", *(f"{row},TcpToRobot" for row in rows)]), "utf-8")
    for asked in (("hand-eye", driven, robot), ("pivot", driven)):
        status, text = told(*asked)
        assert (status, "holds poses of TcpToRobot, as the robot tells them" in text) == (1, True)
    assert "otherwise to each other" not in told(*chain, *rest, "--hand-eye", home / "hand-eye.json")[1]
    status, text = told(*chain, *rest[:3], rest[1], "--hand-eye", home / "hand-eye.json")
    assert (status, "tell the same pose" in text) == (1, True)
    of_slicer = {**read(home / "registration.json"), "frames": {"ct": "CT", "ots": "LPS"}}
    (tmp_path / "registration.json").write_text(json.dumps(of_slicer))
    named = ("chain", "--registration", tmp_path / "registration.json", *chain[3:])
    status, text = told(*named, *rest, "--hand-eye", home / "hand-eye.json")
    assert (status, "readings are in the frame LPS, and poses of tools in the tracker's own" in text) == (1, True)


def test_recordings_with_quaternions_need_no_name_of_the_tool(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = home / "session"
    for name in ("pivot", "hand_eye_tracker", "hand_eye_robot", "rest_tracker"):
        poses = read_recording(session / f"{name}.csv").poses("tool")
        turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
        table = np.column_stack([np.arange(len(poses)), poses[:, :3, 3], turns])
        header = "frame,x,y,z,qx,qy,qz,qw"
        np.savetxt(tmp_path / f"{name}.csv", table, "%.9f", ",", header=header, comments="")
        text = (tmp_path / f"{name}.csv").read_text().replace(".000000000,", ",")
        (tmp_path / f"{name}.csv").write_text(text)
    pivot, hand_eye = str(tmp_path / "pivot.json"), str(tmp_path / "hand-eye.json")
    assert main(["robot", "pivot", str(tmp_path / "pivot.csv"), "-o", pivot]) == 0
    np.testing.assert_allclose(read_pivot(pivot).tip_mm, read_pivot(home / "pivot.json").tip_mm, atol=1e-4)
    both = [str(tmp_path / f"hand_eye_{who}.csv") for who in ("tracker", "robot")]
    assert main(["robot", "hand-eye", *both, "--pivot", pivot, "-o", hand_eye]) == 0
    found, same = read_hand_eye(hand_eye), read_hand_eye(home / "hand-eye.json")
    assert found.tool == same.tool == "tool"
    np.testing.assert_allclose(found.tcp_in_m.matrix, same.tcp_in_m.matrix, atol=1e-4)
    chain = ["--registration", str(home / "registration.json"), "--geometry", str(session / "tool.json")]
    rest = ["--tracker", str(tmp_path / "rest_tracker.csv"), "--robot", str(session / "rest_robot.csv")]
    capsys.readouterr()
    assert main(["robot", "chain", *chain, *rest, "--hand-eye", hand_eye, "-o", str(tmp_path / "c.json")]) == 0
    assert "the calibration is of the tool" not in capsys.readouterr().err


def test_images_that_were_cropped_are_refused(home: Path, tmp_path: Path) -> None:
    """Beside the lens a crop moves both lines of sight alike: spheres were found 6 mm beside where they are."""
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        whole = Image.open(home / "session" / "markers" / side / "000.png")
        whole.crop((40, 0, *whole.size)).save(tmp_path / side / "000.png")
    with pytest.raises(InputError, match="frame 0: an image of 600x512 pixels is not of this camera"):
        in_rig(read_pairs(tmp_path), read_rig(home / "rig.json").rig, diameter_mm=11.5)


def test_markers_that_the_cameras_calibration_leaves_open_are_refused(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """How far off the calibration's boards were, its document tells."""
    near = read(home / "rig.json")
    assert 0.001 < near["calibrated_on"]["error_px"] < 0.03
    near["calibrated_on"]["error_px"] = 3.0
    (tmp_path / "rig.json").write_text(json.dumps(near))
    looks = (str(home / "session" / "markers"), str(home / "session" / "markers_robot.csv"))
    assert main(["robot", "relocate", *looks, "--rig", str(tmp_path / "rig.json"), "--diameter", "11.5"]) == 3
    told = r"frame 0: the sphere's center is known to .* mm only; .* mm the cameras' calibration leaves open"
    assert re.search(told, capsys.readouterr().err)


def test_how_well_the_squares_are_known_counts_in_what_the_cameras_know(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A printed board leaves the resting sphere open, whatever its images show."""
    find_once(monkeypatch)
    session = home / "session"
    shown = [str(session / name) for name in ("boards", "sphere", "sphere_robot.csv")]
    sizes = ["--corners", "9x7", "--square", "6", "--diameter", "11.5"]
    out = tmp_path / "rig.json"
    printed = ["--sigma-square", "0.1", "-o", str(out)]
    assert main(["robot", "stereo-calibrate", *shown, *sizes, *printed]) == 3
    assert "most of that is how well the side of the board's squares is known" in capsys.readouterr().err
    assert not out.exists()
    assert read(home / "rig.json")["calibrated_on"]["sigma_square"] == 1e-4  # where nothing is stated
    stated = ["robot", "stereo-calibrate", *shown, *sizes, *printed, "--largest-error"]
    assert main([*stated, "0.2"]) == 0
    assert "the boards tell the cameras to" not in capsys.readouterr().err  # as they do to so much
    assert read(out)["calibrated_on"]["sigma_square"] == 1e-3
    assert main([*stated, "0.51"]) == 2


def test_squares_of_another_size_than_stated_contradict_the_sphere(home: Path) -> None:
    rig, looks = read_rig(home / "rig.json").rig, read_pairs(home / "session" / "markers")
    spheres = in_rig({0: looks[0]}, rig, diameter_mm=11.5)
    require_size(spheres, rig, 11.5)
    with pytest.raises(RefusedError, match=r"puts the resting sphere 1.\d % farther than a sphere of 11.3 mm"):
        require_size(spheres, rig, 11.3)


def test_a_radius_in_the_diameter_s_place_is_told_as_such(home: Path) -> None:
    """It was said that the cameras' calibration leaves open where the sphere is."""
    rig, looks = read_rig(home / "rig.json").rig, read_pairs(home / "session" / "markers")
    with pytest.raises(InputError, match=r"what looks like one of 11.5 mm: correct the diameter"):
        in_rig({0: looks[0]}, rig, diameter_mm=5.75)


def test_a_resting_pose_that_was_misread_is_refused_as_such(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The chain was written, with a warning, and put the head hundreds of millimetres beside its place."""
    header, first, *_ = (home / "session" / "rest_robot.csv").read_text("utf-8").splitlines()
    pose = np.array(first.split(",")[1:], dtype=float).reshape(4, 4)
    scalar_first = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
    pose[:3, :3] = Rotation.from_quat(scalar_first).as_matrix()
    robot = tmp_path / "rest_robot.csv"
    robot.write_text(f"{header}\n0,{','.join(map(str, pose.ravel()))}\n", "utf-8")
    given = {
        "registration": home / "registration.json",
        "hand-eye": home / "hand-eye.json",
        "tracker": home / "session" / "rest_tracker.csv",
        "geometry": home / "session" / "tool.json",
        "robot": robot,
    }
    options = [str(part) for name, path in given.items() for part in (f"--{name}", path)]
    assert main(["robot", "chain", *options, "-o", str(tmp_path / "chain.json")]) == 3
    told = "and as in it if in the robot's poses the scalar is the quaternions' first number, not the last"
    assert told in capsys.readouterr().err
    assert not (tmp_path / "chain.json").exists()


@pytest.mark.parametrize(("unit", "length_mm"), [("cm", 10.0), ("inches", 25.4), ("tenths of a mm", 0.1)])
@pytest.mark.parametrize("whose", ["tracker", "robot"])
def test_a_tool_at_rest_in_another_unit_is_refused(
    whose: str, unit: str, length_mm: float, home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The chain was written, with a warning, metres beside the robot."""
    given = {
        "registration": home / "registration.json",
        "hand-eye": home / "hand-eye.json",
        "tracker": home / "session" / "rest_tracker.csv",
        "geometry": home / "session" / "tool.json",
        "robot": home / "session" / "rest_robot.csv",
    }
    header, *rows = given[whose].read_text("utf-8").splitlines()
    table = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    table[:, [4, 8, 12]] /= length_mm
    given[whose] = tmp_path / "rest.csv"
    lines = [",".join([str(int(row[0])), *map(str, row[1:])]) for row in table]
    given[whose].write_text("\n".join([header, *lines]), "utf-8")
    options = [str(part) for name, path in given.items() for part in (f"--{name}", path)]
    assert main(["robot", "chain", *options, "-o", str(tmp_path / "chain.json")]) == 3
    assert f"and as in it if the {whose}'s places are in {unit}; give all in mm" in capsys.readouterr().err
    assert not (tmp_path / "chain.json").exists()


def test_a_frame_that_is_not_there_and_poses_that_do_not_count_are_told(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost, session = tmp_path / "lost.csv", home / "session"
    chain = ("--registration", home / "registration.json", "--hand-eye", home / "hand-eye.json")
    others = ("--geometry", session / "tool.json", "--robot", session / "rest_robot.csv")
    asked = ["robot", "chain", *map(str, (*chain, *others)), "--tracker"]
    assert main([*asked, str(session / "rest_tracker.csv"), "--frame", "99"]) == 1
    assert "rest_tracker.csv has no reading of frame 99" in capsys.readouterr().err
    for name, command in (("rest_tracker", asked), ("pivot", ["robot", "pivot"])):
        header, _, *rows = (session / f"{name}.csv").read_text("utf-8").splitlines()
        hidden = ",".join(["0", *["nan"] * 16])
        lost.write_text("\n".join([header, hidden, *rows]), "utf-8")
        assert main([*command, str(lost), "-o", str(tmp_path / "out.json")]) == 0
        assert f"lost.csv: 1 of {1 + len(rows)} poses do not count, most say 'no pose" in capsys.readouterr().err


def test_recordings_without_rows_are_said_to_hold_no_poses(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They were said not to number them."""
    recorded = home / "session" / "hand_eye_robot.csv"
    bare = tmp_path / "bare.csv"
    bare.write_text(recorded.read_text("utf-8").splitlines()[0] + "\n", "utf-8")
    assert main(["robot", "hand-eye", str(bare), str(recorded)]) == 1
    assert "bare.csv holds no poses" in capsys.readouterr().err


def test_a_tool_in_metres_is_refused(home: Path, tmp_path: Path) -> None:
    tool = read(home / "session" / "tool.json")
    tool["centers"] = (np.array(tool["centers"]) / 1000).tolist()
    (tmp_path / "tool.json").write_text(json.dumps(tool))
    with pytest.raises(InputError, match="in metres"):
        read_template_document(tmp_path / "tool.json")


def test_a_lamp_s_angle_is_judged_in_degrees(capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["relocate", "looks", "robot.csv", "--rig", "rig.json", "--diameter", "9", "--lamp-offset", "40"]
    assert main(["robot", *asked]) == 2
    assert "40 is no standard deviation in degrees" in capsys.readouterr().err


def test_changed_documents_are_refused(home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chain = read(home / "chain.json")
    chain["robot_from_ct"]["matrix"][0][3] += 0.01
    (tmp_path / "chain.json").write_text(json.dumps(chain))
    assert main(["robot", "export", str(tmp_path / "chain.json"), str(home / "plan.json")]) == 1
    assert "not the product of the links" in capsys.readouterr().err
    chain = read(home / "chain.json")
    chain["source"]["frame_of_reference_uid"] = "1.2.3"
    (tmp_path / "chain.json").write_text(json.dumps(chain))
    assert main(["robot", "export", str(tmp_path / "chain.json"), str(home / "plan.json")]) == 1
    assert "frame" in capsys.readouterr().err
    spheres = read(home / "spheres.json")
    spheres["spheres"][0]["position"][0] += 0.01
    (tmp_path / "spheres.json").write_text(json.dumps(spheres))
    files = ["--fiducials", str(home / "fiducials.json"), "--spheres", str(tmp_path / "spheres.json")]
    assert main(["robot", "chain", *files]) == 1
    assert "not where its look puts it" in capsys.readouterr().err


def test_an_axis_of_no_length_is_wrong_usage(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["robot", "export", str(home / "final.json"), str(home / "plan.json"), "--x-axis", "0", "0", "0"]
    assert main(command) == 2
    assert "--x-axis 0 0 0 has no direction" in capsys.readouterr().err
