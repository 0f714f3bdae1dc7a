"""What was done in one session, step by step: what can be taken back, and what can be made again."""

from __future__ import annotations

from dataclasses import dataclass

from ronnaplan.documents.fiducials import FiducialsDocument


@dataclass(frozen=True, eq=False)
class MarkerStep:
    """One change of the markers."""

    before: FiducialsDocument
    after: FiducialsDocument


Step = MarkerStep | None
"""A step of this session; None is one that the plan's own history holds."""


class Steps:
    """The steps that were made, the last one last, and those that were taken back."""

    def __init__(self) -> None:
        self._done: list[Step] = []
        self._undone: list[Step] = []

    @property
    def done(self) -> Step:
        """What is to be taken back next; where this session did nothing, a step of the plan's history."""
        return self._done[-1] if self._done else None

    @property
    def undone(self) -> Step:
        """What is to be made again next; where this session took nothing back, a step of the plan's history."""
        return self._undone[-1] if self._undone else None

    @property
    def any_done(self) -> bool:
        """Whether this session did anything."""
        return bool(self._done)

    @property
    def any_undone(self) -> bool:
        """Whether this session took anything back."""
        return bool(self._undone)

    def add(self, step: Step) -> None:
        """Add a step; what was taken back before cannot be made again."""
        self._done.append(step)
        self._undone.clear()

    def take_back(self, step: Step) -> None:
        """Move ``step`` from what was done to what was taken back."""
        self._undone.append(step)
        del self._done[-1:]

    def make_again(self, step: Step) -> None:
        """Move ``step`` from what was taken back to what was done."""
        self._done.append(step)
        del self._undone[-1:]

    def count_others(self, changes: int) -> None:
        """Put ``changes`` of the plan by another hand among the steps; a negative number were taken back."""
        self._undone.clear()
        self._done += [None] * changes
        for _ in range(-changes):
            last = next((at for at in reversed(range(len(self._done))) if self._done[at] is None), None)
            if last is not None:
                del self._done[last]

    def forget_markers(self) -> None:
        """Forget the changes of markers that another hand has changed since, and what was taken back."""
        self._done, self._undone = [step for step in self._done if step is None], []
