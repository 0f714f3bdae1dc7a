"""The work of a registration that another process does: readings taken and paired. It loads nothing of the planner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ronnaplan.geometry import Points

if TYPE_CHECKING:
    from ronnaplan.registration.marker_registration import MarkerRegistration
    from ronnaplan.tracking import Recording


@dataclass(frozen=True, eq=False)
class Paired:
    """What came of ``readings_mm`` with ``known_pairs`` pointed at."""

    readings_mm: Points
    notes: tuple[str, ...]
    known_pairs: dict[str, str]
    found: MarkerRegistration


@dataclass(frozen=True, eq=False)
class Sought:
    """The markers that readings are to be paired with, and the errors (per axis) counted on."""

    markers_mm: Points
    sigma_ct_mm: float
    sigma_ots_mm: float

    def in_recording(self, record: Callable[[], Recording]) -> Paired:
        """Register with the markers that a tracker saw."""
        from ronnaplan.tracking import find_markers
        from ronnaplan.tracking.told import readings_told

        recording = record()
        seen = find_markers(recording, sigma_mm=self.sigma_ots_mm)
        return self.in_readings(seen.points, readings_told(recording, seen))

    def in_readings(
        self, readings_mm: Points, notes: tuple[str, ...], known_pairs: dict[str, str] | None = None
    ) -> Paired:
        """Register with readings, some of which a person pointed at."""
        from ronnaplan.registration.marker_registration import register_markers

        pairs = known_pairs or {}
        found = register_markers(
            self.markers_mm, readings_mm, sigma_ct_mm=self.sigma_ct_mm, known_pairs=tuple(pairs.items())
        )
        return Paired(readings_mm, notes, pairs, found)
