"""Registration in the planner: readings taken, the pairing, and pointing at one marker where it is ambiguous."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ronnaplan.case import marker_edits
from ronnaplan.case.edits import OpenCase
from ronnaplan.case.expectation import errors_at_ends_mm
from ronnaplan.documents.fiducials import FiducialEntry, Source
from ronnaplan.documents.registration_made import registration_document
from ronnaplan.errors import UsageError
from ronnaplan.geometry import Points
from ronnaplan.planner.pairing import Paired, Sought
from ronnaplan.planner.storage import Storage
from ronnaplan.planner.worker import Job, Start


class Registering:
    """The tracker's readings of an open case, and what was pointed at."""

    def __init__(self, case: OpenCase, storage: Storage, start: Start) -> None:
        """No readings are loaded yet."""
        self.case, self.storage, self.start = case, storage, start
        self.readings_mm: Points | None = None
        self.notes: tuple[str, ...] = ()
        self._known_pairs: dict[str, str] = {}
        self._touch: str | None = None
        self._paired: tuple[FiducialEntry, ...] = ()
        """The markers that both name."""
        self._pointed: FiducialEntry | None = None
        self.pointed_reading: str | None = None

    def load_readings(self, name: str) -> None:
        """Register with the readings file ``name`` of the case's folder."""
        from ronnaplan.tracking import read_recording

        path = self.storage.readings_path(name)
        self._register(
            f"registering with {name}", partial(self._sought.in_recording, partial(read_recording, path))
        )

    def listen(self, host: str, port: int) -> None:
        """Register with what an OpenIGTLink server sends for some seconds."""
        from ronnaplan.tracking.openigtlink import record

        work = partial(self._sought.in_recording, partial(record, host, port))
        self._register(f"listening to {host}:{port}", work)

    def register(self, readings_mm: Points, notes: tuple[str, ...] = ()) -> None:
        """Register the markers with a tracker's readings; a refused pairing is kept with its rivals."""
        self._register("registering", partial(self._sought.in_readings, readings_mm, notes))

    def point_at(self, label: str, reading: str) -> None:
        """Say which reading a marker is, and register again."""
        marker_edits.named(self.case.found, label)
        if self.readings_mm is None:
            raise UsageError("no readings are loaded; choose a readings file first")
        pairs = {ct: ots for ct, ots in self.known_pairs.items() if ots != reading} | {label: reading}
        work = partial(self._sought.in_readings, self.readings_mm, self.notes, pairs)
        self._register(f"registering with {label} as {reading}", work)

    @property
    def known_pairs(self) -> dict[str, str]:
        """Which reading each marker is that was pointed at, until markers change: another may have its label then."""
        return self._known_pairs if self._same_markers else {}

    @property
    def touch(self) -> str | None:
        """The marker that tells most when it is touched with the pointer, until markers change."""
        return self._touch if self._same_markers else None

    @property
    def _same_markers(self) -> bool:
        found = self.case.fiducials
        return found is not None and found.fiducials == self._paired

    @property
    def pointing(self) -> bool:
        """Whether a click on a marker and one on a reading would settle which reading the marker is."""
        found = self.case.registration
        asked = found is not None and found.status == "ambiguous" and not self.case.outdated
        return asked and self.readings_mm is not None

    @property
    def pointed_marker(self) -> str | None:
        """The marker that was pointed at, until it has another label: another one may have its label then."""
        found = self.case.fiducials
        return self._pointed.label if self._pointed and found and self._pointed in found.fiducials else None

    def pick_marker(self, label: str) -> None:
        """Point at a marker, if the pairing is ambiguous."""
        if self.pointing:
            self._pointed = marker_edits.named(self.case.found, label)
            self._settle()

    def pick_reading(self, label: str) -> None:
        """Point at a reading; raises `UsageError` unless the pairing is ambiguous."""
        if not self.pointing or self.readings_mm is None:
            raise UsageError("the pairing is not ambiguous; there is nothing to settle by pointing")
        if label not in self.readings_mm.labels:
            raise UsageError(f"there is no reading {label}; there are {', '.join(self.readings_mm.labels)}")
        self.pointed_reading = label
        self._settle()

    def leave_pointing(self) -> None:
        """Forget what was pointed at so far."""
        self._pointed = self.pointed_reading = None

    def expected_errors_mm(self) -> dict[str, float]:
        """Return the expected error (RMS) of the registration at every end of every trajectory."""
        return errors_at_ends_mm(self.case.surroundings.expected, self.case.registration, self.case.plan)

    def _settle(self) -> None:
        marker, reading = self.pointed_marker, self.pointed_reading
        if marker is not None and reading is not None:
            self.leave_pointing()
            self.point_at(marker, reading)

    @property
    def _sought(self) -> Sought:
        """The markers as they are now."""
        rules = self.case.surroundings.rules
        return Sought(self.case.found.points, rules.sigma_ct_mm, rules.sigma_ots_mm)

    def _register(self, what: str, work: Callable[[], Paired]) -> None:
        source = Source.model_validate(self.case.found.source.model_dump())
        self.start(Job(what, work, lambda made: self._keep(made, source)))

    def _keep(self, made: Paired, source: Source) -> None:
        self.leave_pointing()
        self.case.keep_registration(registration_document(made.found, source, self.case.plan.points, made.notes))
        self.readings_mm, self.notes, self._known_pairs = made.readings_mm, made.notes, made.known_pairs
        self._paired = self.case.found.fiducials
        touch = made.found.pairing.touch
        self._touch = None if touch is None else made.found.ct.labels[touch]
