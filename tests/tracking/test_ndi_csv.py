"""Tables of NDI's own tools are read by their columns' names."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import InputError
from ronnaplan.tracking import read_recording
from tests.tracking.files import NDI, written


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


def test_a_pose_by_euler_angles_keeps_its_place_and_its_markers_theirs(tmp_path: Path) -> None:
    """Its last angle was taken for the status of a marker, and said to be why that does not count."""
    text = (
        "Tools,Port 1,Frame,Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz,State,Tx,Ty,Tz\n"
        "1,,5,0,OK,10,20,30,1,2,3,0.1,2,OK,7,8,9,OK,4,5,6\n1,,6,0,Missing,,,,,,,,2,OK,7,8,9,OK,4,5,6\n"
    )
    recording = read_recording(written(tmp_path, "euler.csv", text))
    assert [one.status for one in recording.tools] == ["a pose by Euler angles (record quaternions)", "missing"]
    assert not any(one.usable for one in recording.tools)
    assert [(one.label, one.status) for one in recording.points] == [("tool 1:1", "ok"), ("tool 1:2", "ok")] * 2


@pytest.mark.parametrize(
    "text",
    [
        "Frame,State,Tx,Ty,Tz\n1,OK,12,52,-29,20,-1617,94\n",
        "Frame,State,Tx,Ty,Tz,State,Tx,Ty,Tz\n1,OK,12,52,-29,20,-1617,94\n",
        "Frame,State,Tx,Ty,Tz\n1,OK,12,52,-29,20,-1617,94,OK,12,52,-29,20,-1617,94\n",
        "Frame,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz\n1,OK,1,00,0,00,0,00,0,00,12,52,-29,20,-1617,94\n",
    ],
)
def test_decimal_commas_between_commas_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"row 1 below the header .* decimal comma"):
        read_recording(written(tmp_path, "commas.csv", text))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("Frame,State,Qx,Qy,Qz,Q0,Tx,Ty,Tz\n1,OK,0,0,0.6,0.8,1,2,3\n", "qx, qy, qz, q0 of a rotation elsewhere"),
        ("Frame,State,Tx,Ty,Tz,Q0,Qx,Qy,Qz\n1,OK,1,2,3,0.8,0,0,0.6\n", "q0, qx, qy, qz of a rotation elsewhere"),
        ("Frame,State,Tx,Ty,Tz,Rx,Ry,Rz\n1,OK,1,2,3,10,20,30\n", "rx, ry, rz of a rotation elsewhere"),
        (
            "State,Rz,Ry,Rx,Tx,Ty,Tz,Q0,Qx,Qy,Qz\nOK,1,2,3,1,2,3,1,0,0,0\n",
            "q0, qx, qy, qz of a rotation elsewhere",
        ),
        ("Frame,State,q1,q2,q3,q4,Tx,Ty,Tz\n1,OK,0.8,0,0,0.6,1,2,3\n", "q4 before a tx; expected State before"),
        ("Tx,Ty,Tz,State\n1,2,3,Missing\n", "nothing before a tx; expected State before"),
    ],
)
def test_rotations_and_states_that_stand_elsewhere_are_refused(tmp_path: Path, text: str, says: str) -> None:
    """A tool was read as a marker, with a part of its rotation for a state, or with none."""
    with pytest.raises(InputError, match=says):
        read_recording(written(tmp_path, "tool.csv", text))


def test_angles_behind_a_tool_that_has_its_quaternion_are_no_reason_to_refuse_it(tmp_path: Path) -> None:
    text = "Frame,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Rz,Ry,Rx\n5,OK,0.8,0,0,0.6,1,2,3,0.1,73.7,0,0\n"
    (tool,) = read_recording(written(tmp_path, "tool.csv", text)).tools
    assert (tool.frame, tool.usable, tool.error_mm) == (5, True, 0.1)


def test_tools_in_rows_are_told_apart_by_their_names(tmp_path: Path) -> None:
    """Both were called tool 1."""
    text = "Frame Number,Tool Name,Status,Q0,Qx,Qy,Qz,Tx,Ty,Tz\n5,A,OK,1,0,0,0,1,2,3\n5,B,OK,1,0,0,0,4,5,6\n"
    recording = read_recording(written(tmp_path, "tools.csv", text))
    assert [(one.tool, one.frame) for one in recording.tools] == [("A", 5), ("B", 5)]
    assert recording.numbered


QUATERNION = "q0,qx,qy,qz,tx,ty,tz"
POSE = "0.5,0.5,0.5,0.5,10,20,-1000"


@pytest.mark.parametrize(
    ("header", "rows", "status"),
    [
        ("q0,qx,qy,qz,tx,ty,tz,status", (f"{POSE},missing", f"{POSE},ok"), "missing"),
        ("frame,q0,qx,qy,qz,tx,ty,tz,valid", (f"1,{POSE},0", f"2,{POSE},1"), "not valid"),
        ("visible,frame,q0,qx,qy,qz,tx,ty,tz", (f"no,1,{POSE}", f"yes,2,{POSE}"), "not visible"),
        ("status,valid,q0,qx,qy,qz,tx,ty,tz", (f"OK,0,{POSE}", f"OK,,{POSE}"), "not valid"),
        ("frame,tool_1_status,q0,qx,qy,qz,tx,ty,tz", (f"1,missing,{POSE}", f"2,ok,{POSE}"), "missing"),
        ("frame,q0,qx,qy,qz,tx,ty,tz,isValid", (f"1,{POSE},False", f"2,{POSE},True"), "not valid"),
        ("frame,qw,qx,qy,qz,x,y,z,tracked", (f"1,{POSE},0", f"2,{POSE},1"), "not tracked"),
    ],
)
def test_what_a_row_says_of_its_one_pose_is_heard_wherever_it_stands(
    tmp_path: Path, header: str, rows: tuple[str, str], status: str
) -> None:
    """The last pose of a tool that was hidden counted as a measured one."""
    recording = read_recording(written(tmp_path, "own.csv", "\n".join([header, *rows])))
    assert [one.status for one in recording.tools] == [status, "ok"]
    assert recording.notes == ()


def test_what_is_said_behind_several_tools_or_beside_a_marker_is_refused(tmp_path: Path) -> None:
    """A tool would count by what is said of the one before it."""
    tool = "q0,qx,qy,qz,tx,ty,tz,valid"
    for header in (f"{tool},{tool}", "state,tx,ty,tz,valid", "valid,state,tx,ty,tz"):
        path = written(tmp_path, "own.csv", f"{header}\n" + ",".join(["1"] * len(header.split(","))))
        with pytest.raises(InputError, match="has valid elsewhere than before a tool's pose or a marker's tx"):
            read_recording(path)


ONE = "q0,qx,qy,qz,tx,ty,tz"


@pytest.mark.parametrize(
    "header",
    [
        f"tool_1_status,tool_2_status,{ONE},{ONE}",
        f"{ONE},tool_1_status,{ONE}",
        f"{ONE},tool_1_status,{ONE},tool_2_status",
        f"tool_2_status,{ONE},tool_1_status,{ONE}",
        f"tool_1_status,{ONE},{ONE}",
        f"tool_2_status,{ONE},{ONE}",
        f"tool_1_status,tool_2_status,tool,{ONE}",
        "tool,qw,qx,qy,qz,x,y,z,pose1_valid,pose2_valid",
    ],
)
def test_what_is_said_of_a_tool_by_its_number_is_never_taken_for_another_tool_s(
    tmp_path: Path, header: str
) -> None:
    """Of a hidden tool's readings all counted, and the other one's were left out."""
    path = written(tmp_path, "own.csv", f"{header}\n" + ",".join(["1"] * len(header.split(","))))
    with pytest.raises(InputError, match="not each right before the pose of its own tool"):
        read_recording(path)


@pytest.mark.parametrize("first", [0, 1])
def test_each_tool_s_own_status_counts_before_its_pose(tmp_path: Path, first: int) -> None:
    header = f"tool_{first}_status,{ONE},tool_{first + 1}_status,{ONE}"
    recording = read_recording(written(tmp_path, "own.csv", f"{header}\nok,{POSE},missing,{POSE}\n"))
    assert [one.status for one in recording.tools] == ["ok", "missing"]


@pytest.mark.parametrize("name", ["visible", "is_valid", "status"])
def test_what_stands_between_two_poses_and_before_none_is_refused(tmp_path: Path, name: str) -> None:
    """It may be of the tool before it or of the one behind."""
    path = written(tmp_path, "own.csv", f"{ONE},{name},{ONE}\n{POSE},0,{POSE}\n")
    with pytest.raises(InputError, match="elsewhere than before a tool's pose"):
        read_recording(path)


def test_a_state_before_the_first_of_several_tools_is_that_of_all_that_have_none(tmp_path: Path) -> None:
    tool = "q0,qx,qy,qz,tx,ty,tz"
    text = f"state,{tool},{tool},state,{tool}\nmissing,{POSE},{POSE},OK,{POSE}\n"
    recording = read_recording(written(tmp_path, "own.csv", text))
    assert [one.status for one in recording.tools] == ["missing", "missing", "ok"]


@pytest.mark.parametrize("header", ["frame,label,POSE", "frame,marker,POSE", "frame,POSE,tool"])
def test_a_row_of_one_pose_names_its_tool_in_any_column_of_names(tmp_path: Path, header: str) -> None:
    """Two tools were one."""
    cells = header.replace("label", "{0}").replace("marker", "{0}").replace("tool", "{0}").replace("frame", "1")
    rows = [cells.replace("POSE", POSE).format(name) for name in "AB"]
    text = "\n".join([header.replace("POSE", "q0,qx,qy,qz,tx,ty,tz"), *rows])
    assert read_recording(written(tmp_path, "own.csv", text)).tool_names == ("A", "B")


def test_a_name_before_two_poses_is_that_of_the_first_alone(tmp_path: Path) -> None:
    """Both were readings of one tool, in one frame."""
    text = f"frame,tool,{QUATERNION},{QUATERNION}\n1,A,{POSE},{POSE}\n"
    assert read_recording(written(tmp_path, "own.csv", text)).tool_names == ("A", "tool 2")


@pytest.mark.parametrize("word", ["Visible", "Tracked", "Good"])
def test_a_tool_that_a_table_calls_seen_in_another_word_than_ok_counts(tmp_path: Path, word: str) -> None:
    """As in a table of x, y, z; of NDI's columns no pose counted, each for being 'visible'."""
    text = f"frame,tool,status,q0,qx,qy,qz,tx,ty,tz\n1,a,{word},1,0,0,0,1,2,3\n2,a,Missing,1,0,0,0,1,2,3\n"
    recording = read_recording(written(tmp_path, "tool.csv", text))
    assert [one.status for one in recording.tools] == ["ok", "missing"]


@pytest.mark.parametrize("name", ["label", "marker"])
def test_a_label_before_each_of_several_poses_names_it(tmp_path: Path, name: str) -> None:
    """They were tool 1 and tool 2, whichever tool a row had first."""
    text = f"frame,{name},{QUATERNION},{name},{QUATERNION}\n1,A,{POSE},B,{POSE}\n2,B,{POSE},A,{POSE}\n"
    recording = read_recording(written(tmp_path, "own.csv", text))
    assert [one.tool for one in recording.tools] == ["A", "B", "B", "A"]
    assert recording.notes == ()


@pytest.mark.parametrize(
    "pose",
    [
        (QUATERNION, POSE),
        ("q0,qx,qy,qz,x,y,z", POSE),
        ("m00,m01,m02,m03,m10,m11,m12,m13,m20,m21,m22,m23", "0,-1,0,5,1,0,0,5,0,0,1,5"),
    ],
)
@pytest.mark.parametrize("name", ["TransformStatus", "Transform Status"])
def test_a_transform_status_counts_in_every_table_of_poses(
    tmp_path: Path, pose: tuple[str, str], name: str
) -> None:
    """Where it stood beside x, y, z or a matrix the last pose of a hidden tool counted as a measured one."""
    header, cells = pose
    rows = (f"{said},{cells}" for said in ("INVALID", "Enabled", "OK", ""))
    recording = read_recording(written(tmp_path, "own.csv", "\n".join([f"{name},{header}", *rows])))
    assert [one.status for one in recording.tools] == ["invalid", "ok", "ok", "ok"]
    assert recording.notes == ()


def test_columns_that_are_not_read_are_told(tmp_path: Path) -> None:
    own = f"frame,id,q0,qx,qy,qz,tx,ty,tz,quality\n1,3,{POSE},7\n"
    recording = read_recording(written(tmp_path, "own.csv", own))
    assert recording.notes == ("columns that are not read: id, quality",)
    assert read_recording(written(tmp_path, "ndi.csv", NDI)).notes == ()
