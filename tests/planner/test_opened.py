"""One way back through all changes, of the plan and of the markers, in the order in which they were made."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.documents.fiducials import read_fiducials
from ronnaplan.documents.plan import read_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import InputError
from ronnaplan.planner.state import PlannerState
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
    state.edit("left", target_mm=T + np.array([1, 0, 0]))
    state.reject_marker("F2")
    state.edit("left", target_mm=T + np.array([2, 0, 0]))
    state.rename_marker("F1", "nose")
    seen = []
    for _ in range(4):
        seen.append((labels(state)[:2], x_mm(state) - T[0]))
        state.undo()
    assert seen == [(["nose", "F3"], 2.0), (["F1", "F3"], 2.0), (["F1", "F3"], 1.0), (["F1", "F2"], 1.0)]
    assert (labels(state)[:2], x_mm(state) - T[0]) == (["F1", "F2"], 0.0)
    for expected in reversed(seen):
        state.redo()
        assert (labels(state)[:2], x_mm(state) - T[0]) == expected


def test_accepting_and_localizing_again_are_taken_back_too(state: PlannerState) -> None:
    before = to_json(state.found)
    state.reject_marker("F2")
    state.accept_marker(0)
    state.undo()
    assert "F2" not in labels(state)
    state.undo()
    state.replace_markers(state.found.model_copy(update={"fiducials": state.found.fiducials[:3]}))
    assert len(labels(state)) == 3
    state.undo()
    assert to_json(read_fiducials(state.storage.fiducials)) == before


def test_after_a_new_change_nothing_is_made_again(state: PlannerState) -> None:
    state.edit("left", target_mm=T + np.array([1, 0, 0]))
    state.undo()
    assert state.can_redo
    state.reject_marker("F2")
    assert not state.can_redo
    assert not reopened(state).can_redo
    with pytest.raises(InputError, match="no change to make again"):
        state.redo()


def test_the_first_markers_of_a_case_can_be_taken_back_and_made_again(state: PlannerState) -> None:
    found = state.found
    state.storage.fiducials.unlink()
    again = reopened(state)
    assert again.fiducials is None
    again.replace_markers(found)
    again.undo()
    assert labels(again) == []
    again.redo()
    assert labels(again) == ["F1", "F2", "F3", "F4", "F5", "F6"]


def test_the_plans_changes_of_an_earlier_session_are_taken_back_too(state: PlannerState) -> None:
    state.edit("left", target_mm=T + np.array([1, 0, 0]))
    again = reopened(state)
    again.reject_marker("F2")
    again.undo()
    again.undo()
    assert x_mm(again) == T[0]
    assert "F2" in labels(again)
    again.undo()  # the trajectory itself
    assert not again.can_undo
    with pytest.raises(InputError, match="no change to take back"):
        again.undo()
    for _ in range(3):
        again.redo()
    assert (x_mm(again), "F2" in labels(again)) == (T[0] + 1, False)


def test_a_drag_that_moved_nothing_is_no_step(state: PlannerState) -> None:
    steps = len(state.plan.history)
    state.begin_drag("left")
    state.end_drag()
    assert len(state.plan.history) == steps
    state.drag("left", "target", T + 5)
    state.undo()  # while the button is still down
    assert state.plan.trajectory("left").target_mm == pytest.approx(T, abs=0)
    assert not state.dragging
