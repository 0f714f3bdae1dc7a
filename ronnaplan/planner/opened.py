"""An opened case: its scan and documents, each change written at once, and the way back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from ronnaplan.ct import CTVolume
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.errors import UsageError
from ronnaplan.planner.judgement import Labels, Surroundings
from ronnaplan.planner.storage import Storage
from ronnaplan.planning import Limits, Plan
from ronnaplan.planning.sampling import Scan


@dataclass(frozen=True, eq=False)
class MarkerStep:
    """One change of the markers."""

    before: FiducialsDocument
    after: FiducialsDocument


Step = MarkerStep | None
"""A step of this session; None is one that the plan's own history holds."""


class OpenedCase:
    """The documents of one scan. Every change is written to its file before the method returns."""

    def __init__(
        self, volume: CTVolume, storage: Storage, limits: Limits | None = None, no_go: Labels | None = None
    ) -> None:
        """Open a case; ``no_go`` are masks (K, J, I) of the scan, by name.

        Raises `FrameMismatchError` where a document is of another scan.
        """
        self.volume, self.storage, self.limits = volume, storage, limits or Limits()
        self.no_go = no_go or {}
        self.scan = Scan.of(volume)
        self.plan = storage.read_plan() or Plan.of_scan(volume)
        self.plan.require_scan(volume)
        self.fiducials: FiducialsDocument | None = storage.read_fiducials()
        if self.fiducials is not None:
            volume.frame.require(self.fiducials.points.frame)
        self.registration: RegistrationDocument | None = storage.read_registration()
        if self.registration is not None:
            self.registration.require_frame(volume.frame)
        self._done: list[Step] = []
        self._undone: list[Step] = []

    @property
    def can_undo(self) -> bool:
        """Whether there is a change to take back: of this session, or an earlier one of the plan."""
        return bool(self._done or self.plan.history)

    @property
    def can_redo(self) -> bool:
        """Whether there is a change to make again."""
        return bool(self._undone or self.plan.undone)

    def undo(self) -> None:
        """Take the last change of plan or markers back; raises `InputError` when there is none."""
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

    @cached_property
    def surroundings(self) -> Surroundings:
        """The head with all that a trajectory is measured against; renewed when the markers change."""
        return Surroundings(self.volume, self.fiducials, self.no_go)

    @property
    def found(self) -> FiducialsDocument:
        """The markers; raises `UsageError` where none are known."""
        if self.fiducials is None:
            raise UsageError("no markers are known; localize them first")
        return self.fiducials

    def _change_plan(self, plan: Plan) -> None:
        self._done.append(None)
        self._undone.clear()
        self._keep_plan(plan)

    def _change_fiducials(self, found: FiducialsDocument) -> None:
        before = self.fiducials or found.model_copy(update={"fiducials": (), "rejected": ()})
        self._done.append(MarkerStep(before, found))
        self._undone.clear()
        if self.plan.undone:  # a step aside: what was taken back before it cannot be made again
            self._keep_plan(replace(self.plan, undone=()))
        self._keep_fiducials(found)

    def _keep_plan(self, plan: Plan) -> None:
        self.plan = plan
        self.storage.write_plan(plan)

    def _keep_fiducials(self, found: FiducialsDocument) -> None:
        self.fiducials = found
        self.__dict__.pop("surroundings", None)
        self.storage.write_document(found)
