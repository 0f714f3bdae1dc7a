"""A plan goes through Slicer's markups and CSV unchanged, and what is doubtful in them is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.documents.plan_exchange import (
    contacts_table,
    line_markups,
    plan_table,
    read_line_markups,
    read_plan_table,
)
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame
from ronnaplan.planning import Plan, Trajectory
from tests.documents.plans import CT, POINTER


def same(read: list[Trajectory], plan: Plan) -> None:
    assert [one.name for one in read] == [one.name for one in plan.trajectories]
    for one, other in zip(read, plan.trajectories, strict=True):
        np.testing.assert_allclose(one.entry_mm, other.entry_mm, atol=1e-6)
        np.testing.assert_allclose(one.target_mm, other.target_mm, atol=1e-6)
        assert (one.colour, one.locked) == (other.colour, other.locked)


def test_line_markups_come_back(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "lines.mrk.json"
    path.write_text(line_markups(plan))
    same(read_line_markups(path, CT, POINTER), plan)


@pytest.mark.parametrize("write", [line_markups, plan_table, contacts_table])
def test_no_file_is_written_of_a_plan_without_trajectories(write: Callable[[Plan], str], plan: Plan) -> None:
    """Neither Slicer nor `plan import` reads one."""
    with pytest.raises(InputError, match="no trajectory"):
        write(replace(plan, trajectories=()))


def line(system: str, labels: tuple[str, str], path: Path) -> Path:
    points = [
        {"label": labels[0], "position": [1.0, 2.0, 3.0]},
        {"label": labels[1], "position": [4.0, 5.0, 60.0]},
    ]
    markup = {"type": "Line", "name": "L", "coordinateSystem": system, "controlPoints": points}
    path.write_text(json.dumps({"markups": [markup]}))
    return path


def test_a_line_of_slicer_s_own_says_its_system_and_needs_its_order(tmp_path: Path) -> None:
    path = line("RAS", ("L-1", "L-2"), tmp_path / "l.mrk.json")
    with pytest.raises(InputError, match=r"which of them comes first \(--first entry, or --first target\)"):
        read_line_markups(path, CT, POINTER)
    (read,) = read_line_markups(path, CT, POINTER, first="target")
    np.testing.assert_array_equal(read.target_mm, [-1.0, -2.0, 3.0])
    np.testing.assert_array_equal(read.entry_mm, [-4.0, -5.0, 60.0])
    (labelled,) = read_line_markups(line("LPS", ("Target", "Entry"), path), CT, POINTER, first="entry")
    np.testing.assert_array_equal(labelled.target_mm, [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="is in LPS but RAS"):
        read_line_markups(path, CT, POINTER, system="RAS")


@pytest.mark.parametrize(("file", "name"), [("left STN.mrk.json", "left STN"), ("v1.2.JSON", "v1.2")])
def test_a_line_without_a_name_is_called_as_its_file(file: str, name: str, tmp_path: Path) -> None:
    """Slicer writes none, and a file a line: of two, both would be called alike."""
    path = line("LPS", ("entry", "target"), tmp_path / file)
    path.write_text(path.read_text().replace('"name": "L", ', ""))
    assert [one.name for one in read_line_markups(path, CT, POINTER)] == [name]


def test_a_list_of_points_is_no_table_of_trajectories(tmp_path: Path) -> None:
    (tmp_path / "F.fcsv").write_text("# CoordinateSystem = LPS\n# columns = id,x,y,z\n1,25,-20,84\n")
    with pytest.raises(
        InputError, match="is a list of points, which does not say which of them make a trajectory"
    ):
        read_plan_table(tmp_path / "F.fcsv", CT, POINTER)


@pytest.mark.parametrize(
    ("there", "instead"),
    [
        ("[1.0, 2.0, 3.0]", '"123"'),
        ("[1.0, 2.0, 3.0]", '["1", "2", "3"]'),
        ("[1.0, 2.0, 3.0]", "[true, 2, 3]"),
        ("[1.0, 2.0, 3.0]", "[1e308, 2, 3]"),
        ("[1.0, 2.0, 3.0]", "[]"),
        ("[1.0, 2.0, 3.0]", '[1.0, 2.0, 3.0], "positionStatus": "preview"'),
        ("[1.0, 2.0, 3.0]", '[1.0, 2.0, 3.0], "positionStatus": "undefined"'),
        ('"LPS"', '"LPS", "locked": "no"'),
        ('"LPS"', '"LPS", "coordinateUnits": "cmm"'),
        ('"LPS"', '"LPS", "coordinateSystem": "RAS"'),
        ('"LPS"', '"LPS", "display": {"selectedColor": [255, 0, 0]}'),
    ],
)
def test_a_line_is_taken_at_its_word(there: str, instead: str, tmp_path: Path) -> None:
    path = line("LPS", ("entry", "target"), tmp_path / "l.mrk.json")
    read_line_markups(path, CT, POINTER)
    path.write_text(path.read_text().replace(there, instead))
    with pytest.raises(InputError):
        read_line_markups(path, CT, POINTER)


@pytest.mark.parametrize(
    "text", ["{}", "[]", '{"markups": [{"type": "Line"}]}', '{"markups": [{"type": "Fiducial"}]}']
)
def test_what_holds_no_line_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "l.mrk.json").write_text(text)
    with pytest.raises(InputError):
        read_line_markups(tmp_path / "l.mrk.json", CT, POINTER)


def test_a_table_comes_back(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    path.write_text(plan_table(plan))
    read = read_plan_table(path, CT, POINTER)
    same(read, plan)
    assert [one.instrument for one in read] == [one.instrument for one in plan.trajectories]
    assert [one.notes for one in read] == ["", "second choice"]
    with pytest.raises(FrameMismatchError):
        read_plan_table(path, Frame("CT", "9"), POINTER)
    with pytest.raises(InputError, match="says LPS but RAS"):
        read_plan_table(path, CT, POINTER, system="RAS")


HEADER = "name,entry_x,entry_y,entry_z,target_x,target_y,target_z"


def test_a_plain_table_needs_its_system(tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    path.write_text("name,entry_x,entry_y,entry_z,target_x,target_y,target_z\nA,1,2,3,4,5,60\n")
    with pytest.raises(InputError, match="LPS or RAS"):
        read_plan_table(path, CT, POINTER)
    (read,) = read_plan_table(path, CT, POINTER, system="RAS")
    np.testing.assert_array_equal(read.entry_mm, [-1, -2, 3])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        (f"{HEADER}\n", "no trajectory"),
        (f"{HEADER}\nA,1_0,2,3,4,5,6\n", "no number under entry_x"),
        (f"{HEADER}\nA,1,2,3,4,\x1e.5,6\n", "no number under target_y"),
        (f"{HEADER}\nA,1,2,3,4,5,6\x1c\n", "no number under target_z"),
        (f"{HEADER}\nA,nan,2,3,4,5,6\n", "no number under entry_x"),
        (f"{HEADER},unit\nA,1,2,3,4,5,6,cm\n", "its unit is 'cm'"),
        (f"{HEADER},entry_x\nA,1,2,3,4,5,6,7\n", "more than one column"),
        (f"{HEADER},locked\nA,1,2,3,4,5,6,maybe\n", "says 'maybe' under locked"),
        (f"{HEADER.replace('entry_x', 'entry_x [m]')}\nA,1,2,3,4,5,6\n", "expected it in mm"),
        ("name,entry_x\nA,1\n", "lacks the columns"),
        (f"{HEADER}\nA,1,2,x,4,5,6\n", "line 2"),
        (f"{HEADER}\nA,1,2\n", "line 2"),
        (f"{HEADER},instrument\nA,1,2,3,4,5,6,laser\n", "laser"),
        (f"{HEADER},diameter_mm\nA,1,2,3,4,5,6,2.5\n", "line 2 states only one of"),
        (f"{HEADER},diameter,length\nA,1,2,3,4,5,6,,90\n", "states only one of"),
    ],
)
def test_a_table_that_is_wrong_is_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "plan.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        read_plan_table(tmp_path / "plan.csv", CT, POINTER, system="LPS")
