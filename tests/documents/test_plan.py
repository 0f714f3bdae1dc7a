"""plan.json keeps everything, refuses what it cannot read, and goes through Slicer markups and CSV unchanged."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.ct import CTVolume, SeriesSource, SliceGrid
from ronnaplan.documents.limits import read_limits
from ronnaplan.documents.plan import change_plan, plan_document, read_plan, write_plan
from ronnaplan.documents.plan_exchange import (
    contacts_table,
    line_markups,
    plan_table,
    read_line_markups,
    read_plan_table,
)
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame
from ronnaplan.planning import INSTRUMENTS, Instrument, Landmarks, Limits, Plan, Ruler, Trajectory
from ronnaplan.planning.electrodes import ELECTRODES

UID = "1.2.840.7"
CT = Frame("CT", UID)
ANGLE = Ruler("=A1", np.array([[9.0, 1, 1], [1.0, 1, 1], [1.0, 5, 1]]))
POINTER = INSTRUMENTS["pointer"]


@pytest.fixture
def plan() -> Plan:
    """Two trajectories, landmarks, and a history with a change taken back."""
    first = Trajectory("left, deep", np.array([10.5, -20.25, 80.1]), np.array([1.0, 2.0, 3.0]), CT)
    second = Trajectory(
        "=B", np.array([-30.0, 5, 70]), np.array([-5.0, 0, 10]), CT, Instrument("mine", 2.5, 190.0), "#00ff7f"
    )
    landmarks = Landmarks(np.array([0.0, -12, 0]), np.array([0.0, 12, 0]), np.array([0.0, 0, 40]))
    built = Plan(SeriesSource("1.2", "1.3", UID), "ab" * 32).add(first).add(second).with_landmarks(landmarks)
    built = built.add_ruler(Ruler("D1", np.array([[0.0, 0, 0], [3.0, 4, 0]]))).add_ruler(ANGLE)
    return built.edit("=B", notes="second choice").lock("=B").remove("left, deep").undo()


def content(plan: Plan) -> Any:
    return json.loads(plan_document(plan).model_dump_json())


def test_a_plan_comes_back_as_it_was(plan: Plan, tmp_path: Path) -> None:
    write_plan(tmp_path / "plan.json", plan)
    back = read_plan(tmp_path / "plan.json")
    assert content(back) == content(plan)
    assert back.frame == CT
    assert [change.action for change in back.history] == [
        *("add", "add", "landmarks", "measure", "measure", "edit", "lock")
    ]
    assert [(one.name, one.told) for one in back.rulers] == [("D1", "5.0 mm"), ("=A1", "90.0 deg")]
    assert all(change.time.tzinfo is not None for change in back.history)


def test_electrodes_come_back_in_the_plan_and_its_table_and_their_contacts_are_told(
    plan: Plan, tmp_path: Path
) -> None:
    chosen = plan.edit("left, deep", electrode=ELECTRODES["Medtronic 3389"])
    write_plan(tmp_path / "plan.json", chosen)
    back = read_plan(tmp_path / "plan.json")
    assert [one.electrode and one.electrode.name for one in back] == ["Medtronic 3389", None]
    (tmp_path / "plan.csv").write_text(plan_table(chosen))
    first, second = read_plan_table(tmp_path / "plan.csv", CT, POINTER)
    assert (first.electrode, second.electrode) == (ELECTRODES["Medtronic 3389"], None)
    rows = list(csv.DictReader(contacts_table(chosen).splitlines()))
    assert [row["contact"] for row in rows] == ["1", "2", "3", "4"]
    path = chosen.trajectory("left, deep")
    for row, from_tip in zip(rows, (2.25, 4.25, 6.25, 8.25), strict=True):
        place = path.target_mm - from_tip * path.inward
        assert [float(row[axis]) for axis in "xyz"] == pytest.approx(place, abs=1e-6)
        assert float(row["depth_mm"]) == pytest.approx(path.length_mm - from_tip, abs=1e-6)
    with pytest.raises(InputError, match="no trajectory of the plan has an electrode"):
        contacts_table(plan)


def test_every_change_has_a_revision_of_its_own_also_one_that_is_taken_back(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    write_plan(path, plan)
    walked = [
        plan,
        *(change_plan(path, step) for step in (Plan.undo, Plan.redo, lambda now: now.lock("=B", False))),
    ]
    assert [one.revision for one in walked] == [9, 10, 11, 12]
    assert content(read_plan(path)) == content(walked[-1])
    without = content(plan)
    del without["revision"]
    path.write_text(json.dumps(without))
    assert read_plan(path).revision == 0


def test_undo_leads_back_to_the_empty_plan_and_redo_to_the_last(plan: Plan) -> None:
    states = [content(plan.redo())["trajectories"]]
    walked = plan.redo()
    while walked.history:
        walked = walked.undo()
        states.append(content(walked)["trajectories"])
    assert states[-1] == []
    assert walked.landmarks is None
    for state in states[-2::-1]:
        walked = walked.redo()
        assert content(walked)["trajectories"] == state
    with pytest.raises(InputError, match="no change to make again"):
        walked.redo()
    with pytest.raises(InputError, match="no change to take back"):
        Plan(SeriesSource()).undo()


def test_a_new_change_forgets_what_was_undone(plan: Plan) -> None:
    assert plan.undone
    assert plan.lock("left, deep").undone == ()


def test_locked_unknown_and_repeated_names_are_refused(plan: Plan) -> None:
    acts: list[Callable[[], Plan]] = [lambda: plan.edit("=B", notes=""), lambda: plan.remove("=B")]
    for act in acts:
        with pytest.raises(InputError, match="locked"):
            act()
    assert plan.lock("=B", False).edit("=B", notes="").trajectory("=B").notes == ""
    with pytest.raises(InputError, match="no trajectory 'C'; it has left, deep, =B"):
        plan.remove("C")
    with pytest.raises(InputError, match="already has"):
        plan.add(plan.trajectories[0])
    with pytest.raises(InputError, match="already has"):
        plan.edit("left, deep", name="=B")


def test_another_frame_is_refused(plan: Plan) -> None:
    with pytest.raises(FrameMismatchError):
        plan.add(replace(plan.trajectories[0], name="C", frame=Frame("CT", "9")))
    voxels = np.zeros((3, 4, 4), dtype=np.int16)
    grid = SliceGrid(np.arange(9.0).reshape(3, 3), np.array([0.0, 1, 0]), np.array([1.0, 0, 0]))
    with pytest.raises(FrameMismatchError):
        plan.require_scan(CTVolume(voxels, grid, SeriesSource(frame_of_reference_uid="9")))
    plan.require_scan(CTVolume(voxels, grid, SeriesSource(frame_of_reference_uid=UID)))
    unnamed = CTVolume(voxels, grid)
    Plan.of_scan(unnamed).require_scan(unnamed)
    with pytest.raises(FrameMismatchError, match="voxels differ"):
        Plan.of_scan(unnamed).require_scan(replace(unnamed, voxels_hu=voxels + 1))


def edited(change: Callable[[dict[str, Any]], object]) -> Callable[[dict[str, Any]], dict[str, Any]]:
    def apply(document: dict[str, Any]) -> dict[str, Any]:
        change(document)
        return document

    return apply


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(version=2), "version 2"),
        (lambda d: d.update(format="ronnaplan.fiducials"), "not a plan"),
        (lambda d: d.update(coordinate_system="RAS"), "coordinate_system"),
        (lambda d: d.update(extra=1), "extra"),
        (lambda d: d["trajectories"][0].update(target=d["trajectories"][0]["entry"]), "0.00 mm apart"),
        (lambda d: d["trajectories"][0].update(entry=[1, 2]), "trajectories.0.entry"),
        (lambda d: d["trajectories"][0].update(colour="red"), "trajectories.0.colour"),
        (lambda d: d["trajectories"][0]["instrument"].update(diameter_mm=-1), "diameter_mm"),
        (lambda d: d["trajectories"][0].update(electrode="D08"), "unknown electrode 'D08'"),
        (lambda d: d["trajectories"].append(d["trajectories"][0]), "same name"),
        (lambda d: d["landmarks"].update(midline=[0, 30, 0]), "one line"),
        (lambda d: d.pop("source"), "source"),
    ],
)
def test_a_document_that_is_wrong_is_refused_by_name(
    plan: Plan, change: Callable[[dict[str, Any]], object], words: str, tmp_path: Path
) -> None:
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(edited(change)(content(plan))))
    with pytest.raises(InputError, match=words):
        read_plan(path)


def test_the_points_to_register_are_the_trajectories_ends(plan: Plan, tmp_path: Path) -> None:
    write_plan(tmp_path / "plan.json", plan)
    points = read_plan(tmp_path / "plan.json").points
    assert points.labels == ("left, deep entry", "left, deep target", "=B entry", "=B target")
    np.testing.assert_array_equal(points.positions_mm[3], [-5.0, 0, 10])
    assert points.frame == CT


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
    with pytest.raises(InputError, match="which of them comes first"):
        read_line_markups(path, CT, POINTER)
    (read,) = read_line_markups(path, CT, POINTER, first="target")
    np.testing.assert_array_equal(read.target_mm, [-1.0, -2.0, 3.0])
    np.testing.assert_array_equal(read.entry_mm, [-4.0, -5.0, 60.0])
    (labelled,) = read_line_markups(line("LPS", ("Target", "Entry"), path), CT, POINTER, first="entry")
    np.testing.assert_array_equal(labelled.target_mm, [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="is in LPS but RAS"):
        read_line_markups(path, CT, POINTER, system="RAS")


@pytest.mark.parametrize(
    ("there", "instead"),
    [
        ("[1.0, 2.0, 3.0]", '"123"'),
        ("[1.0, 2.0, 3.0]", '["1", "2", "3"]'),
        ("[1.0, 2.0, 3.0]", "[true, 2, 3]"),
        ("[1.0, 2.0, 3.0]", "[1e308, 2, 3]"),
        ("[1.0, 2.0, 3.0]", "[]"),
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
    ],
)
def test_a_table_that_is_wrong_is_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "plan.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        read_plan_table(tmp_path / "plan.csv", CT, POINTER, system="LPS")


def test_limits_are_read_and_an_unknown_one_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    head = {"format": "ronnaplan.limits", "version": 1}
    path.write_text(json.dumps({**head, "longest_path_mm": 80, "least_probability": 0.95}))
    assert read_limits(path) == Limits(longest_path_mm=80.0, least_probability=0.95)
    for wrong, words in (
        ({**head, "longest_path": 80}, "longest_path"),
        ({**head, "longest_path_mm": -1}, "longest_path_mm"),
        ({**head, "version": 3}, "version 3"),
        ({"longest_path_mm": 80}, "not a limits document"),
    ):
        path.write_text(json.dumps(wrong))
        with pytest.raises(InputError, match=words):
            read_limits(path)
