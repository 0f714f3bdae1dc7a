"""plan.json keeps everything, and refuses what it cannot read."""

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
from ronnaplan.documents.plan import change_plan, plan_document, read_plan, write_plan
from ronnaplan.documents.plan_exchange import (
    contacts_table,
    plan_table,
    read_plan_table,
)
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame
from ronnaplan.planning import Plan
from ronnaplan.planning.electrodes import ELECTRODES
from ronnaplan.planning.tables import history_list
from tests.documents.plans import CT, POINTER, UID


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


def test_the_times_of_changes_are_listed_in_utc_whichever_zone_they_were_written_in(
    plan: Plan, tmp_path: Path
) -> None:
    document = content(plan)
    document["history"][0]["time"] = "2026-01-31T23:30:00-05:00"
    (tmp_path / "plan.json").write_text(json.dumps(document))
    head, first, *_ = history_list(read_plan(tmp_path / "plan.json")).splitlines()
    assert head.startswith("time (UTC)")
    assert first.startswith("2026-02-01 04:30:00")


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


def test_what_a_file_edited_by_hand_no_longer_holds_is_not_taken_back(plan: Plan, tmp_path: Path) -> None:
    """It ended in a traceback, or took the trajectory away that had come to stand there."""
    path = tmp_path / "plan.json"
    added = Plan(plan.source, trajectories=()).add(plan.trajectories[0]).add(plan.trajectories[1])
    write_plan(path, added)
    document = json.loads(path.read_text())

    def read_with(**changes: Any) -> Plan:
        path.write_text(json.dumps({**document, **changes}))
        return read_plan(path)

    two = document["trajectories"]
    others: tuple[list[Any], ...] = ([], two[:1], two[::-1])
    for trajectories in others:
        with pytest.raises(InputError, match=r"does not hold what its history says \('add'\)"):
            read_with(trajectories=trajectories).undo()
    with pytest.raises(InputError, match="does not hold what its history says"):
        read_with(undone=document["history"]).redo()  # a second one of its name
    of_landmarks = {"ac": [0, -12, 0], "pc": [0, 12, 0], "midline": [0, 0, 40]}
    with pytest.raises(InputError, match="makes one kind of thing of another"):
        read_with(history=[{**document["history"][0], "before": of_landmarks}])


@pytest.mark.parametrize(
    "by_hand", [("trajectories", 1, "target"), ("landmarks", "ac"), ("measurements", 1, "points", 0)]
)
def test_places_that_were_edited_by_hand_are_not_taken_away(
    by_hand: tuple[Any, ...], plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "plan.json"
    last = {"trajectories": "edit", "landmarks": "landmarks", "measurements": "measure"}[by_hand[0]]
    while plan.history[-1].action != last:
        plan = plan.undo()
    document = content(plan)
    *way, end = by_hand
    place: Any = document
    for step in way:
        place = place[step]
    place[end] = [4.0, 5.0, 6.0]
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match="does not hold what its history says"):
        read_plan(path).undo()


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
        (
            lambda d: d["trajectories"][0].update(name="n" * 501),
            r"trajectories\.0\.name: .* at most 500 characters",
        ),
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
