"""Two hands on one plan: what each changed is kept, or the second is told what the first has changed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ronnaplan.ct import SeriesSource
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame
from ronnaplan.planning import Landmarks, Plan, Ruler, Trajectory
from ronnaplan.planning.merging import merged

CT = Frame("CT", "1.2.3")
ELSEWHERE = np.array([1.0, 1.0, 1.0])
AC_PC = Landmarks(np.array([0.0, -12, 0]), np.array([0.0, 12, 0]), np.array([0.0, 0, 40]))


D1 = Ruler("D1", np.eye(3)[1:])


def path(name: str) -> Trajectory:
    return Trajectory(name, np.array([10.0, -20, 80]), np.array([1.0, 2, 3]), CT)


@pytest.fixture
def base() -> Plan:
    return Plan(SeriesSource(frame_of_reference_uid=CT.uid), "ab" * 32).add(path("A")).add(path("B")).add_ruler(D1)


Change = Callable[[Plan], Plan]
CHANGES: dict[str, Change] = {
    "add": lambda plan: plan.add(path("C")),
    "edit": lambda plan: plan.edit("A", target_mm=ELSEWHERE, name="A2", notes="mine"),
    "remove": lambda plan: plan.remove("A"),
    "lock": lambda plan: plan.lock("A"),
    "landmarks": lambda plan: plan.with_landmarks(AC_PC),
    "measure": lambda plan: plan.add_ruler(Ruler("D2", np.eye(3)[:2])),
    "remove measurement": lambda plan: plan.remove_ruler("D1"),
}


def names(plan: Plan) -> list[tuple[str, str, bool, list[float]]]:
    return [(one.name, one.notes, one.locked, one.target_mm.tolist()) for one in plan.trajectories]


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_changes_of_different_things_are_both_kept(base: Plan, change: Change) -> None:
    theirs = base.remove("B").add(path("D")).edit("D", notes="theirs")
    both = merged(base, change(base), theirs)
    assert names(both) == names(change(theirs))
    assert [one.name for one in both.rulers] == [one.name for one in change(theirs).rulers]
    assert (both.landmarks is None) == (change(theirs).landmarks is None)
    assert [step.action for step in both.history[-4:]] == [
        "remove",
        "add",
        "edit",
        change(base).history[-1].action,
    ]
    assert both.revision == theirs.revision + 1


@pytest.mark.parametrize("change", [CHANGES[name] for name in ("edit", "remove", "lock")])
@pytest.mark.parametrize(
    "other", [lambda plan: plan.edit("A", notes="theirs"), lambda plan: plan.remove("A"), CHANGES["lock"]]
)
def test_a_change_of_what_the_other_hand_changed_is_refused(base: Plan, change: Change, other: Change) -> None:
    with pytest.raises(InputError, match="trajectory 'A' was changed by another hand"):
        merged(base, change(base), other(base))


def test_other_landmarks_and_a_name_that_is_taken_are_refused(base: Plan) -> None:
    moved = Landmarks(AC_PC.ac_mm - 1.0, AC_PC.pc_mm, AC_PC.midline_mm)
    with pytest.raises(InputError, match="midline were changed by another hand"):
        merged(base, base.with_landmarks(AC_PC), base.with_landmarks(moved))
    with pytest.raises(InputError, match="already has a trajectory 'C'"):
        merged(base, base.add(path("C")), base.add(path("C")))


def test_what_was_taken_back_is_not_taken_back_from_the_other_hand(base: Plan) -> None:
    theirs = base.edit("A", notes="theirs")
    for mine in (base.undo(), base.undo().redo(), base.lock("A").lock("B"), base):
        with pytest.raises(InputError, match="changed by another hand"):
            merged(base, mine, theirs)


def test_a_plan_of_another_scan_is_not_merged_with(base: Plan) -> None:
    other = Plan(SeriesSource(frame_of_reference_uid="9.9"))
    with pytest.raises(
        FrameMismatchError, match=r"^the plan that another hand wrote is in frame CT \[9\.9\] but the plan"
    ):
        merged(base, base.lock("A"), other)
