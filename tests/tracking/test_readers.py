"""Readings files of every kind: what they say is read, and what is doubtful is kept with its reason."""

import os
import time
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.tracking import find_markers, read_recording
from ronnaplan.tracking.fillers import flag_fillers
from ronnaplan.tracking.recording import PointReading, Recording
from ronnaplan.tracking.told import readings_told
from tests.tracking.files import written


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("r.csv", "A,1,2,3\nB,4,5,6\n", "no header"),
        ("r.csv", "label,x,y\nA,1,2\n", "no z"),
        ("r.csv", "", "empty"),
        ("m.mrk.json", "{}", "not a Slicer markups"),
        ("m.mrk.json", "[", "not a Slicer markups"),
        (
            "m.mrk.json",
            '{"markups": [{"type": "Line", "coordinateSystem": "LPS", "controlPoints": []}]}',
            "holds lines alone; expected a list of points",
        ),
        ("m.mrk.json", '{"markups": [{"controlPoints": []}]}', r"markups\.0\.coordinateSystem: Field required"),
        ("m.fcsv", "1,2,3,4\n", "header"),
        ("s.mha", "ObjectType = Image\nElementDataFile = LOCAL\n", "no Seq_Frame"),
        ("s.mha", "not a header", "not a MetaImage"),
    ],
)
def test_a_file_that_is_no_recording_is_named(tmp_path: Path, name: str, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_recording(written(tmp_path, name, text))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
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


def test_names_from_a_file_cannot_steer_a_terminal(tmp_path: Path) -> None:
    recording = read_recording(
        written(tmp_path, "r.csv", "label,x,y,z,status\n\x1b]0;owned\x07A\u2028B,1,2,3,\x1b[2J\n")
    )
    assert recording.points[0].label == r"\x1b]0;owned\x07A\u2028B"
    assert recording.flagged() == {r"\x1b[2j": 1}


def test_lines_may_end_as_on_an_old_mac(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(b"label,x,y,z\rA,1,2,3\rB,4,5,6\r")
    assert [point.label for point in read_recording(path).points] == ["A", "B"]


@pytest.mark.parametrize(
    "text",
    [
        "tool,frame,x,y,z,q0,qx,qy,qz\nT,7,8,0,0,1,0,0,0\nT,,9,0,0,1,0,0,0\nT,9,9,9,9,2,0,0,0\n",
        "tool,frame,m00,m01,m02,m03,m10,m11,m12,m13,m20,m21,m22,m23\n"
        "T,7,1,0,0,8,0,1,0,0,0,0,1,0\nT,n/a,1,0,0,9,0,1,0,0,0,0,1,0\nT,9,1,0,0,9,0,1,0,9,0,0,2,9\n",
    ],
)
def test_a_pose_without_a_number_among_numbered_ones_is_flagged(tmp_path: Path, text: str) -> None:
    seen, unnumbered, none = read_recording(written(tmp_path, "r.csv", text.replace("tool,", "label,", 1))).tools
    assert (seen.frame, seen.status) == (7, "ok")
    assert unnumbered.status == "no frame number"
    assert (none.frame, none.status.startswith("no pose")) == (9, True)


@pytest.mark.parametrize("label", ["A", ""])
@pytest.mark.parametrize("unseen", range(1, 10, 2))
@pytest.mark.parametrize("filler", ["0,0,0", "-9999.0,-9999.0,-9999.0"])
def test_what_is_filled_in_for_a_marker_that_is_not_seen_is_no_place(
    tmp_path: Path, filler: str, unseen: int, label: str
) -> None:
    """Where most frames held it the marker stood there, and nothing said so."""
    rows = [f"{k},{label},{filler if k < unseen else f'55.0{k},30.1,-1050.2'}\n" for k in range(10)]
    rows += [f"{k},{label and 'B'},-60.0{k},20.0,-1040.0\n" for k in range(10)]
    path = tmp_path / "readings.csv"
    path.write_text("frame,label,x,y,z\n" + "".join(rows))
    recording = read_recording(path)
    found = find_markers(recording)
    seen = {round(float(marker.position_mm[0])) for marker in found.markers}
    assert seen == ({55, -60} if label or unseen <= 5 else {-60})
    filled = [
        one for one in recording.points if one.status.endswith("as is filled in for a marker that is not seen")
    ]
    assert len(filled) == (unseen if unseen > 1 else 0), "one alone is an outlier"
    assert any("filled in" in note for note in readings_told(recording, found)) is (unseen > 1)


def test_a_marker_may_be_the_origin(tmp_path: Path) -> None:
    path = tmp_path / "readings.csv"
    rows = [f"{k},{x}\n" for k in range(5) for x in ("0,0,0", f"55.0{k},30.1,0")]
    path.write_text("frame,x,y,z\n" + "".join(rows))
    assert all(one.usable for one in read_recording(path).points)
    path.write_text("label,x,y,z\nA,0,0,0\nB,50,0,0\n")
    assert all(one.usable for one in read_recording(path).points)


def test_a_marker_on_the_diagonal_may_be_hidden_at_times(tmp_path: Path) -> None:
    """A corner of a cube in noiseless readings was taken for what is filled in where it was hidden in some frames."""
    path = tmp_path / "readings.csv"
    rows = [
        f"{k},{x}\n"
        for k in range(5)
        for x in ("100,100,100", "0,100,0", "100,0,0")
        if x != "100,100,100" or k % 2
    ]
    path.write_text("frame,x,y,z\n" + "".join(rows))
    assert all(one.usable for one in read_recording(path).points)


def test_thousands_of_places_on_the_diagonal_are_looked_through_in_linear_time() -> None:
    """Each was compared with all readings: a table of 100,000 rows took minutes."""
    began_s = time.process_time()
    points = [PointReading(k, np.full(3, k % 4_000 + 1.0)) for k in range(8_000)]
    flag_fillers(Recording("made", tuple(points)))
    assert time.process_time() - began_s < 2.0
