"""The files of an open case, as they were last seen or written: what another hand does to them is noticed.

The change that could not be written, as on a full disk, waits until it can be, or is given up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ronnaplan.case.folder import Case, CaseFiles, placement_at
from ronnaplan.case.surroundings import Labels, Rules
from ronnaplan.ct import CTVolume
from ronnaplan.documents.fiducials import FiducialsDocument, read_fiducials
from ronnaplan.documents.limits import read_limits
from ronnaplan.documents.open_document import Kept
from ronnaplan.documents.plan import plan_text, read_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.documents.registration import RegistrationDocument, read_registration
from ronnaplan.errors import RonnaplanError, UnwrittenError, UsageError
from ronnaplan.planning import Limits, Plan
from ronnaplan.planning.merging import merged

if TYPE_CHECKING:
    from ronnaplan.documents.placement import PlacementDocument

Documents = tuple[Plan | None, FiducialsDocument | None, RegistrationDocument | None]


class KeptFiles:
    """Plan, fiducials, registration, limits and placement; each ``content`` is None where there is no file yet.

    ``limits`` and ``placement`` are only read, and None where no file is named for them.
    """

    def __init__(self, files: CaseFiles) -> None:
        """Read what there is of ``files``; raises `UsageError` unless the three that are written are named."""
        if files.plan is None or files.fiducials is None or files.registration is None:
            raise UsageError("a case is worked on in three files; name plan, fiducials and registration")
        self._files = files
        self.plan = Kept(files.plan, read_plan, plan_text, merged)
        self.fiducials = Kept(files.fiducials, read_fiducials, to_json)
        self.registration = Kept(files.registration, read_registration, to_json)
        self.limits: Kept[Limits] | None = Kept(files.limits, read_limits, repr) if files.limits else None
        self.placement: Kept[PlacementDocument] | None = (
            Kept(files.placement, placement_at, to_json) if files.placement else None
        )

    @property
    def documents(self) -> Documents:
        """The documents as they were last seen."""
        return self.plan.content, self.fiducials.content, self.registration.content

    def case(self, volume: CTVolume, rules: Rules, no_go: Labels) -> Case:
        """Return the documents as they were last seen, checked to belong together."""
        documents = *self.documents, self.stated(rules), no_go
        return Case(volume, *documents, placement=self.placed, files=self._files)

    def stated(self, rules: Rules) -> Rules:
        """Return ``rules`` with the limits that were last seen in their file, if there is one."""
        limits = None if self.limits is None else self.limits.content
        return rules if limits is None else replace(rules, limits=limits)

    @property
    def placed(self) -> PlacementDocument | None:
        """Where the robot shall stand, as last seen."""
        return None if self.placement is None else self.placement.content

    @property
    def _every(self) -> list[Kept[Any]]:
        only_read = (self.limits, self.placement)
        return [self.plan, self.fiducials, self.registration, *(one for one in only_read if one is not None)]

    def require_there(self) -> None:
        """Raise `InputError` where a document was removed that still counts: the files are another case."""
        for one in self._every:
            one.require_there()

    def look_again(self, take_over: Callable[[], None]) -> bool:
        """Have ``take_over`` called where another hand has written anything; return whether it was.

        Raises `InputError` for a document that cannot be read or was removed, after the others were taken over, and
        what ``take_over`` raises; then the documents are as before.
        """
        kept = self._every
        before = [one.content for one in kept]
        unread: list[RonnaplanError] = []
        for one in kept:
            try:
                one.look_again()
            except RonnaplanError as error:
                unread.append(error)
        changed = any(one.content is not then for one, then in zip(kept, before, strict=True))
        if changed:
            try:
                take_over()
            except RonnaplanError:
                for one, content in zip(kept, before, strict=True):  # the next change is made to what is shown
                    one.content = content
                raise
        if unread:
            raise unread[0]
        return changed


class Waiting:
    """Keeps one change: none that waits is dropped for a later one, which is made to what is shown, without it."""

    def __init__(self) -> None:
        self._make: Callable[[], None] | None = None

    def __bool__(self) -> bool:
        """Whether a change waits."""
        return self._make is not None

    def keep(self, error: UnwrittenError, make: Callable[[], None]) -> None:
        """Let a change wait that ``make`` makes; raises `UnwrittenError` where another one waits."""
        if self._make is not None:
            raise UnwrittenError(
                f"{error}; this change is not made, as one before it still waits to be written: "
                "let that be written, or give it up first"
            ) from error
        self._make = make

    def make(self) -> bool:
        """Make the change that waits, if there is one; return whether it was made.

        Raises `UnwrittenError`, and it waits on, where it still cannot be written; what else is wrong with it ends it.
        """
        make, self._make = self._make, None
        if make is not None:
            make()
        return make is not None

    def give_up(self) -> None:
        """Do without the change that waits."""
        self._make = None
