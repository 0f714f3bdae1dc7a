"""Readings files of every kind: what they say is read, and what is doubtful is kept with its reason."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.tracking import read_recording
from ronnaplan.tracking.csv_file import write_csv


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


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
    text = "x,y,z,sigma\n1,2,3,-1\n1e300,2,3,0.1\n1,inf,3,0.1\n1e12,2,3,0.1\n1,2,3,0.1\n"
    recording = read_recording(written(tmp_path, "r.csv", text))
    assert [point.usable for point in recording.points] == [False, False, False, False, True]
    assert "sigma is -1 mm" in recording.flagged()


def test_semicolons_with_decimal_commas_and_a_byte_order_mark(tmp_path: Path) -> None:
    recording = read_recording(written(tmp_path, "r.csv", "\ufefflabel;x;y;z\nA;1,5;-2,25;3\n"))
    np.testing.assert_array_equal(recording.points[0].position_mm, [1.5, -2.25, 3])


@pytest.mark.parametrize(
    ("text", "says"),
    [
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
            "0,1.5,probe,1,2,3,0.5,0.5,-0.5,0.5,,ok\n1,1.6,probe,,,,,,,,,no pose\n",
        )
    )
    again = read_recording(written(tmp_path, "again.csv", write_csv(first)))
    assert write_csv(again) == write_csv(first)
    assert len(again.points) == 2
    assert [tool.usable for tool in again.tools] == [True, False]
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
        ("m.mrk.json", '{"markups": [{"controlPoints": []}]}', "coordinateSystem is absent"),
        ("m.fcsv", "1,2,3,4\n", "header"),
        ("s.mha", "ObjectType = Image\nElementDataFile = LOCAL\n", "no Seq_Frame"),
        ("s.mha", "not a header", "not a MetaImage"),
    ],
)
def test_a_file_that_is_no_recording_is_named(tmp_path: Path, name: str, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_recording(written(tmp_path, name, text))


@pytest.mark.parametrize("name", ["absent.csv", "absent.mha", "absent.mrk.json", "absent.fcsv"])
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_recording(tmp_path / name)


def test_a_binary_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="not a text file"):
        read_recording(path)
