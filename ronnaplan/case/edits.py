"""An open case: every change of its plan and markers is checked, written before the method returns, and taken back."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

from ronnaplan.case import marker_edits
from ronnaplan.case.folder import Case, CaseFiles
from ronnaplan.case.judgement import Judgement
from ronnaplan.case.kept_files import KeptFiles, Waiting
from ronnaplan.case.steps import MarkerStep, Steps
from ronnaplan.case.surroundings import Labels, Rules
from ronnaplan.ct import CTVolume
from ronnaplan.documents.agreement import disagreement
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.documents.revision import revised
from ronnaplan.errors import InputError, UnwrittenError, UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Head, Instrument, Landmarks, Plan, Trajectory
from ronnaplan.planning.electrodes import electrode_chosen
from ronnaplan.planning.measures import check_ends
from ronnaplan.planning.merging import merged
from ronnaplan.planning.trajectory import instrument_named

ENDS = ("entry", "target")


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

    def __init__(
        self, volume: CTVolume, files: CaseFiles, rules: Rules | None = None, no_go: Labels | None = None
    ) -> None:
        """Open the case of ``volume`` whose documents lie at ``files``, or will; raises what `Case` raises."""
        self._kept = KeptFiles(files)
        self.require_files = self._kept.require_there
        case = self._kept.case(volume, rules or Rules(), no_go or {})
        self.volume, self.no_go, self.rules, self.surroundings = volume, case.no_go, case.rules, case.surroundings
        self.plan: Plan = Plan.of_scan(volume) if case.plan is None else case.plan
        self.fiducials, self.registration, self.placement = case.fiducials, case.registration, case.placement
        self.before_drag: Plan | None = None
        self.unwritten = Waiting()
        """The change that could not be written."""
        self.followers: list[Callable[[Plan, Plan], None]] = []
        """Told of every change of the plan: as it was, and as it is."""
        self._steps = Steps()

    def look_again(self) -> bool:
        """Take over what another hand has written; return whether there is anything new.

        Raises `InputError` for a document that cannot be read or was removed, after the others were taken over, or for
        one of another scan, when none is.
        """
        if self.dragging:
            return False
        return self._kept.look_again(lambda: self._take_over(self._kept.case(self.volume, self.rules, self.no_go)))

    def _take_over(self, case: Case) -> None:
        others = (case.fiducials, case.registration) != (self.fiducials, self.registration)
        if others:
            self._steps.forget_markers()
        self.placement = case.placement
        if others or case.rules.limits is not self.rules.limits:
            self.fiducials, self.registration, self.rules = case.fiducials, case.registration, case.rules
            self.surroundings = self.surroundings.with_documents(self.rules, self.fiducials, self.registration)
        if case.plan is not None and case.plan is not self.plan:
            self._steps.count_others(len(case.plan.history) - len(self.plan.history))
            self._show_plan(case.plan)

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

    def choose_electrode(self, name: str, model: str) -> None:
        """Let an electrode of the catalogue stay along a trajectory, its tip at the target, or ``none``."""
        self.edit(name, electrode=electrode_chosen(model))

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
        """Keep a plan that is one step further; one that changes nothing is no step."""
        if plan is self.plan:
            return
        before = self.plan
        after = sound(before, plan, self.surroundings.head)
        try:
            self._keep_plan(after)
        except UnwrittenError as error:
            self.unwritten.keep(error, lambda: self._change_plan_again(before, plan))
            raise
        self._steps.add(None)

    def _change_plan_again(self, before: Plan, plan: Plan) -> None:
        self.change_plan(plan if self.plan is before else merged(before, plan, self.plan))

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
        """Move one end of a trajectory to any place (3,), LPS mm; the whole drag is one step that can be undone."""
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

    def replace_markers(self, found: FiducialsDocument) -> None:
        """Put other markers in the place of those there were."""
        before = self.fiducials or found.model_copy(update={"fiducials": (), "rejected": ()})
        if self.plan.undone:  # a step aside: what was taken back before it cannot be made again
            self._keep_plan(replace(self.plan, undone=()))
        self._keep_fiducials(found)
        self._steps.add(MarkerStep(before, found))

    def reject_marker(self, label: str) -> None:
        """Turn a marker down."""
        self._edit_markers(marker_edits.reject(self.found, label))

    def accept_marker(self, index: int) -> None:
        """Take the ``index``-th rejected candidate back, if it was a person who turned it down."""
        self._edit_markers(marker_edits.accept(self.found, index))

    def rename_marker(self, label: str, new: str) -> None:
        """Give a marker another label; a registration of the markers gets it, too."""
        self._edit_markers(marker_edits.rename(self.found, label, new))

    def _edit_markers(self, edited: FiducialsDocument) -> None:
        before = self.found
        try:
            self.replace_markers(edited)
        except UnwrittenError as error:
            self.unwritten.keep(error, lambda: self._edit_markers_again(before, edited))
            raise

    def _edit_markers_again(self, before: FiducialsDocument, edited: FiducialsDocument) -> None:
        if self.fiducials is not before:
            raise InputError("the markers were changed meanwhile; look at them as they are now, then change them")
        self._edit_markers(edited)

    def keep_registration(self, found: RegistrationDocument) -> None:
        """Keep a registration in the place of the one there was; this is no step that can be undone."""
        self.registration = self._kept.registration.write(revised(found, self._kept.registration.content))
        self.surroundings = self.surroundings.with_documents(self.rules, self.fiducials, self.registration)

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
        return self._steps.any_done or bool(self.plan.history)

    @property
    def can_redo(self) -> bool:
        """Whether there is a change to make again."""
        return self._steps.any_undone or bool(self.plan.undone)

    def undo(self) -> None:
        """Take the last change of plan or markers back; raises `InputError` when there is none.

        A drag under way is let go first.
        """
        self.end_drag()
        step = self._steps.done
        if step is None:
            self._keep_plan(self.plan.undo())
        else:
            self._keep_fiducials(step.before)
        self._steps.take_back(step)

    def redo(self) -> None:
        """Make the change again that was taken back last; raises `InputError` when there is none."""
        step = self._steps.undone
        if step is None:
            self._keep_plan(self.plan.redo())
        else:
            self._keep_fiducials(step.after)
        self._steps.make_again(step)

    def _keep_plan(self, plan: Plan) -> None:
        written = self._kept.plan.write(plan)
        if written is not plan:
            self._steps.count_others(len(written.history) - len(plan.history))
        self._show_plan(written)

    def _show_plan(self, plan: Plan) -> None:
        before, self.plan = self.plan, plan
        for follow in self.followers:
            follow(before, plan)

    def _keep_fiducials(self, found: FiducialsDocument) -> None:
        before = self.fiducials
        self.fiducials = self._kept.fiducials.write(revised(found, self._kept.fiducials.content))
        if before is not None and self.registration is not None:
            renamed = marker_edits.carried_over(self.registration, before, self.fiducials)
            if renamed != self.registration:
                kept = self._kept.registration
                # Unwritten, as where another hand changed it, it is of markers that are not there, and said so.
                with suppress(InputError):
                    self.registration = kept.write(revised(renamed, kept.content))
        self.surroundings = self.surroundings.with_documents(self.rules, self.fiducials, self.registration)


def _ends_mm(one: Trajectory) -> tuple[float, ...]:
    return (*one.entry_mm, *one.target_mm)
