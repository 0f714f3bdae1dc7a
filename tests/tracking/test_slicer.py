"""Slicer's markups are taken at their word: system, unit and types."""

import json
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.geometry import Frame
from ronnaplan.tracking import read_recording
from ronnaplan.tracking.recording import OTS
from tests.tracking.files import MARKUPS, written


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


@pytest.mark.parametrize(
    ("kind", "called"),
    [
        ("Line", "lines"),
        ("Plane", "planes"),
        ("ROI", "boxes"),
        ("ClosedCurve", "curves"),
        ("GridSurface", "markups of other types"),
    ],
)
def test_what_is_no_list_of_points_is_left_out_and_told(tmp_path: Path, kind: str, called: str) -> None:
    """The ends of a trajectory were two markers more, and so were the corners of a plane."""
    ends = [{"label": "L-1", "position": [7, 8, 9]}, {"label": "L-2", "position": [70, 8, 9]}]
    document = json.loads(MARKUPS)
    document["markups"].append({"type": kind, "coordinateSystem": "LPS", "controlPoints": ends})
    recording = read_recording(written(tmp_path, "m.mrk.json", json.dumps(document)))
    assert [one.label for one in recording.points] == ["F"]
    assert recording.notes == (f"{called} that are not read: 1",)


def test_what_slicer_saves_is_not_in_the_trackers_own_frame(tmp_path: Path) -> None:
    """Slicer takes what a tracker sends for RAS, so that x and y have the other sign than in the poses of its tools."""
    fcsv = "# CoordinateSystem = LPS\n# columns = id,x,y,z,ow,label\n1,1,2,3,0,F-1\n"
    for name, text in (("m.mrk.json", MARKUPS), ("m.fcsv", fcsv), ("m.csv", "label,r,a,s\nF,1,2,3\n")):
        assert read_recording(written(tmp_path, name, text)).frame == Frame("LPS") != OTS


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


def test_a_document_of_this_program_in_the_place_of_readings_is_called_so(tmp_path: Path) -> None:
    """`register fiducials.json fiducials.json` said that a Slicer file lacks its markups."""
    path = written(tmp_path, "fiducials.json", '{"format": "ronnaplan.fiducials", "version": 1, "fiducials": []}')
    with pytest.raises(InputError, match=r"is a document of this program \(ronnaplan.fiducials\); expected what"):
        read_recording(path)


def test_an_fcsv_that_names_two_systems_is_refused(tmp_path: Path) -> None:
    text = "# CoordinateSystem = LPS\n# CoordinateSystem = RAS\n# columns = id,x,y,z,label\n1,1,2,3,F\n"
    with pytest.raises(InputError, match="each once"):
        read_recording(written(tmp_path, "m.fcsv", text))


def test_an_fcsv_in_voxels_is_refused_by_its_system(tmp_path: Path) -> None:
    text = "# CoordinateSystem = 2\n# columns = id,x,y,z,label\n1,1,2,3,F\n"
    with pytest.raises(InputError, match=r"CoordinateSystem = 2; expected RAS or LPS"):
        read_recording(written(tmp_path, "m.fcsv", text))


COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"


def test_the_two_columns_that_slicer_5_does_not_name_say_whether_a_point_is_set(tmp_path: Path) -> None:
    text = f"# Markups fiducial file version = 5.2\n# CoordinateSystem = LPS\n# columns = {COLUMNS}\n"
    for status, ending in enumerate((",0,0", ",1,0", ",2,0", "\r,2,0", ",3,0", ",9,0", "")):
        text += f"{status + 1},1,2,{status},0,0,0,1,1,1,0,F-{status + 1},,{ending}\n"
    points = read_recording(written(tmp_path, "m.fcsv", text)).points
    said = ["undefined", "preview", "ok", "ok", "missing", "position status 9", "ok"]
    assert [point.status for point in points] == said
    np.testing.assert_array_equal(points[3].position_mm, [1, 2, 3])


@pytest.mark.parametrize("ending", [",2", ",2,0,0"])
def test_other_cells_beyond_the_columns_of_an_fcsv_are_refused(tmp_path: Path, ending: str) -> None:
    text = f"# CoordinateSystem = LPS\n# columns = {COLUMNS}\n1,1,2,3,0,0,0,1,1,1,0,F-1,,{ending}\n"
    with pytest.raises(InputError, match="cells under"):
        read_recording(written(tmp_path, "m.fcsv", text))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("label;r;a;s\nF-1;-1,234;2.5;3\n", "numbers -1,234 and 2.5; expected a comma or a point"),
        ("label,l (m),p (m),s (m)\nF-1,1,2,3\n", r"column 'l \(m\)'; expected it in mm"),
        ("label,r,a,s\n,m,m,m\nF-1,1,2,3\n", "says 'm' right below its column r, .*; expected mm"),
    ],
)
def test_a_table_of_control_points_is_in_mm_with_one_decimal_sign(tmp_path: Path, text: str, says: str) -> None:
    """A place 1.2 m away was read as 1.2 mm."""
    with pytest.raises(InputError, match=says):
        read_recording(written(tmp_path, "points.csv", text))


@pytest.mark.parametrize(("axes", "sign"), [("l,p,s", 1), ("r,a,s", -1)])
def test_a_table_of_control_points_names_its_coordinates_by_its_columns(
    tmp_path: Path, axes: str, sign: int
) -> None:
    text = (
        f"label,{axes},defined,selected,visible,locked,description\n"
        "F-1,79.3014,17.4631,-10.2143,1,1,0,0,\n"
        "F-2,0,0,0,0,1,1,0,\n"
    )
    first, second = read_recording(written(tmp_path, "points.csv", text)).points
    assert (first.label, first.usable) == ("F-1", True)
    np.testing.assert_allclose(first.position_mm, [sign * 79.3014, sign * 17.4631, -10.2143])
    assert second.status == "undefined"
