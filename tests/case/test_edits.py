"""One way back through all changes, of the plan and of the markers, in the order in which they were made."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ronnaplan.documents.fiducials import read_fiducials
from ronnaplan.documents.plan import change_plan, read_plan, write_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import FrameMismatchError, InputError, UnwrittenError
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Plan, crossings
from ronnaplan.planning.layers import way_out
from tests import cases
from tests.planner.conftest import reopened

T = cases.TARGET_MM


def labels(state: PlannerState) -> list[str]:
    """The markers as the file has them."""
    return [one.label for one in read_fiducials(state.storage.fiducials).fiducials]


def x_mm(state: PlannerState) -> float:
    """The target's first coordinate as the file has it."""
    return float(read_plan(state.storage.plan).trajectory("left").target_mm[0])


def test_changes_of_plan_and_markers_are_taken_back_in_their_order(state: PlannerState) -> None:
    state.case.edit("left", target_mm=T + np.array([1, 0, 0]))
    state.case.reject_marker("F2")
    state.case.edit("left", target_mm=T + np.array([2, 0, 0]))
    state.case.rename_marker("F1", "nose")
    seen = []
    for _ in range(4):
        seen.append((labels(state)[:2], x_mm(state) - T[0]))
        state.case.undo()
    assert seen == [(["nose", "F3"], 2.0), (["F1", "F3"], 2.0), (["F1", "F3"], 1.0), (["F1", "F2"], 1.0)]
    assert (labels(state)[:2], x_mm(state) - T[0]) == (["F1", "F2"], 0.0)
    for expected in reversed(seen):
        state.case.redo()
        assert (labels(state)[:2], x_mm(state) - T[0]) == expected


def test_what_a_new_end_is_checked_by_is_measured_once(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[float] = []

    def counting(*arguments: Any) -> Any:
        looked.append(arguments[3][0])
        return way_out(*arguments)

    monkeypatch.setattr(crossings, "way_out", counting)
    state.case.edit("left", target_mm=T + np.array([1, 0, 0]))
    assert state.case.judge(state.case.plan.trajectory("left")).measures is not None
    state.case.rename_marker("F1", "nose")  # all is judged anew
    assert state.case.judge(state.case.plan.trajectory("left")).measures is not None
    assert looked == [T[0] + 1]


def test_a_renamed_marker_keeps_its_registration_there_and_back(state: PlannerState) -> None:
    state.case.keep_registration(cases.registration())
    before = cases.registration().expected.tre_rms_mm(T[None])
    state.case.rename_marker("F1", "nose")
    for other in (state, reopened(state)):
        assert other.case.outdated is None
        expected = other.case.surroundings.expected.registered
        assert expected is not None
        assert expected.markers[0] == "nose"
        assert expected.tre_rms_mm(T[None]) == before
    state.case.undo()
    assert state.case.outdated is None
    assert state.case.registration is not None
    assert state.case.registration.revision == 2
    state.case.redo()
    assert state.case.registration.pairs[0].ct == "nose"


def test_a_marker_is_renamed_whole_beside_a_registration_that_another_hand_changed(state: PlannerState) -> None:
    state.case.keep_registration(cases.registration())
    theirs = cases.registration().model_copy(update={"revision": 7})
    state.storage.registration.write_text(to_json(theirs), encoding="utf-8")
    state.case.rename_marker("F1", "nose")
    assert "F1, which is no longer there" in (state.case.outdated or "")
    assert state.case.surroundings.fiducials is state.case.fiducials
    state.case.undo()
    assert (labels(state)[0], state.case.outdated) == ("F1", None)


def test_accepting_and_localizing_again_are_taken_back_too(state: PlannerState) -> None:
    before = state.case.found
    state.case.reject_marker("F2")
    state.case.accept_marker(0)
    state.case.undo()
    assert "F2" not in labels(state)
    state.case.undo()
    state.case.replace_markers(state.case.found.model_copy(update={"fiducials": state.case.found.fiducials[:3]}))
    assert len(labels(state)) == 3
    state.case.undo()
    assert read_fiducials(state.storage.fiducials) == before.model_copy(update={"revision": 6})


def test_markers_that_were_changed_and_changed_back_meanwhile_are_noticed(state: PlannerState) -> None:
    other = reopened(state)
    other.case.rename_marker("F1", "nose")
    other.case.undo()
    with pytest.raises(InputError, match="changed by another hand"):
        state.case.reject_marker("F2")
    state.case.look_again()
    state.case.reject_marker("F2")
    assert read_fiducials(state.storage.fiducials).revision == 3


def test_after_a_new_change_nothing_is_made_again(state: PlannerState) -> None:
    state.case.edit("left", target_mm=T + np.array([1, 0, 0]))
    state.case.undo()
    assert state.case.can_redo
    state.case.reject_marker("F2")
    assert not state.case.can_redo
    assert not reopened(state).case.can_redo
    with pytest.raises(InputError, match="no change to make again"):
        state.case.redo()


def test_the_first_markers_of_a_case_can_be_taken_back_and_made_again(state: PlannerState) -> None:
    found = state.case.found
    state.storage.fiducials.unlink()
    again = reopened(state)
    assert again.case.fiducials is None
    again.case.replace_markers(found)
    again.case.undo()
    assert labels(again) == []
    again.case.redo()
    assert labels(again) == ["F1", "F2", "F3", "F4", "F5", "F6"]


def test_the_plans_changes_of_an_earlier_session_are_taken_back_too(state: PlannerState) -> None:
    state.case.edit("left", target_mm=T + np.array([1, 0, 0]))
    again = reopened(state)
    again.case.reject_marker("F2")
    again.case.undo()
    again.case.undo()
    assert x_mm(again) == T[0]
    assert "F2" in labels(again)
    again.case.undo()  # the trajectory itself
    assert not again.case.can_undo
    with pytest.raises(InputError, match="no change to take back"):
        again.case.undo()
    for _ in range(3):
        again.case.redo()
    assert (x_mm(again), "F2" in labels(again)) == (T[0] + 1, False)


def test_a_drag_that_moved_nothing_is_no_step(state: PlannerState) -> None:
    steps = len(state.case.plan.history)
    state.case.begin_drag("left")
    state.case.end_drag()
    assert len(state.case.plan.history) == steps
    state.case.drag("left", "target", T + 5)
    state.case.undo()  # while the button is still down
    assert state.case.plan.trajectory("left").target_mm == pytest.approx(T, abs=0)
    assert not state.case.dragging


def test_what_changes_nothing_is_no_step_and_what_was_taken_back_can_be_made_again(state: PlannerState) -> None:
    case = state.case
    case.edit("left", notes="deeper")
    case.edit("left", target_mm=T + 1)
    case.undo()
    before = case.plan
    case.edit("left", notes="deeper")
    case.lock("left", False)
    assert case.plan is before
    case.redo()
    assert case.plan.trajectory("left").target_mm == pytest.approx(T + 1, abs=0)


@pytest.mark.parametrize("place", [[0.0, 0.0, 5000.0], [120.0, 0.0, 60.0]], ids=["outside the scan", "in air"])
@pytest.mark.parametrize("end", ["entry", "target"])
def test_an_end_outside_the_head_is_refused_however_it_is_set(
    state: PlannerState, end: str, place: list[float]
) -> None:
    before, written = state.case.plan, state.storage.plan.read_bytes()
    bad = {f"{end}_mm": np.array(place)}
    with pytest.raises(InputError, match=f"the {end} of left .* (outside the scan|in air)"):
        state.case.edit("left", **bad)
    ends = {"entry_mm": cases.ENTRY_MM, "target_mm": T} | bad
    with pytest.raises(InputError, match=f"the {end} of T1"):
        state.add_trajectory(ends["entry_mm"], ends["target_mm"])
    state.case.drag("left", end, bad[f"{end}_mm"])
    with pytest.raises(InputError, match=f"the {end} of left"):
        state.case.end_drag()
    assert not state.case.dragging
    assert state.case.plan is before
    assert state.storage.plan.read_bytes() == written


def test_what_lies_badly_from_before_can_be_named_and_removed(state: PlannerState) -> None:
    stray = state.case.plan.edit("left", entry_mm=np.array([0.0, 0.0, 5000.0]))
    write_plan(state.storage.plan, stray)
    again = reopened(state)
    assert "outside the scan" in again.case.judge(again.case.plan.trajectory("left")).problem
    again.case.rename("left", "stray")
    again.case.remove("stray")
    assert again.case.plan.trajectories == ()


def test_what_another_hand_writes_is_taken_over_and_what_it_changed_is_not_lost(state: PlannerState) -> None:
    assert not state.case.look_again()
    change_plan(state.storage.plan, lambda plan: plan.add(replace(cases.plan().trajectory("left"), name="theirs")))
    state.case.edit("left", notes="mine")  # before anything was noticed
    assert [one.name for one in read_plan(state.storage.plan).trajectories] == ["left", "theirs"]
    assert [one.name for one in state.case.plan.trajectories] == ["left", "theirs"]
    fewer = state.case.found.model_copy(update={"fiducials": state.case.found.fiducials[:5]})
    state.storage.fiducials.write_text(to_json(fewer))
    before = state.case.surroundings
    with pytest.raises(InputError, match=r"fiducials\.json was changed by another hand"):
        state.case.reject_marker("F1")
    assert state.case.look_again()
    assert state.case.fiducials == fewer
    assert state.case.surroundings is not before
    state.case.reject_marker("F1")
    assert labels(state) == ["F2", "F3", "F4", "F5"]


def test_documents_of_another_scan_are_not_taken_over(state: PlannerState) -> None:
    theirs = replace(
        state.case.plan, source=replace(state.case.plan.source, frame_of_reference_uid="9.9"), history=()
    )
    mine, foreign = state.case.plan, replace(theirs, trajectories=())
    write_plan(state.storage.plan, foreign)
    with pytest.raises(FrameMismatchError, match=r"plan\.json is in frame CT \[9\.9\]"):
        state.case.look_again()
    assert state.case.plan is mine
    with pytest.raises(FrameMismatchError):
        state.case.edit("left", notes="mine")
    assert read_plan(state.storage.plan).frame.uid == "9.9"


def test_a_way_back_goes_through_the_changes_of_both_hands_in_their_order(state: PlannerState) -> None:
    state.case.reject_marker("F2")
    state.case.edit("left", notes="mine")
    change_plan(state.storage.plan, lambda plan: plan.lock("left"))
    assert state.case.look_again()
    change_plan(state.storage.plan, lambda plan: plan.lock("left", False))
    state.case.add(replace(cases.plan().trajectory("left"), name="mine, too"))  # before it was noticed
    seen = []
    while "F2" not in labels(state):
        left = state.case.plan.trajectory("left")
        seen.append((len(state.case.plan.trajectories), left.locked, left.notes))
        state.case.undo()
    assert seen == [(2, False, "mine"), (1, False, "mine"), (1, True, "mine"), (1, False, "mine"), (1, False, "")]
    assert read_plan(state.storage.plan).trajectory("left").notes == ""


def test_what_another_hand_took_back_is_not_taken_back_twice(state: PlannerState) -> None:
    state.case.reject_marker("F2")
    state.case.edit("left", notes="mine")
    change_plan(state.storage.plan, Plan.undo)
    assert state.case.look_again()
    assert not state.case.plan.trajectory("left").notes
    state.case.undo()
    assert "F2" in labels(state)


def test_a_change_that_was_not_seen_yet_is_not_taken_back(state: PlannerState) -> None:
    change_plan(state.storage.plan, lambda plan: plan.lock("left"))
    with pytest.raises(InputError, match="changed by another hand meanwhile"):
        state.case.undo()
    assert read_plan(state.storage.plan).trajectory("left").locked
    assert state.case.look_again()
    state.case.undo()
    assert not read_plan(state.storage.plan).trajectory("left").locked


def test_limits_that_are_written_while_the_case_is_open_are_held_against_it(state: PlannerState) -> None:
    """What is made of the case, a report say, is made with them, too."""

    def write(longest_mm: object) -> None:
        limits = {"format": "ronnaplan.limits", "version": 1, "longest_path_mm": longest_mm}
        state.storage.limits.write_text(json.dumps(limits))

    def broken() -> list[str]:
        return [one.measure for one in state.case.judge(state.case.plan[0]).broken]

    assert broken() == []
    write(20.0)
    assert state.case.look_again()
    assert broken() == ["path length"]
    state.case.edit("left", notes="mine")
    assert state.case.can_undo
    write("long")
    with pytest.raises(InputError, match=r"limits\.json"):
        state.case.look_again()
    assert broken() == ["path length"]
    write(200.0)
    assert state.case.look_again()
    assert broken() == []


def test_what_was_removed_still_counts_and_is_told_and_nothing_new_in_another_is_hidden(
    state: PlannerState,
) -> None:
    """What is made of the files would be another case than the one that is shown."""
    state.case.keep_registration(cases.registration())
    state.case.look_again()
    state.case.require_files()
    state.storage.registration.unlink()
    change_plan(state.storage.plan, lambda plan: plan.lock("left"))
    for told in (state.case.look_again, state.case.require_files):
        with pytest.raises(
            InputError, match=r"registration\.json was removed, and what it held still counts here"
        ):
            told()
    assert state.case.plan.trajectory("left").locked
    assert state.case.registration is not None
    assert not state.case.look_again()
    state.case.keep_registration(cases.registration())
    state.case.require_files()


def test_a_damaged_document_does_not_hide_what_is_new_in_another(state: PlannerState) -> None:
    state.storage.fiducials.write_text("{")
    change_plan(state.storage.plan, lambda plan: plan.lock("left"))
    with pytest.raises(InputError, match=r"fiducials\.json is not a JSON document"):
        state.case.look_again()
    assert state.case.plan.trajectory("left").locked
    assert not state.case.look_again()
    with pytest.raises(InputError, match="not a JSON document"):
        state.case.reject_marker("F1")
    assert state.storage.fiducials.read_text() == "{"


def full(handle: int) -> None:
    raise OSError(28, "No space left on device")


def test_a_change_of_plan_or_markers_that_could_not_be_written_is_made_later_beside_what_was_made_meanwhile(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    case, before = state.case, len(state.case.plan.trajectories)
    for change in (lambda: case.edit("left", notes="waited"), lambda: case.reject_marker("F2")):
        monkeypatch.setattr(os, "fsync", full)
        for attempt in (change, case.unwritten.make):
            with pytest.raises(UnwrittenError, match="No space left"):
                attempt()
        monkeypatch.undo()
        state.add_trajectory(cases.ENTRY_MM, T)  # before the next attempt
        assert case.unwritten.make()
        assert not case.unwritten.make()
    written = read_plan(state.storage.plan)
    assert written.trajectory("left").notes == "waited"
    assert len(written.trajectories) == before + 2
    assert "F2" not in labels(state)
    for _ in range(4):
        case.undo()
    assert len(case.plan.trajectories) == before
    assert case.plan.trajectory("left").notes == ""
    assert "F2" in labels(state)


def test_a_change_that_waits_is_dropped_for_no_other_one_that_cannot_be_written(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = state.case
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UnwrittenError, match="No space left"):
        state.add_trajectory(cases.ENTRY_MM, T)
    later: list[Callable[[], object]] = [
        lambda: case.edit("left", notes="later"),
        lambda: case.reject_marker("F2"),
    ]
    for change in later:
        with pytest.raises(UnwrittenError, match=r"No space left.*one before it still waits.*give it up first"):
            change()
    monkeypatch.undo()
    assert case.unwritten.make()
    assert [one.name for one in read_plan(state.storage.plan).trajectories] == ["left", "T1"]
    assert not case.unwritten.make()
    assert (case.plan.trajectory("left").notes, "F2" in labels(state)) == ("", True)


def test_an_edit_of_markers_that_others_replaced_meanwhile_is_not_made_later(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UnwrittenError):
        state.case.reject_marker("F2")
    monkeypatch.undo()
    state.case.rename_marker("F2", "B")
    with pytest.raises(InputError, match="the markers were changed meanwhile; look"):
        state.case.unwritten.make()
    assert not state.case.unwritten.make()
    assert "B" in labels(state)


def test_what_cannot_be_written_is_as_it_was_before(state: PlannerState, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, found, redo = state.case.plan, state.case.found, state.case.can_redo
    monkeypatch.setattr(os, "fsync", full)

    def drag() -> None:
        state.case.drag("left", "target", T + 1.0)
        state.case.end_drag()

    acts: list[Callable[[], object]] = [
        lambda: state.case.edit("left", notes="unsaved"),
        lambda: state.add_trajectory(cases.ENTRY_MM, T),
        lambda: state.case.remove("left"),
        lambda: state.case.reject_marker("F2"),
        lambda: state.set_landmark("AC", T),
        drag,
        state.case.undo,
        lambda: state.registering.register(cases.readings()),
    ]
    for act in acts:
        with pytest.raises(InputError, match="No space left"):
            act()
        assert state.case.plan is plan
        assert state.case.found is found
        assert state.landmarks_mm == {}
        assert state.case.registration is None
        assert state.case.can_redo == redo
    monkeypatch.undo()
    state.case.edit("left", notes="saved")
    assert read_plan(state.storage.plan).trajectory("left").notes == "saved"
