"""The markers that a tracker saw: each with a mean, a covariance and the reasons to doubt it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ronnaplan.geometry import FloatArray, Frame, Points
from ronnaplan.text import counted, place


class MarkerFlag(StrEnum):
    """Reasons to doubt a marker's mean position."""

    MOVED = "moved while it was recorded"
    LOST = "no longer seen at the end"
    DROPOUTS = "missing in more than a tenth of the frames"
    SINGLE_READING = "read once only"


@dataclass(frozen=True, eq=False)
class TrackedMarker:
    """One marker: its mean (3,) with covariance (3, 3), how it was seen, and how far it moved (0: not surely)."""

    label: str
    position_mm: FloatArray
    covariance_mm2: FloatArray
    readings: int
    outliers: int
    flags: tuple[MarkerFlag, ...]
    moved_mm: float = 0.0

    def __repr__(self) -> str:
        flags = "".join(f", {flag}" for flag in self.flags)
        return f"TrackedMarker({self.label} at {place(self.position_mm)} mm, {self.readings} readings{flags})"


@dataclass(frozen=True, eq=False)
class RejectedTrack:
    """Readings that are no marker, and why."""

    position_mm: FloatArray
    readings: int
    reason: str

    def __repr__(self) -> str:
        return f"RejectedTrack(at {place(self.position_mm)} mm, {self.readings} readings: {self.reason})"


@dataclass(frozen=True)
class MarkerReadings:
    """The markers of a recording of so many ``frames``, in the coordinates of its ``frame``, mm."""

    markers: tuple[TrackedMarker, ...]
    rejected: tuple[RejectedTrack, ...]
    frames: int
    frame: Frame

    def __repr__(self) -> str:
        doubted = sum(bool(marker.flags) for marker in self.markers)
        flags = f", {doubted} flagged" if doubted else ""
        return (
            f"MarkerReadings({counted(len(self.markers), 'marker')} in {counted(self.frames, 'frame')} of "
            f"{self.frame}{flags}, {counted(len(self.rejected), 'track')} rejected)"
        )

    @property
    def points(self) -> Points:
        """The markers as labelled points with covariances."""
        count = len(self.markers)
        return Points(
            np.array([m.position_mm for m in self.markers]).reshape(count, 3),
            np.array([m.covariance_mm2 for m in self.markers]).reshape(count, 3, 3),
            tuple(m.label for m in self.markers),
            self.frame,
        )
