"""``ronnaplan register`` and ``ronnaplan track`` keep their contracts."""

import json
import socket
import threading
from pathlib import Path

import numpy as np
import pyigtl
import pytest

from ronnaplan.cli import main
from ronnaplan.cli.register import _pair
from ronnaplan.cli.track import movement
from ronnaplan.ct import SeriesSource
from ronnaplan.documents.plan import write_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.documents.registration import read_registration
from ronnaplan.errors import UsageError
from ronnaplan.geometry import Frame
from ronnaplan.planning import Plan, Trajectory
from ronnaplan.sigmas import SIGMA_OTS_MM
from ronnaplan.tracking import PointReading, Recording, read_recording
from ronnaplan.tracking.csv_file import write_csv
from tests.documents.registrations import fiducials
from tests.registration import scene


@pytest.fixture
def markers(tmp_path: Path) -> Path:
    path = tmp_path / "fiducials.json"
    path.write_text(to_json(fiducials()))
    return path


def readings(folder: Path, frames: int = 20) -> Path:
    rng = np.random.default_rng(0)
    lines = ["frame,x,y,z"]
    for frame in range(frames):
        seen = scene.HEAD / 3 @ scene.TURN.T + scene.SHIFT + rng.normal(size=scene.HEAD.shape) * 0.05
        lines += [f"{frame},{x:.4f},{y:.4f},{z:.4f}" for x, y, z in seen[rng.permutation(5)]]
    path = folder / "readings.csv"
    path.write_text("\n".join(lines))
    return path


def plan(folder: Path, uid: str | None, version: int = 1) -> Path:
    path = folder / "plan.json"
    frame = Frame("CT", uid)
    one = Trajectory("left", np.array([10.0, 5.0, 40.0]), np.array([5.0, 0.0, 0.0]), frame)
    write_plan(path, Plan(SeriesSource(frame_of_reference_uid=uid)).add(one))
    path.write_text(path.read_text().replace('"version": 1,', f'"version": {version},', 1))
    return path


def test_markers_and_stray_readings_become_a_registration_with_expected_errors(
    markers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "registration.json"
    arguments = [
        str(markers),
        str(readings(tmp_path)),
        "--plan",
        str(plan(tmp_path, scene.CT.uid)),
        "-o",
        str(out),
    ]
    arguments += ["--target", "-1", "2", "3.5"]
    assert main(["register", *arguments, "--sigma-ct", "0.1", "--expected", "5"]) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "do not measure the error at a target" in printed.err
    assert (
        "counted per axis: 0.1 mm of each marker beside the localizer's own error (as --sigma-ct states)"
        in printed.err
    )
    assert "fit probability" in printed.err
    content = json.loads(out.read_text())
    np.testing.assert_allclose(np.array(content["ots_from_ct"])[:3, :3], scene.TURN, atol=0.01)
    assert [target["name"] for target in content["targets"]] == ["left entry", "left target", "target 1"]
    assert content["targets"][2]["center"] == [-1.0, 2.0, 3.5]


def test_a_plan_of_another_scan_is_refused(
    markers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "registration.json"
    arguments = [str(markers), str(readings(tmp_path)), "--plan", str(plan(tmp_path, "9.9")), "-o", str(out)]
    assert main(["register", *arguments]) == 1
    assert "9.9" in capsys.readouterr().err
    assert not out.exists()


def test_a_plan_of_a_newer_version_is_not_half_read(
    markers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    newer = plan(tmp_path, scene.CT.uid, version=2)
    assert main(["register", str(markers), str(readings(tmp_path)), "--plan", str(newer)]) == 1
    assert "version" in capsys.readouterr().err


def test_readings_that_do_not_fit_are_refused_with_a_document(
    markers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.csv"
    rng = np.random.default_rng(1)
    other.write_text("x,y,z\n" + "\n".join(",".join(map(str, row)) for row in rng.uniform(-300, 300, (5, 3))))
    assert main(["register", str(markers), str(other), "--expected", "5"]) == 3
    printed = capsys.readouterr()
    assert json.loads(printed.out)["status"] != "unique"
    assert json.loads(printed.out)["ots_from_ct"] is None
    assert printed.err.count(json.loads(printed.out)["reason"]) == 1


def test_a_number_that_the_readings_cannot_hold_is_evidence_like_any_other(
    markers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It exited with 1, as if the files were unusable, where a stray reading more let the same markers pair."""
    arguments = ["register", str(markers), str(readings(tmp_path)), "--sigma-ct", "0.1"]
    assert main([*arguments, "--expected", "6"]) == 0
    assert "5 markers pair where 6 are expected" in capsys.readouterr().err
    for number in (["--expected", "9"], ["--at-least", "6"]):
        assert main([*arguments, *number]) == 3
        printed = capsys.readouterr()
        assert json.loads(printed.out)["status"] == "unmatched"
        assert "5 pairs fit but" in printed.err


def test_the_scans_own_markers_are_no_readings(
    markers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a file that was exported for Slicer, in LPS, or as a table of another program in RAS, which says so or not."""
    exported, registration = tmp_path / "f.mrk.json", tmp_path / "registration.json"
    assert main(["export", str(markers), "--to", "markups", "-o", str(exported)]) == 0
    rows = [f"{-x:.3f},{-y:.3f},{z:.3f}" for x, y, z in fiducials().points.positions_mm]
    tables = [tmp_path / "told.csv", tmp_path / "untold.csv"]
    for table, header in zip(tables, ("r,a,s", "x,y,z"), strict=True):
        table.write_text("\n".join([header, *rows]))
    for readings in (exported, *tables):
        assert main(["register", str(markers), str(readings), "-o", str(registration)]) == 1
        assert "the readings are the scan's own markers" in capsys.readouterr().err
    assert not registration.exists()


@pytest.mark.parametrize(
    ("text", "pair"), [("A=B=1", ("A=B", "1")), ("A==1", ("A", "=1")), ("F1=1", ("F1", "1")), ("A=1", ("A", "1"))]
)
def test_a_pair_whose_labels_hold_equals_signs_is_told_by_the_labels(text: str, pair: tuple[str, str]) -> None:
    assert _pair(text, ("F1", "A=B", "A"), ("1", "=1")) == pair


def test_a_pair_that_can_be_read_in_two_ways_is_refused() -> None:
    with pytest.raises(UsageError, match="names 2 pairs"):
        _pair("A=B=1", ("A", "A=B"), ("1", "B=1"))


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["absent.json", "absent.csv"], 1, "absent.json"),
        (["{markers}", "absent.csv"], 1, "absent.csv"),
        (["{markers}", "{readings}", "--pair", "F1"], 2, "CT=READING"),
        (["{markers}", "{readings}", "--pair", "F9=1"], 2, "no CT marker F9"),
        (["{markers}", "{readings}", "--pair", "=1"], 2, "CT=READING"),
        (["{markers}", "{readings}", "--pair", "F1=1", "--pair", "F1=2"], 2, "F1, F1"),
        (["{markers}", "{readings}", "--sigma-ct", "-1"], 2, "--sigma-ct: -1"),
        (["{markers}", "{readings}", "--sigma-ct", "nan"], 2, "--sigma-ct: nan"),
        (["{markers}", "{readings}", "--sigma-ct", "0"], 2, "--sigma-ct: 0"),
        (["{markers}", "{readings}", "--sigma-ct", "1e300"], 2, "--sigma-ct: 1e300"),
        (["{markers}", "{readings}", "--sigma-ots", "0"], 2, "--sigma-ots: 0"),
        (["{markers}", "{readings}", "--sigma-ots", "1e300"], 2, "--sigma-ots: 1e300"),
        (["{markers}", "{readings}", "--expected", "2"], 2, "--expected: 2"),
        (["{markers}", "{readings}", "--expected", "-1"], 2, "--expected: -1"),
        (["{markers}", "{readings}", "--plan", "{markers}"], 1, "not a plan"),
    ],
)
def test_unusable_requests_are_one_sentence(
    markers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], status: int, says: str
) -> None:
    named = [text.format(markers=markers, readings=readings(tmp_path)) for text in arguments]
    assert main(["register", *named]) == status
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value"), [("--port", "99999999"), ("--port", "0"), ("--seconds", "-1"), ("--seconds", "nan")]
)
def test_impossible_options_of_track_are_wrong_usage(
    capsys: pytest.CaptureFixture[str], option: str, value: str
) -> None:
    assert main(["track", option, value]) == 2
    assert f"{option}: {value}" in capsys.readouterr().err


def test_left_out_readings_are_told_and_single_readings_in_one_line(
    markers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    once = readings(tmp_path, frames=1)
    once.write_text(once.read_text() + "\n0,foo,1,2\n0,nan,1,2\n0,1e300,1,2\n0,1,2\n")
    assert main(["register", str(markers), str(once), "-o", str(tmp_path / "registration.json")]) == 0
    told = capsys.readouterr().err
    assert "2 readings left out: no position\n" in told
    assert "1 reading left out: no position within a kilometre" in told
    assert "1 reading left out: a coordinate that is no plain number" in told
    assert "all 5 markers were read once only" in told
    assert told.count("read once only") == 1


def test_many_kinds_of_flagged_readings_are_summed_up(
    markers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = readings(tmp_path)
    lines = path.read_text().splitlines()
    flagged = [f"0,1,2,3,damage {k}" for k in range(40)]
    path.write_text("\n".join([lines[0] + ",status", *lines[1:], *flagged]))
    assert main(["register", str(markers), str(path), "-o", str(tmp_path / "registration.json")]) == 0
    told = capsys.readouterr().err
    assert "40 readings left out for 40 reasons" in told
    assert "damage" not in told


def test_track_records_a_live_server(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            for _ in range(30):
                connection.sendall(pyigtl.PointMessage(positions=scene.HEAD, device_name="Polaris").pack())

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    out = tmp_path / "readings.csv"
    port = str(listener.getsockname()[1])
    assert main(["track", "--host", "127.0.0.1", "--port", port, "--seconds", "5", "-o", str(out)]) == 0
    thread.join(10)
    listener.close()
    assert len(read_recording(out).points) == 150
    printed = capsys.readouterr()
    assert "5 markers in 30 frames" in printed.err
    assert "closed the stream" in printed.err


def test_track_tells_that_the_patient_has_moved(
    markers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    registration = tmp_path / "registration.json"
    assert main(["register", str(markers), str(readings(tmp_path)), "-o", str(registration)]) == 0
    listener = socket.create_server(("127.0.0.1", 0))
    still = scene.HEAD / 3 @ scene.TURN.T + scene.SHIFT

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            for k in range(30):
                seen = still + (k >= 20) * np.array([3.0, 0, 0])
                connection.sendall(pyigtl.PointMessage(positions=seen[::-1], device_name="Polaris").pack())

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    port = str(listener.getsockname()[1])
    capsys.readouterr()
    assert main(["track", "--port", port, "--registration", str(registration)]) == 0
    thread.join(10)
    listener.close()
    told = capsys.readouterr().err
    assert "20 of 30 frames: nothing moved" in told
    assert "10 of 30 frames: all markers moved together" in told
    assert "lastly moved by 3.0" in told


def test_a_head_that_rests_before_a_coarse_tracker_is_not_said_to_move(markers: Path, tmp_path: Path) -> None:
    registration, sigma_mm = tmp_path / "registration.json", 1.0
    generator = np.random.default_rng(112701)
    rested = scene.HEAD / 3 @ scene.TURN.T + scene.SHIFT

    def reading(frame: int) -> Recording:
        noise = generator.normal(0.0, sigma_mm, (300, *rested.shape))
        points = [PointReading(k, one) for k, seen in enumerate(rested + noise) for one in seen]
        return Recording("coarse", tuple(points if frame else points[: len(rested)]))

    once = tmp_path / "once.csv"
    once.write_text(write_csv(reading(0)))
    assert main(["register", str(markers), str(once), "--sigma-ots", f"{sigma_mm}", "-o", str(registration)]) == 0
    assert (
        movement(reading(1), read_registration(registration), SIGMA_OTS_MM) == "300 of 300 frames: nothing moved"
    )


def test_track_without_a_server_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    assert main(["track", "--port", str(port), "--seconds", "1"]) == 1
    assert "no OpenIGTLink server" in capsys.readouterr().err
