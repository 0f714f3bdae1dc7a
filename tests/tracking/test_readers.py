"""Readings files of every kind: what they say is read, and what is doubtful is kept with its reason."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.tracking import PointReading, Recording, ToolReading, read_recording
from ronnaplan.tracking.csv_file import write_csv


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def turned(k: int) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0.1 * k, 0.5, -0.3]).as_matrix()
    matrix[:3, 3] = 10 * k, -20, -1500
    return matrix


def matrix_rows(first: int, rows: int) -> str:
    names = [f"m{r}{c}" for r in range(first, first + rows) for c in range(first, first + 4)]
    lines = [
        f"{1378476416922755200 + k * 10**9}," + ",".join(map(repr, turned(k)[:rows].ravel().tolist()))
        for k in range(3)
    ]
    return "\n".join(["timestamp_ns," + ",".join(names), *lines])


def test_csv_columns_are_found_by_name_and_bad_rows_are_kept_with_a_reason(tmp_path: Path) -> None:
    text = (
        "Sigma_mm,Z [mm],label,X [mm],Y [mm],frame,status\n0.2,3,A,1,2,7,\n0.2,,B,1,2,7,\n0.2,6,C,4,5,7,Missing\n"
    )
    recording = read_recording(written(tmp_path, "r.csv", text))
    np.testing.assert_array_equal(recording.points[0].position_mm, [1, 2, 3])
    assert [(p.label, p.frame, p.sigma_mm, p.usable) for p in recording.points] == [
        ("A", 7, 0.2, True),
        ("B", 7, 0.2, False),
        ("C", 7, 0.2, False),
    ]
    assert recording.flagged() == {"no position": 1, "missing": 1}


def test_damaged_numbers_are_flagged_not_used(tmp_path: Path) -> None:
    bad = (
        *("1,2,3,-1", "1e300,2,3,0.1", "1,inf,3,0.1", "1e12,2,3,0.1", "1_0,2,3,0.1", "1,\u0664,3,0.1", "9" * 400),
        *(
            "1\x1c,2,3,0.1",
            "1,\x1e.5,3,0.1",
            "1,2,\xa03,0.1",
            "1,2,3,0.1\x1f",
        ),  # a bit of a digit's was turned over
    )
    text = "\n".join(["x,y,z,sigma", *bad, "1,2,3,0.1"])
    recording = read_recording(written(tmp_path, "r.csv", text))
    assert [point.usable for point in recording.points] == [False] * len(bad) + [True]
    assert "sigma is '-1' mm" in recording.flagged()


@pytest.mark.parametrize(
    ("name", "cell"),
    [
        ("sigma", "0,1mm"),
        ("sigma", "0"),
        ("state", "Missing"),
        ("Valid", "false"),
        ("visible", "0"),
        ("status", "lost"),
    ],
)
def test_what_a_row_says_against_its_reading_is_heard(tmp_path: Path, name: str, cell: str) -> None:
    text = f"label;x;y;z;{name}\nA;1;2;3;{cell}\nB;1;2;3;\n"
    assert [point.usable for point in read_recording(written(tmp_path, "r.csv", text)).points] == [False, True]
    header, first, second, _ = matrix_rows(0, 3).split("\n")
    text = f"{header},{name}\n{first},{cell.replace(',', '.')}\n{second},\n"
    tools = read_recording(written(tmp_path, "r.csv", text)).tools
    assert [tool.usable for tool in tools] == [name == "sigma", True]


def test_semicolons_with_decimal_commas_and_a_byte_order_mark(tmp_path: Path) -> None:
    recording = read_recording(written(tmp_path, "r.csv", "\ufefflabel;x;y;z\nA;1,5;-2,25;3\n"))
    np.testing.assert_array_equal(recording.points[0].position_mm, [1.5, -2.25, 3])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x,y,z,unit\n1,2,3,mm\n1,2,3,m\n", "row 2 below the header says its unit is 'm'"),
        ("x,y,z,Units\n1,2,3,inch\n", "unit is 'inch'"),
        ("x,y,z,length_unit\n1,2,3,cm\n", "unit is 'cm'"),
        ("x,y,z,frame\n1,2,3,1.5\n", "frame number '1.5'"),
        ("x,y,z,frame\n1,2,3,1e300\n", "frame number '1e300'"),
        ("x,y,z,frame\n1,2,3,1\n1,2,3,l2\n", "the frames 1, l2"),
        ("state,tx,ty,tz,frame\nOK,1,2,3,l2\n", "frame number 'l2'"),
        ("x,y,z,coordinate_system\n1,2,3,RAS\n1,2,3,LPS\n", "the frames LPS, RAS"),
        ("x,y,z,sigma_x,sigma_y,sigma_z\n1,2,3,1,1,9\n", "expected one sigma"),
        (matrix_rows(0, 3).replace("m03", "m03 [m]"), r"m03 \[m\]"),
        ("x,y,z,frame\n1,2,3," + "9" * 5000 + "\n", "expected a whole number or a name"),
        ("x,y,z,kind\n1,2,3,pose\n", "the kind 'pose'"),
        ("x,y,z\n11,5,22,0,30,1\n", "decimal comma"),
        ("x,y,z,X [mm]\n1,2,3,4\n", "more than one column named x"),
        ("x (cm),y (cm),z (cm)\n1,2,3\n", r"x \(cm\)"),
        ("x [m],y,z\n1,2,3\n", r"x \[m\]"),
        ("x,y,z,sigma_um\n1,2,3,100\n", "sigma_um"),
        ("x cm,y,z\n1,2,3\n", "x cm"),
        ("x,y,z,time (ms)\n1,2,3,4\n", r"time \(ms\)"),
    ],
)
def test_columns_that_could_be_taken_for_others_are_refused(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_recording(written(tmp_path, "r.csv", text))


@pytest.mark.parametrize("table", ["x,y,z,frame\n1,2,3,{}\n", "state,tx,ty,tz,frame\nOK,1,2,3,{}\n"])
def test_a_frame_number_is_the_one_that_is_written_or_refused(tmp_path: Path, table: str) -> None:
    largest = 2**53 - 1
    for known in (largest, -largest):
        recording = read_recording(written(tmp_path, "r.csv", table.format(known)))
        assert [one.frame for one in recording.points] + [one.frame for one in recording.tools] == [known]
    for beyond in (2**53, 2**53 + 1, -(2**53), -(2**53) - 1):  # 2**53 + 1 is 2**53 as a float
        with pytest.raises(InputError, match=f"frame number '{beyond}'"):
            read_recording(written(tmp_path, "r.csv", table.format(beyond)))


def test_empty_cells_behind_the_last_column_are_nothing(tmp_path: Path) -> None:
    recording = read_recording(written(tmp_path, "r.csv", "x,y,z\n1,2,3,, \n"))
    np.testing.assert_array_equal(recording.points[0].position_mm, [1, 2, 3])


def test_csv_of_two_coordinate_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FrameMismatchError, match="OTS, R"):
        read_recording(written(tmp_path, "r.csv", "frame,x,y,z\nOTS,1,2,3\nR,4,5,6\n"))
    assert read_recording(written(tmp_path, "r.csv", "frame,x,y,z\nR,1,2,3\n")).frame.name == "R"


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    first = read_recording(
        written(
            tmp_path,
            "r.csv",
            "frame,time_s,label,x,y,z,q0,qx,qy,qz,sigma,status\n0,1.25,A,0.1,2,3,,,,,0.17,ok\n1,,,,2,3,,,,,,missing\n"
            "0,1.5,probe,1,2,3,0.5,0.5,-0.5,0.5,,ok\n1,1.6,probe,,,,,,,,,no pose\n2,1.7,probe,,,,,,,,,missing\n",
        )
    )
    again = read_recording(written(tmp_path, "again.csv", write_csv(first)))
    assert write_csv(again) == write_csv(first)
    assert len(again.points) == 2
    assert [tool.usable for tool in again.tools] == [True, False, False]
    np.testing.assert_allclose(again.poses("probe")[0][:3, 3], [1, 2, 3])


NDI = (
    "#Tools,ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,#Markers,State,Tx,Ty,Tz\n"
    "1,8700339 s/n:1,100,0A,0,OK,0.5,0.5,0.5,0.5,10,20,-1000,0.12,4,"
    "OK,1,2,3,OK,4,5,6,Missing,,,,OutOfVolume,7,8,9\n"
    "1,8700339 s/n:1,101,0A,0,Missing,,,,,,,,,4,OK,1,2,3,OK,4,5,6,OK,7,8,9,OK,1,1,1\n"
)


def test_ndi_combined_api_csv(tmp_path: Path) -> None:
    recording = read_recording(written(tmp_path, "ndi.csv", NDI))
    assert [(t.frame, t.status, t.error_mm) for t in recording.tools] == [
        (100, "ok", 0.12),
        (101, "missing", None),
    ]
    expected = Rotation.from_quat([0.5, 0.5, 0.5, 0.5]).as_matrix()
    np.testing.assert_allclose(recording.poses(recording.tool_names[0])[0][:3, :3], expected, atol=1e-12)
    assert [p.status for p in recording.points] == ["ok", "ok", "missing", "outofvolume", "ok", "ok", "ok", "ok"]
    np.testing.assert_array_equal(recording.points[5].position_mm, [4, 5, 6])


def test_ndi_columns_are_found_by_name_for_several_tools_and_strays(tmp_path: Path) -> None:
    tool = "Port,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"
    text = (
        f"Tools,{tool},{tool},Stray markers,State,Tx,Ty,Tz,State,Tx,Ty,Tz\n"
        "2,Port 1,5,0,OK,1,0,0,0,1,2,3,0.1,Port 2,5,0,OK,1,0,0,0,4,5,6,0.1,2,OK,7,8,9,Missing,,,\n"
    )
    recording = read_recording(written(tmp_path, "tools.csv", text))
    assert recording.tool_names == ("Port 1", "Port 2")
    np.testing.assert_array_equal(recording.poses("Port 2")[0][:3, 3], [4, 5, 6])
    assert [p.label for p in recording.points if p.usable] == [""]
    np.testing.assert_array_equal(recording.points[0].position_mm, [7, 8, 9])


@pytest.mark.parametrize(("system", "sign"), [("LPS", 1), ("RAS", -1)])
def test_slicer_markups_are_read_in_lps(tmp_path: Path, system: str, sign: int) -> None:
    points = [
        {"label": "F-1", "position": [1.0, 2.0, 3.0], "positionStatus": "defined"},
        {"label": "F-2", "position": [0.0, 0.0, 0.0], "positionStatus": "undefined"},
    ]
    document = {"markups": [{"type": "Fiducial", "coordinateSystem": system, "controlPoints": points}]}
    recording = read_recording(written(tmp_path, "m.mrk.json", json.dumps(document)))
    np.testing.assert_array_equal(recording.points[0].position_mm, [sign * 1, sign * 2, 3])
    assert recording.points[1].status == "undefined"
    code = {"LPS": "1", "RAS": "0"}[system]
    fcsv = f"# Markups fiducial file version = 4.11\n# CoordinateSystem = {code}\n# columns = id,x,y,z,ow,label\n"
    recording = read_recording(written(tmp_path, "m.fcsv", fcsv + "1,1,2,3,0,F-1\n"))
    np.testing.assert_array_equal(recording.points[0].position_mm, [sign * 1, sign * 2, 3])
    assert recording.points[0].label == "F-1"


def sequence(frames: list[tuple[str, str]]) -> str:
    lines = ["ObjectType = Image", "NDims = 3", "DimSize = 1 1 2", "ElementType = MET_UCHAR"]
    for k, (matrix, status) in enumerate(frames):
        lines += [
            f"Seq_Frame{k:04d}_StylusToTrackerTransform = {matrix}",
            f"Seq_Frame{k:04d}_StylusToTrackerTransformStatus = {status}",
            f"Seq_Frame{k:04d}_Timestamp = {0.05 * k}",
        ]
    return "\n".join([*lines, "ElementDataFile = LOCAL", ""])


def test_metaimage_sequence_keeps_invalid_transforms_flagged(tmp_path: Path) -> None:
    good, mirrored = "1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1", "-1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1"
    nan = good.replace("5", "nan")
    text = sequence([(good, "OK"), (good, "INVALID"), (mirrored, "OK"), (nan, "OK"), ("1 2", "OK")])
    path = tmp_path / "s.mha"
    path.write_bytes(text.encode() + b"\xff\x00")
    recording = read_recording(path)
    assert [tool.usable for tool in recording.tools] == [True, False, False, False, False]
    assert recording.tools[1].status == "invalid"
    assert "left-handed" in recording.tools[2].status
    np.testing.assert_array_equal(recording.poses("StylusToTracker")[0][:3, 3], [5, 6, 7])
    assert recording.tools[4].time_s == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("r.csv", "A,1,2,3\nB,4,5,6\n", "no header"),
        ("r.csv", "label,x,y\nA,1,2\n", "no z"),
        ("r.csv", "", "empty"),
        ("m.mrk.json", "{}", "not a Slicer markups"),
        ("m.mrk.json", "[", "not a Slicer markups"),
        ("m.mrk.json", '{"markups": [{"controlPoints": []}]}', r"markups\.0\.coordinateSystem: Field required"),
        ("m.fcsv", "1,2,3,4\n", "header"),
        ("s.mha", "ObjectType = Image\nElementDataFile = LOCAL\n", "no Seq_Frame"),
        ("s.mha", "not a header", "not a MetaImage"),
    ],
)
def test_a_file_that_is_no_recording_is_named(tmp_path: Path, name: str, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_recording(written(tmp_path, name, text))


@pytest.mark.parametrize("name", ["r.csv", "r.mha", "r.nrrd", "r.mrk.json", "r.fcsv"])
def test_a_missing_file_is_named_and_a_pipe_is_not_waited_for(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        read_recording(tmp_path / name)
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match="no regular file"):
        read_recording(tmp_path / name)


def test_a_binary_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(b"\x80\xfe\x00\x81")
    with pytest.raises(InputError, match="not a text file"):
        read_recording(path)


def test_readings_of_every_kind_come_back_from_csv_as_they_were(tmp_path: Path) -> None:
    points = (
        PointReading(3, np.array([0.1, 1 / 3, -1000.0]), "=A", 1.5, 0.2),
        PointReading(4, np.full(3, np.nan), "'n", status="missing"),
    )
    tools = (
        ToolReading(0, "probe", None, 0.5, None, "no pose: it has 2 numbers; expected 16"),
        ToolReading(1, "never seen", None, status="missing"),
        ToolReading(2, "probe", np.eye(4), 0.75, 0.11),
    )
    again = read_recording(written(tmp_path, "r.csv", write_csv(Recording("test", points, tools))))
    for first, second in zip((*points, *tools), (*again.points, *again.tools), strict=True):
        for name, value in vars(first).items():
            np.testing.assert_equal(getattr(second, name), value)


def test_names_from_a_file_cannot_steer_a_terminal(tmp_path: Path) -> None:
    recording = read_recording(
        written(tmp_path, "r.csv", "label,x,y,z,status\n\x1b]0;owned\x07A\u2028B,1,2,3,\x1b[2J\n")
    )
    assert recording.points[0].label == r"\x1b]0;owned\x07A\u2028B"
    assert recording.flagged() == {r"\x1b[2j": 1}


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_csv_as_a_spreadsheet_saves_it_in_utf_16(tmp_path: Path, encoding: str) -> None:
    text = "label;x;y;z\r\nÅ;1,5;-2;3\r\n"
    if encoding != "utf-16":
        text = "\ufeff" + text
    path = tmp_path / "r.csv"
    path.write_bytes(text.encode(encoding))
    (point,) = read_recording(path).points
    assert (point.label, point.position_mm.tolist()) == ("Å", [1.5, -2, 3])


@pytest.mark.parametrize(("first", "rows"), [(0, 4), (0, 3), (1, 4)])
def test_rows_of_matrices_are_poses(tmp_path: Path, first: int, rows: int) -> None:
    recording = read_recording(written(tmp_path, "poses.csv", matrix_rows(first, rows)))
    np.testing.assert_allclose(recording.poses("tool"), [turned(k) for k in range(3)], atol=1e-12)
    assert [tool.frame for tool in recording.tools] == [0, 1, 2]
    assert recording.tools[1].time_s == pytest.approx(1378476417.9227552, abs=1e-6)
    assert recording.notes == ()


def test_matrices_by_columns_are_flagged_not_turned_round(tmp_path: Path) -> None:
    names = ",".join(f"m{r}{c}" for r in range(4) for c in range(4))
    numbers = ",".join(map(repr, turned(1).T.ravel().tolist()))
    (tool,) = read_recording(written(tmp_path, "poses.csv", f"{names}\n{numbers}\n")).tools
    assert "is it transposed" in tool.status


def plus(matrix: np.ndarray) -> str:
    return " ".join(f"{value:.6g}" for value in matrix.ravel())


@pytest.mark.parametrize("suffix", [".mha", ".nrrd"])
def test_matrices_that_are_nearly_rotations_are_read_as_the_nearest(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(3)
    true = [turned(k) for k in range(20)]
    rough = [matrix.copy() for matrix in true]
    for matrix in rough:
        matrix[:3, :3] += rng.uniform(-5e-4, 5e-4, (3, 3))
    scaled = true[0].copy()
    scaled[:3, :3] *= 1.002
    text = sequence([(plus(matrix), "OK") for matrix in (*rough, scaled)])
    if suffix == ".nrrd":
        text = as_nrrd(text)
    recording = read_recording(written(tmp_path, f"s{suffix}", text))
    poses = recording.poses("StylusToTracker")
    assert len(poses) == 20
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].swapaxes(1, 2), np.tile(np.eye(3), (20, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(poses, true, atol=1e-3)
    assert "not rigid" in recording.tools[-1].status
    assert recording.notes[0].startswith("2")
    assert "the nearest rotation was taken" in recording.notes[0]


def as_nrrd(text: str) -> str:
    fields = [line.replace(" = ", ":=") for line in text.splitlines() if line.startswith("Seq_Frame")]
    head = [
        "NRRD0004",
        "# a comment",
        "type: uchar",
        "dimension: 4",
        "sizes: 1 1 1 2",
        "kinds: domain domain domain list",
    ]
    return "\n".join([*head, "encoding: raw", *fields, "", "\0\0"])


def test_an_nrrd_sequence_is_read_as_its_metaimage_twin(tmp_path: Path) -> None:
    text = sequence([(plus(turned(1)), "OK"), (plus(turned(2)), "INVALID")])
    first = read_recording(written(tmp_path, "s.mha", text))
    second = read_recording(written(tmp_path, "s.seq.nrrd", as_nrrd(text)))
    assert [vars(tool).keys() for tool in first.tools] == [vars(tool).keys() for tool in second.tools]
    for one, other in zip(first.tools, second.tools, strict=True):
        np.testing.assert_equal(vars(one), vars(other))
    assert [tool.status for tool in second.tools] == ["ok", "invalid"]


@pytest.mark.parametrize("status", ["", " "])
def test_an_empty_status_calls_no_reading_good_nor_becomes_a_good_one(tmp_path: Path, status: str) -> None:
    text = sequence([(plus(turned(1)), "OK"), (plus(turned(2)), status)])
    first = read_recording(written(tmp_path, "s.mha", text))
    second = read_recording(written(tmp_path, "s.csv", write_csv(first)))
    for recording in (first, second):
        assert [(tool.usable, tool.status) for tool in recording.tools] == [(True, "ok"), (False, "no status")]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (f"Seq_Frame{'9' * 5000}_AToBTransform = 1", "expected Seq_Frame, a number"),
        ("Seq_Frame0000 AToBTransform = 1", "expected Seq_Frame, a number"),
        ("Seq_Frame0000_StylusToTrackerTransform = 1", "twice"),
        ("DistanceUnits = cm", "states lengths in cm"),
    ],
)
def test_frame_fields_that_cannot_be_understood_are_refused(tmp_path: Path, line: str, says: str) -> None:
    text = sequence([(plus(turned(1)), "OK")]).replace("ElementDataFile", f"{line}\nElementDataFile")
    with pytest.raises(InputError, match=says):
        read_recording(written(tmp_path, "s.mha", text))


def test_a_tool_of_any_name_is_read(tmp_path: Path) -> None:
    text = sequence([(plus(turned(1)), "OK")]).replace("StylusToTracker", "Stylus-1.aToTracker")
    assert read_recording(written(tmp_path, "s.mha", text)).tool_names == ("Stylus-1.aToTracker",)


POINT = '{"label": "F", "position": [1, 2, 3], "positionStatus": "defined"}'
MARKUPS = f'{{"markups": [{{"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": [{POINT}]}}]}}'


@pytest.mark.parametrize(
    ("there", "instead"),
    [
        ("[1, 2, 3]", '"123"'),
        ("[1, 2, 3]", '{"0": 1, "1": 2, "2": 3}'),
        ("[1, 2, 3]", '["1", 2, 3]'),
        ("[1, 2, 3]", "[true, 2, 3]"),
        ("[1, 2, 3]", "[1, 2]"),
        ("[1, 2, 3]", f"[{'9' * 400}, 2, 3]"),
        ("[1, 2, 3]", f"[{'9' * 5000}, 2, 3]"),
        ("[1, 2, 3]", "[1e999, 2, 3]"),
        ('"F"', "5"),
        ('"F"', '"\\ud800"'),
        ('"LPS"', '"LPS", "coordinateSystem": "RAS"'),
        ('"LPS"', '"LPS", "coordinateUnits": "cmm"'),
        ('"LPS"', '"LPS", "coordinateUnits": "m"'),
        ('"LPS"', '"LPS", "coordinateUnits": ["cm", "UCUM", "mm"]'),
        ('"LPS"', '"lps"'),
    ],
)
def test_markups_are_taken_at_their_word(tmp_path: Path, there: str, instead: str) -> None:
    read_recording(written(tmp_path, "m.mrk.json", MARKUPS))
    with pytest.raises(InputError, match="not a Slicer markups file"):
        read_recording(written(tmp_path, "m.mrk.json", MARKUPS.replace(there, instead)))


def test_markups_that_name_millimetres_by_their_code_are_read(tmp_path: Path) -> None:
    text = MARKUPS.replace('"LPS"', '"LPS", "coordinateUnits": ["mm", "UCUM", "millimeter"]')
    assert read_recording(written(tmp_path, "m.mrk.json", text)).points[0].position_mm.tolist() == [1, 2, 3]


def test_an_fcsv_that_names_two_systems_is_refused(tmp_path: Path) -> None:
    text = "# CoordinateSystem = LPS\n# CoordinateSystem = RAS\n# columns = id,x,y,z,label\n1,1,2,3,F\n"
    with pytest.raises(InputError, match="each once"):
        read_recording(written(tmp_path, "m.fcsv", text))


def test_a_pose_further_away_than_any_tracker_sees_is_flagged(tmp_path: Path) -> None:
    far = turned(1)
    far[0, 3] = 1e7
    (tool,) = read_recording(written(tmp_path, "s.mha", sequence([(plus(far), "OK")]))).tools
    assert "further away" in tool.status
