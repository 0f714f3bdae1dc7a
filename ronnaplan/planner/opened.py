"""An opened case: its scan and documents, each change written at once, and the way back."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ronnaplan.case.folder import Case
from ronnaplan.case.surroundings import Labels, Rules, Surroundings
from ronnaplan.ct import CTVolume
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.errors import UsageError
from ronnaplan.planner.storage import Storage
from ronnaplan.planning import Plan
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
        self, volume: CTVolume, storage: Storage, rules: Rules | None = None, no_go: Labels | None = None
    ) -> None:
        """Open a case; ``no_go`` are masks (K, J, I) of the scan, by name.

        Raises `FrameMismatchError` where a document is of another scan.
        """
        case = Case(
            volume,
            storage.read_plan() or Plan.of_scan(volume),
            storage.read_fiducials(),
            storage.read_registration(),
            rules or Rules(),
            no_go or {},
        )
        assert case.plan is not None
        self.volume, self.storage, self.no_go = volume, storage, case.no_go
        self.scan = Scan.of(volume)
        self.plan: Plan = case.plan
        self.fiducials: FiducialsDocument | None = case.fiducials
        self.registration: RegistrationDocument | None = case.registration
        self.surroundings: Surroundings = case.surroundings
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
        self.surroundings = self.surroundings.with_documents(self.fiducials, self.registration)
        self.storage.write_document(found)

    def _keep_registration(self, found: RegistrationDocument) -> None:
        self.registration = found
        self.surroundings = self.surroundings.with_documents(self.fiducials, self.registration)
        self.storage.write_document(found)
