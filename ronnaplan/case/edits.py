"""An open case: every change of its plan and markers is checked, written before the method returns, and taken back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from ronnaplan.case import marker_edits
from ronnaplan.case.folder import Case
from ronnaplan.case.surroundings import Judgement, Surroundings
from ronnaplan.documents.agreement import disagreement
from ronnaplan.documents.fiducials import FiducialsDocument, fiducials_document
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.errors import InputError, UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Head, Instrument, Landmarks, Plan, Trajectory
from ronnaplan.planning.measures import check_ends
from ronnaplan.planning.trajectory import instrument_named

ENDS = ("entry", "target")


class Keeper(Protocol):
    """What writes the documents of a case, whole or not at all."""

    def write_plan(self, plan: Plan) -> None:
        """Write the plan."""

    def write_document(self, document: FiducialsDocument | RegistrationDocument) -> None:
        """Write the markers or the registration."""


@dataclass(frozen=True, eq=False)
class MarkerStep:
    """One change of the markers."""

    before: FiducialsDocument
    after: FiducialsDocument


Step = MarkerStep | None
"""A step of this session; None is one that the plan's own history holds."""


def sound(before: Plan, after: Plan, head: Head) -> Plan:
    """Return ``after`` if the ends that are new in it lie in the head.

    Raises `InputError` for an end outside the scan or in air, `FrameMismatchError` for a plan of another scan.
    """
    after.require_scan(head.volume)
    known = {_ends_mm(one) for one in before.trajectories}
    for one in after.trajectories:
        if _ends_mm(one) not in known:
            check_ends(one, head)
    return after


class OpenCase:
    """The documents of one scan while a person works on them."""

    def __init__(self, case: Case, keeper: Keeper) -> None:
        """Open ``case``, whose documents ``keeper`` writes; raises `InputError` without a scan or a plan."""
        if case.volume is None or case.plan is None:
            raise InputError("a case without a scan and a plan cannot be worked on; give both")
        self.volume, self.no_go, self.rules = case.volume, case.no_go, case.rules
        self.plan: Plan = case.plan
        self.fiducials: FiducialsDocument | None = case.fiducials
        self.registration: RegistrationDocument | None = case.registration
        self.surroundings: Surroundings = case.surroundings
        self.before_drag: Plan | None = None
        self.followers: list[Callable[[Plan, Plan], None]] = []
        """Told of every change of the plan: as it was, and as it is."""
        self._keeper = keeper
        self._done: list[Step] = []
        self._undone: list[Step] = []

    def judge(self, trajectory: Trajectory) -> Judgement:
        """Return measures, verdicts and expected error of a trajectory as it is now, or why there are none.

        While an end is dragged, distances to no-go regions are to their voxels only.
        """
        return self.surroundings.judge(trajectory, self.plan, rough=self.dragging)

    # --- the plan --------------------------------------------------------------------------------------------

    def add(self, trajectory: Trajectory) -> None:
        """Add a trajectory; one with an end outside the scan or in air is refused."""
        self.change_plan(self.plan.add(trajectory))

    def edit(self, name: str, /, **changes: Any) -> None:
        """Change fields of a trajectory in one step; a locked one or a bad end is refused."""
        self.change_plan(self.plan.edit(name, **changes))

    def rename(self, name: str, new: str) -> None:
        """Give a trajectory another name, which must be new and not empty."""
        self.edit(name, name=new.strip())

    def choose_instrument(self, name: str, kind: str) -> None:
        """Give a trajectory an instrument of the catalogue."""
        self.edit(name, instrument=instrument_named(kind))

    def size_instrument(self, name: str, size: str, value_mm: float) -> None:
        """Change the ``diameter`` or ``length`` of a trajectory's instrument, in mm."""
        used = self.plan.trajectory(name).instrument
        sizes = {"diameter": used.diameter_mm, "length": used.length_mm}
        if size not in sizes:
            raise UsageError(f"an instrument has no {size}; it has diameter and length")
        sizes[size] = value_mm
        self.edit(name, instrument=Instrument(used.name, sizes["diameter"], sizes["length"]))

    def remove(self, name: str) -> None:
        """Remove a trajectory; a locked one is refused."""
        self.change_plan(self.plan.remove(name))

    def lock(self, name: str, locked: bool) -> None:
        """Lock a trajectory against change, or unlock it."""
        self.change_plan(self.plan.lock(name, locked))

    def set_landmarks(self, landmarks: Landmarks) -> None:
        """State AC, PC and a point of the midline."""
        self.change_plan(self.plan.with_landmarks(landmarks))

    def change_plan(self, plan: Plan) -> None:
        """Keep a plan that is one step further."""
        self._keep_plan(sound(self.plan, plan, self.surroundings.head))
        self._step(None)

    # --- dragging --------------------------------------------------------------------------------------------

    @property
    def dragging(self) -> bool:
        """Whether an end is being dragged just now."""
        return self.before_drag is not None

    def begin_drag(self, name: str) -> None:
        """Begin to move a trajectory with the mouse; a locked one is refused."""
        self.plan.edit(name)
        self.before_drag = self.plan

    def drag(self, name: str, end: str, place_mm: FloatArray) -> None:
        """Move one end of a trajectory, anywhere; the whole drag is one step that can be undone."""
        if end not in ENDS:
            raise UsageError(f"a trajectory has no end {end}; it has entry and target")
        if self.before_drag is None:
            self.begin_drag(name)
        assert self.before_drag is not None
        self.plan = self.before_drag.edit(name, **{f"{end}_mm": place_mm})

    def end_drag(self) -> None:
        """Let go: what was dragged is written; an end outside the scan or in air goes back to where it was."""
        before, dragged, self.before_drag = self.before_drag, self.plan, None
        if before is not None and before is not dragged:
            self.plan = before
            self.change_plan(dragged)

    # --- markers and registration ----------------------------------------------------------------------------

    @property
    def found(self) -> FiducialsDocument:
        """The markers; raises `UsageError` where none are known."""
        if self.fiducials is None:
            raise UsageError("no markers are known; localize them first")
        return self.fiducials

    def find_markers(self, diameter_mm: float) -> FiducialsDocument:
        """Look for markers of another diameter; changes nothing yet."""
        from ronnaplan.localization import localize

        return fiducials_document(localize(self.volume, diameter_mm=diameter_mm))

    def replace_markers(self, found: FiducialsDocument) -> None:
        """Put other markers in the place of those there were."""
        before = self.fiducials or found.model_copy(update={"fiducials": (), "rejected": ()})
        if self.plan.undone:  # a step aside: what was taken back before it cannot be made again
            self._keep_plan(replace(self.plan, undone=()))
        self._keep_fiducials(found)
        self._step(MarkerStep(before, found))

    def reject_marker(self, label: str) -> None:
        """Turn a marker down."""
        self.replace_markers(marker_edits.reject(self.found, label))

    def accept_marker(self, index: int) -> None:
        """Take the ``index``-th rejected candidate back, if it was a person who turned it down."""
        self.replace_markers(marker_edits.accept(self.found, index))

    def rename_marker(self, label: str, new: str) -> None:
        """Give a marker another label."""
        self.replace_markers(marker_edits.rename(self.found, label, new))

    def keep_registration(self, found: RegistrationDocument) -> None:
        """Keep a registration in the place of the one there was; this is no step that can be undone."""
        self._keeper.write_document(found)
        self.registration = found
        self.surroundings = self.surroundings.with_documents(self.fiducials, found)

    @property
    def outdated(self) -> str | None:
        """Why the registration no longer holds for the markers as they are now, None where it does."""
        if self.registration is None or self.fiducials is None:
            return None
        return disagreement(self.fiducials, self.registration)

    # --- the way back ----------------------------------------------------------------------------------------

    @property
    def can_undo(self) -> bool:
        """Whether there is a change to take back: of this session, or an earlier one of the plan."""
        return bool(self._done or self.plan.history)

    @property
    def can_redo(self) -> bool:
        """Whether there is a change to make again."""
        return bool(self._undone or self.plan.undone)

    def undo(self) -> None:
        """Take the last change of plan or markers back; raises `InputError` when there is none.

        A drag under way is let go first.
        """
        self.end_drag()
        step = self._done[-1] if self._done else None
        if step is None:
            self._keep_plan(self.plan.undo())
        else:
            self._keep_fiducials(step.before)
        self._undone.append(step)
        del self._done[-1:]

    def redo(self) -> None:
        """Make the change again that was taken back last; raises `InputError` when there is none."""
        step = self._undone[-1] if self._undone else None
        if step is None:
            self._keep_plan(self.plan.redo())
        else:
            self._keep_fiducials(step.after)
        self._done.append(step)
        del self._undone[-1:]

    def _step(self, step: Step) -> None:
        self._done.append(step)
        self._undone.clear()

    def _keep_plan(self, plan: Plan) -> None:
        self._keeper.write_plan(plan)
        before, self.plan = self.plan, plan
        for follow in self.followers:
            follow(before, plan)

    def _keep_fiducials(self, found: FiducialsDocument) -> None:
        self._keeper.write_document(found)
        self.fiducials = found
        self.surroundings = self.surroundings.with_documents(found, self.registration)


def _ends_mm(one: Trajectory) -> tuple[float, ...]:
    return (*one.entry_mm, *one.target_mm)
