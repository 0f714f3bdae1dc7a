"""Tables of readings: columns are found by name, and what is doubtful is kept with its reason."""

from pathlib import Path

import numpy as np
import pytest

from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.tracking import PointReading, Recording, ToolReading, read_recording
from ronnaplan.tracking.csv_file import write_csv
from tests.tracking.files import AWAY, matrix_rows, written


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


@pytest.mark.parametrize("cell", ['"-1,650.5"', "-1\u2019650.5", "-1\u202f650.5", "\u22121650.5", "near"])
def test_a_number_that_is_written_otherwise_is_told_from_one_that_is_not_there(tmp_path: Path, cell: str) -> None:
    """Both were 'no position', with the advice to record again what a spreadsheet had written with separators."""
    table = f"x,y,z\n1,2,{cell}\n1,2,\n1,2,NaN\n1,2,-1650500000\n"
    told = read_recording(written(tmp_path, "r.csv", table)).flagged()
    plain = "a coordinate that is no plain number, such as -1234.5"
    assert told == {plain: 1, "no position": 2, "no position within a kilometre": 1}


def test_a_decimal_comma_in_quotes_is_named(tmp_path: Path) -> None:
    """It was no plain number: a spreadsheet shows 1650,5 and quotes it between commas."""
    table = 'x,y,z\n1,2,"-1650,5"\n"1,5","2,5","3,5"\n'
    told = read_recording(written(tmp_path, "r.csv", table)).flagged()
    assert told == {
        "a coordinate with a comma, a decimal one only where ';' or a tab stands between the columns": 2
    }


@pytest.mark.parametrize("unit", ["mm", "[mm]", "Millimeters", "millimètres", "milímetros"])
def test_a_row_of_units_is_no_reading(tmp_path: Path, unit: str) -> None:
    table = f"label,x (millimetres),y,z\n,{unit},{unit},{unit}\nA,1,2,3\nB,mm,mm,mm\n"
    read = read_recording(written(tmp_path, "r.csv", table))
    assert [(point.label, point.usable) for point in read.points] == [("A", True), ("B", False)]


def test_words_for_what_was_not_seen_are_no_units(tmp_path: Path) -> None:
    """Also in the first frame: they stand further below, too, and numbers beside them are none of a row of units."""
    table = "label,x,y,z\nA,hidden,hidden,hidden\nB,1,2,3\nA,hidden,hidden,hidden\n"
    read = read_recording(written(tmp_path, "r.csv", table))
    assert [point.usable for point in read.points] == [False, True, False]
    read = read_recording(written(tmp_path, "s.csv", "label,x,y,z\nA,hidden,2,3\nB,1,2,3\n"))
    assert [point.usable for point in read.points] == [False, True]


@pytest.mark.parametrize(
    "table",
    [
        "label,x,y,z\nA,occluded,occluded,occluded\nB,1,2,3\n",
        "x,y,z,status\nlost,lost,lost,Missing\n1,2,3,OK\n",
        "x;y;z;time\nlost;lost;lost;0,05\n1;2;3;0,1\n",
        "x,y,z,error\n,,,occluded\n1,2,3,0.1\n",
        "x,y,z\nmeasured by hand,,\n1,2,3\n",
        "tools,port,frame,q0,qx,qy,qz,tx,ty,tz\n1,1,7,-,-,-,-,Disabled,Disabled,Disabled\n1,1,8,0.6,0,0.8,0,1,2,3\n",
    ],
)
def test_words_of_a_reading_that_has_a_name_or_number_are_no_units(tmp_path: Path, table: str) -> None:
    """Whole files were refused for the first marker, seen later or never, of which they say so in their own words."""
    read = read_recording(written(tmp_path, "r.csv", table))
    assert [one.usable for one in read.points or read.tools] == [False, True]


@pytest.mark.parametrize(("column", "word"), [("operator", "KM"), ("side", "foot"), ("by", "FT")])
def test_initials_and_sides_are_no_units(tmp_path: Path, column: str, word: str) -> None:
    (point,) = read_recording(written(tmp_path, "r.csv", f"x,y,z,{column}\n1,2,3,{word}\n")).points
    assert point.usable


@pytest.mark.parametrize(
    "rows",
    [
        "A;-1.294;187;35\nB;12;-1.500;8\n",
        "A;-1,294;187;35\nB;12;-1,500;8\n",
        "A;0;0;0\nB;999;-1.294;2.048\n",
    ],
)
def test_whole_millimetres_with_signs_between_thousands_are_refused(tmp_path: Path, rows: str) -> None:
    """What is 1.3 m away was read as 1.3 mm away."""
    with pytest.raises(
        InputError, match=r"coordinates -1[.,]294 and (12|999), so that the first may be -1294; exp"
    ):
        read_recording(written(tmp_path, "r.csv", f"label;x;y;z\n{rows}"))


@pytest.mark.parametrize(
    ("rows", "first"),
    [
        ("A;-1.294;187.000;35.125;1\nB;12.250;-1.500;8.125;1\n", -1.294),
        ("A;-1,294;187;35;1\nB;12,5;-1,500;8;1\n", -1.294),
        ("A;-1.294;187;35;1\nB;12;-0.500;8;1\n", -1.294),
        ("A;-1.294;187;1665;1\n", -1.294),
        ("A;1.294;0;0;1\n", 1.294),
    ],
)
def test_decimals_that_cannot_separate_thousands_are_read(tmp_path: Path, rows: str, first: float) -> None:
    """Whole numbers beside these, as of an error that is stated as 1, a zero or 1665, tell nothing of thousands."""
    read = read_recording(written(tmp_path, "r.csv", f"label;x;y;z;sigma\n{rows}"))
    assert read.points[0].position_mm[0] == first


@pytest.mark.parametrize(
    ("name", "cell"),
    [
        ("sigma", "0,1mm"),
        ("sigma", "0"),
        ("sigma", "nan"),
        ("state", "Missing"),
        ("Valid", "false"),
        ("valid", "0.0"),
        ("visible", "FALSCH"),
        ("seen", "-1"),
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


@pytest.mark.parametrize("first", ["sep=;", '"sep=;"', "\ufeffSEP=;\r"])
def test_a_first_line_that_tells_a_spreadsheet_the_delimiter_is_heard(tmp_path: Path, first: str) -> None:
    recording = read_recording(written(tmp_path, "r.csv", f"{first}\nlabel;x;y;z\nA;1,5;-2,25;3\n"))
    np.testing.assert_array_equal(recording.points[0].position_mm, [1.5, -2.25, 3])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sep=|\nx|y|z\n1|2|3\n", r"separates its columns by '\|'"),
        ("sep=,\n", "is empty"),
        (",,,\n,,,\n", "is empty"),
        ("x y z\n1.5 2.5 3.5\n", "separates its columns by blanks"),
        ("1.5e+01 2.5 3.5\n", "separates its columns by blanks"),
        ("F1 1.5 2.5 3.5\n", "separates its columns by blanks"),
        ("name x y z\nF 1 1.5 2.5 3.5\n", "separates its columns by blanks"),
        ("x,y,z,unit\n1,2,3,mm\n1,2,3,m\n", "row 2 below the header says its unit is 'm'"),
        ("x,y,z,Units\n1,2,3,inch\n", "unit is 'inch'"),
        ("frame,x,y,z\n,m,m,m\n1,0.1,0.2,0.3\n", "says 'm' right below its column x, .*; expected mm"),
        ("time,x,y,z\nms,mm,mm,mm\n500,1,2,3\n", "says 'ms' right below its column time, .*; expected s"),
        ("x,y,z\n[µm],[µm],[µm]\n1,2,3\n", r"says '\[µm\]' right below its column x, .*; expected mm"),
        ("name;x;y;z\n;Zoll;Zoll;Zoll\nA;1,5;2,5;3\n", "says 'Zoll' right below its column x, .*; expected mm"),
        ("name;x;y;z\n;tommer;tommer;tommer\nA;1,5;2,5;3\n", "says 'tommer' right below .* or delete that row"),
        ("frame,x,y,z\n[-],[px],[px],[px]\n1,2,3,4\n", r"says '\[px\]' right below its column x"),
        ("name;x;y;z;Einheit\nA;1,5;2,5;3;Zoll\n", r"unit is 'Zoll' \(column 'einheit'\); expected mm"),
        ("name;x;y;z;unité\nA;1,5;2,5;3;mètres\n", "unit is 'mètres'"),
        (
            "frame,m0_x,m0_y,m0_z\n1,2,3,4\n",
            r"but no x, y, z; expected a first line with x, y, z \(mm\) or m00 to m33, and one reading in each row",
        ),
        ("x,y,z,length_unit\n1,2,3,cm\n", "unit is 'cm'"),
        (
            "frame,Frame Number,x,y,z\nRAS,1,1,2,3\n",
            r"more than one column named frame \(or frame_number\); expected",
        ),
        ("name;x;y;z;Einheit\nA;0,1;0,2;1,3;m\nB;0,2;0,2;1,3;m\n", r"unit is 'm' \(column 'einheit'\); expected"),
        ("label\tx\ty\tz\nA\t-1,234\t2.5\t3.5\n", "holds the numbers -1,234 and 2.5; expected a comma or a point"),
        ("x,y,z,frame\n1,2,3,1.5\n", "frame number '1.5'"),
        ("x,y,z,coordinate_system\n1,2,3,0\n", "has the frame '0'; expected a name, such as RAS"),
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


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        ("x,y,z,coordinate_system\n1,2,3,RAS\n4,5,6,\n", "RAS"),
        ("x,y,z,coordinates\n1,2,3,LPS\n", "LPS"),
        ("x,y,z,coordinate_system,frame\n1,2,3,RAS,7\n", "RAS"),
        ("x,y,z,coordinate_system,frame\n1,2,3,RAS,Polaris\n", "Polaris"),
        ("x,y,z,coordinate_system\n1,2,3,\n", "OTS"),
        ("x,y,z,coordinate_system\n1,2,3,NaN\n4,5,6,n/a\n", "OTS"),
        ("x,y,z,coordinate_system\n1,2,3,None\n4,5,6,LPS\n", "LPS"),
    ],
)
def test_a_coordinate_system_is_no_tracker_s_own(tmp_path: Path, text: str, frame: str) -> None:
    """As of what Slicer saves: its x and y have the other sign than in the poses that the tracker itself tells."""
    assert read_recording(written(tmp_path, "r.csv", text)).frame.name == frame


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


def test_readings_of_every_kind_come_back_from_csv_as_they_were(tmp_path: Path) -> None:
    points = (
        PointReading(3, np.array([0.1, 1 / 3, -1000.0]), "=A", 1.5, 0.2),
        PointReading(4, np.full(3, np.nan), "'n", status="missing"),
    )
    tools = (
        ToolReading(0, "probe", None, 0.5, None, "no pose: it has 2 numbers; expected 16"),
        ToolReading(1, "never seen", None, status="missing"),
        ToolReading(2, "probe", AWAY, 0.75, 0.11),
    )
    again = read_recording(written(tmp_path, "r.csv", write_csv(Recording("test", points, tools))))
    for first, second in zip((*points, *tools), (*again.points, *again.tools), strict=True):
        for name, value in vars(first).items():
            np.testing.assert_equal(getattr(second, name), value)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_csv_as_a_spreadsheet_saves_it_in_utf_16(tmp_path: Path, encoding: str) -> None:
    text = "label;x;y;z\r\nÅ;1,5;-2;3\r\n"
    if encoding != "utf-16":
        text = "\ufeff" + text
    path = tmp_path / "r.csv"
    path.write_bytes(text.encode(encoding))
    (point,) = read_recording(path).points
    assert (point.label, point.position_mm.tolist()) == ("Å", [1.5, -2, 3])


def test_a_tools_poses_are_counted_where_their_moments_have_no_numbers(tmp_path: Path) -> None:
    table = "x,y,z,qw,qx,qy,qz,label\n" + "1,2,-1500,1,0,0,0,a\n5,6,-1500,1,0,0,0,b\n" * 2
    recording = read_recording(written(tmp_path, "t.csv", table))
    assert [(reading.frame, reading.tool) for reading in recording.tools] == [
        (0, "a"),
        (0, "b"),
        (1, "a"),
        (1, "b"),
    ]
    assert all(reading.usable for reading in recording.tools)
    assert not recording.numbered
    numbered = read_recording(written(tmp_path, "n.csv", "frame,x,y,z,q0,qx,qy,qz\n7,1,2,-1500,1,0,0,0\n"))
    assert numbered.numbered
    assert numbered.tools[0].frame == 7


def test_the_identity_is_no_pose_that_was_measured(tmp_path: Path) -> None:
    """Programs fill it in for a tool that is not seen; it stood at the tracker's origin."""
    table = "label,frame,x,y,z,q0,qx,qy,qz\nT,1,0,0,0,1,0,0,0\nT,2,0,0,-900,1,0,0,0\n"
    hidden, seen = read_recording(written(tmp_path, "r.csv", table)).tools
    assert (hidden.status, seen.status) == ("no pose", "ok")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("name,x,y,z,q1,q2,q3,q4\nA,1,2,3,0,0,0.6,0.8\n", ("columns that are not read: q1, q2, q3, q4",)),
        ("x,y,z,x1,y1,z1,comment,\n1,2,3,4,5,6,,\n", ("columns that are not read: x1, y1, z1",)),
        (",x,y,z\n0,1,2,3\n", ("columns that are not read: one without a name",)),
        ("name,x,y,z,time,frame,visible,unit,note\nA,1,2,3,0.5,1,1,mm,\n", ()),
        ("name,x,y,z,Einheit\nA,1,2,3,mm\n", ()),
        ("tool,x,y,z\nA,1,2,3\n", ("columns that are not read: tool",)),
        (matrix_rows(0, 3).replace("timestamp_ns", "stamp"), ("columns that are not read: stamp",)),
    ],
)
def test_columns_that_are_passed_over_are_told(tmp_path: Path, text: str, told: tuple[str, ...]) -> None:
    """A rotation, a second point or a unit of another name could stand there."""
    assert read_recording(written(tmp_path, "r.csv", text)).notes == told


@pytest.mark.parametrize(
    ("column", "word"),
    [("name", "M"), ("label", "m"), ("frame", "M"), ("status", "m"), ("type", "M"), ("notes", "m")],
)
def test_words_that_are_letters_of_units_are_no_units(tmp_path: Path, column: str, word: str) -> None:
    """A frame that is called M was taken for a unit."""
    recording = read_recording(written(tmp_path, "r.csv", f"{column},x,y,z\n{word},1,2,3\n"))
    assert len(recording.points) == 1
    assert recording.frame.name == ("M" if column == "frame" else "OTS")


@pytest.mark.parametrize("name", ["tool", "Tool Name", "label"])
def test_tools_are_told_apart_by_what_names_them(tmp_path: Path, name: str) -> None:
    """They were one tool without a name."""
    rows = "A,7,1,2,3,0,0,0.6,0.8\nB,7,4,5,6,0,0,0.6,0.8\nA,8,,,,,,,\n"
    recording = read_recording(written(tmp_path, "r.csv", f"{name},Frame Number,x,y,z,qx,qy,qz,qw\n{rows}"))
    assert [(one.tool, one.frame, one.usable) for one in recording.tools] == [
        ("A", 7, True),
        ("B", 7, True),
        ("A", 8, False),
    ]
    assert recording.numbered


@pytest.mark.parametrize("unit", ["seconds", "sec", "s"])
def test_seconds_may_be_written_out(tmp_path: Path, unit: str) -> None:
    (point,) = read_recording(written(tmp_path, "r.csv", f"x,y,z,Time ({unit})\n1,2,3,0.5\n")).points
    assert point.time_s == 0.5


def test_a_part_of_a_quaternion_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has qx, qy, qz of a quaternion; expected all of q0, qx, qy, qz"):
        read_recording(written(tmp_path, "t.csv", "x,y,z,qx,qy,qz\n1,2,3,0,0,0\n"))


def test_text_of_another_encoding_is_told_how_to_save_it(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes("label,x,y,z\nZähler,1,2,3\n".encode("cp1252"))
    with pytest.raises(InputError, match=r"is not a text file in UTF-8, .* save them as 'CSV UTF-8'"):
        read_recording(tmp_path / "t.csv")


def test_what_other_programs_call_seen_and_hidden_is_heard(tmp_path: Path) -> None:
    """NDI's Okay was flagged as a fault, and an occluded reading was taken for a place."""
    text = "label,x,y,z,status,occluded,error\nA,1,2,3,Okay,0,9\nB,4,5,6,good,TRUE,9\nC,7,8,9,Missing,0,9\n"
    recording = read_recording(written(tmp_path, "r.csv", text))
    assert [one.status for one in recording.points] == ["ok", "occluded", "missing"]
    assert recording.notes == ("columns that are not read: error",)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "# units: m\nframe,label,x,y,z\n1,A,1,2,3\n",
            r"later line \(frame,label,x,y,z\); .* look .* for the unit",
        ),
        (
            "Format Version,1.23,Length Units,Meters\n\nFrame,X,Y,Z,X,Y,Z\n0,1,2,3,4,5,6\n",
            "later line .Frame,X,Y,Z",
        ),
        ("Recorded today\n\nlabel;x;y;z\nA;1;2;3\n", "later line .label;x;y;z"),
        ("Number of frames: 1\nFrame\tM1 x\tM1 y\n1\t1\t2\n", "no x, y, z"),
        ("Frame,X,Y,Z,X,Y,Z\n0,1,2,3,4,5,6\n", "a row for each reading"),
        ("标记,x（米）,y（米）,z（米）\nA,1,2,3\n", r"the column 'x\(米\)'; expected it in mm"),
    ],
)
def test_what_stands_before_and_in_a_header_of_other_programs_is_told(
    tmp_path: Path, text: str, says: str
) -> None:
    with pytest.raises(InputError, match=says):
        read_recording(written(tmp_path, "r.csv", text))


@pytest.mark.parametrize("axis", ["{}（毫米）", "{} [㎜]", "{} (мм)"])
def test_millimetres_are_read_in_other_scripts(tmp_path: Path, axis: str) -> None:
    text = f"label,{','.join(map(axis.format, 'xyz'))}\nA,1,2,3\n"
    assert read_recording(written(tmp_path, "r.csv", text)).points[0].position_mm.tolist() == [1, 2, 3]
