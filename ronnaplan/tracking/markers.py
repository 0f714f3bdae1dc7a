"""From stray readings over many frames to markers, each with a mean and a covariance.

Trackers list stray markers in any order, drop some, and add reflections. Readings are followed from frame to
frame: each frame's readings are assigned to the tracks known so far at the least total distance, within a
gate; what fits none begins a track. Tracks seen in too few frames are rejected, with that reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import LARGEST_SIGMA_MM, FloatArray, Frame, Points
from ronnaplan.sigmas import SIGMA_OTS_MM
from ronnaplan.tracking.recording import PointReading, Recording

GATE_MM = 4.0
"""A reading further than this from a marker's recent median position is another marker's (or a reflection)."""
RECENT = 5
"""How many of a marker's last readings make that median."""
SEEN_SHARE = 0.5
"""A track of stray readings seen in a smaller share of the frames is a reflection or an outlier, not a marker."""
OUTLIER_SDS = 6.0
"""Readings further from the median than this many robust standard deviations are left out of the mean."""
SMALLEST_SD_MM = 0.02
"""Floor of the robust standard deviation, so that digital resolution makes no outliers."""
MOVED_MM = 0.5
"""A marker whose first and last quarter of readings differ by more than this (and 5 standard errors) has moved."""
LOST_SHARE = 0.1
"""A marker unseen in this last share of the frames is lost."""
MOST_MARKERS = 1000
"""No tracker sees more at once: a recording that names more does not name markers."""
MOST_TRACKS = 20_000
"""An hour of frames, each with a reflection elsewhere, has fewer."""
FAR = 1e6
"""Cost of a pair beyond the gate: more than any sum of distances within it."""


class MarkerFlag(StrEnum):
    """Reasons to doubt a marker's mean position."""

    MOVED = "moved while it was recorded"
    LOST = "no longer seen at the end"
    DROPOUTS = "missing in more than a tenth of the frames"
    SINGLE_READING = "read once only"


@dataclass(frozen=True, eq=False)
class Marker:
    """One marker: its mean, the covariance of that mean, and how it was seen."""

    label: str
    position_mm: FloatArray
    covariance_mm2: FloatArray
    readings: int
    outliers: int
    flags: tuple[MarkerFlag, ...]


@dataclass(frozen=True, eq=False)
class RejectedTrack:
    """Readings that are no marker, and why."""

    position_mm: FloatArray
    readings: int
    reason: str


@dataclass(frozen=True)
class MarkerReadings:
    """The markers of a recording."""

    markers: tuple[Marker, ...]
    rejected: tuple[RejectedTrack, ...]
    frames: int
    frame: Frame

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


def find_markers(recording: Recording, *, sigma_mm: float = SIGMA_OTS_MM) -> MarkerReadings:
    """Return the markers that ``recording`` saw, labelled as the source does or 1, 2, ... in order of appearance.

    ``sigma_mm`` is the tracker's error per axis that averaging does not remove. Readings that share a label
    are one marker; a recording of tool poses alone gives each tool's origin. Raises `InputError` if nothing
    usable was read.
    """
    if not 0 <= sigma_mm < LARGEST_SIGMA_MM:
        raise InputError(
            f"the tracker error is {sigma_mm} mm; expected a standard deviation of zero or more, "
            f"below {LARGEST_SIGMA_MM:g} mm"
        )
    readings = [r for r in recording.points if r.usable] or _tool_origins(recording)
    if not readings:
        raise InputError(f"{recording.source} holds no usable reading ({_reasons(recording)}); record it again")
    source = recording.points or recording.tools  # a stream numbers the frames of points and of each tool apart
    frames = sorted({r.frame for r in source})
    named: dict[str, list[PointReading]] = {}
    for reading in readings:
        named.setdefault(reading.label, []).append(reading)
    strays = named.pop("", [])
    if len(named) > MOST_MARKERS:
        raise InputError(
            f"{recording.source} names {len(named)} markers; expected {MOST_MARKERS} at most, so check its labels"
        )
    markers: list[Marker] = []
    rejected: list[RejectedTrack] = []
    for track in [*named.values(), *_follow(strays)]:
        if not track[0].label and len({r.frame for r in track}) < SEEN_SHARE * len(frames):
            middle = np.median([r.position_mm for r in track], axis=0)
            seen = f"seen in {len({r.frame for r in track})} of {len(frames)} frames"
            rejected.append(RejectedTrack(middle, len(track), seen))
            continue
        kept = _agreeing(np.array([r.position_mm for r in track]))
        if not len(kept):
            middle = np.median([r.position_mm for r in track], axis=0)
            rejected.append(RejectedTrack(middle, len(track), "no two of its coordinates agree"))
            continue
        label = track[0].label or _unused_number(markers)
        markers.append(_summarize(track, kept, label, frames, sigma_mm))
    return MarkerReadings(tuple(markers), tuple(rejected), len(frames), recording.frame)


def _unused_number(markers: list[Marker]) -> str:
    used = {marker.label for marker in markers}
    return next(str(n) for n in range(1, len(markers) + 2) if str(n) not in used)


def _follow(readings: Sequence[PointReading]) -> list[list[PointReading]]:
    """Return the tracks of unlabelled ``readings``, frame by frame; raises `InputError` for too many of either."""
    tracks: list[list[PointReading]] = []
    last_mm = np.empty((MOST_TRACKS, 3))
    by_frame: dict[int, list[PointReading]] = {}
    for reading in readings:
        by_frame.setdefault(reading.frame, []).append(reading)
    for number in sorted(by_frame):
        current = by_frame[number]
        if len(current) > MOST_MARKERS:
            raise InputError(
                f"frame {number} holds {len(current)} stray readings; expected {MOST_MARKERS} at most"
            )
        taken = _assigned(np.array([r.position_mm for r in current]), last_mm[: len(tracks)])
        for i, reading in enumerate(current):
            place = taken.get(i, len(tracks))
            if place == MOST_TRACKS:
                raise InputError(f"stray readings appear at more than {MOST_TRACKS} places; check the recording")
            if place == len(tracks):
                tracks.append([])
            tracks[place].append(reading)
            last_mm[place] = np.median([r.position_mm for r in tracks[place][-RECENT:]], axis=0)
    return tracks


def _assigned(current_mm: FloatArray, last_mm: FloatArray) -> dict[int, int]:
    """Return {reading: track} at the least total distance, within `GATE_MM`."""
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    if not len(last_mm):
        return {}
    distance = cdist(current_mm, last_mm)
    within = np.flatnonzero((distance <= GATE_MM).any(axis=0))
    distance = distance[:, within]
    pairs = zip(*linear_sum_assignment(np.where(distance > GATE_MM, FAR, distance)), strict=True)
    return {int(i): int(within[j]) for i, j in pairs if distance[i, j] <= GATE_MM}


def _agreeing(positions_mm: FloatArray) -> FloatArray:
    """Return those of ``positions_mm`` (N, 3) that are no outliers on any axis; none where each is one on some axis."""
    middle = np.median(positions_mm, axis=0)
    spread = np.maximum(1.4826 * np.median(np.abs(positions_mm - middle), axis=0), SMALLEST_SD_MM)
    return positions_mm[(np.abs(positions_mm - middle) <= OUTLIER_SDS * spread).all(axis=1)]


def _summarize(
    track: list[PointReading], kept: FloatArray, label: str, frames: list[int], sigma_mm: float
) -> Marker:
    stated = [r.sigma_mm for r in track if r.sigma_mm is not None]
    floor = float(np.sqrt(np.mean(np.square(stated)))) if stated else sigma_mm
    covariance = floor**2 * np.eye(3)
    if len(kept) > 1:
        covariance = covariance + np.cov(kept.T) / len(kept)
    flags = _flags(track, kept, frames)
    return Marker(label, kept.mean(axis=0), covariance, len(kept), len(track) - len(kept), flags)


def _flags(track: list[PointReading], kept: FloatArray, frames: list[int]) -> tuple[MarkerFlag, ...]:
    seen = {r.frame for r in track}
    quarter = len(kept) // 4
    moved = False
    if quarter >= 2:
        first, last = kept[:quarter], kept[-quarter:]
        error = np.sqrt((first.var(axis=0, ddof=1).sum() + last.var(axis=0, ddof=1).sum()) / quarter)
        moved = float(np.linalg.norm(last.mean(axis=0) - first.mean(axis=0))) > max(MOVED_MM, 5 * error)
    elif len(kept) > 1:
        moved = float(np.ptp(kept, axis=0).max()) > 2 * GATE_MM
    tail = frames[-max(1, int(LOST_SHARE * len(frames))) :]
    checks = {
        MarkerFlag.MOVED: moved,
        MarkerFlag.LOST: not seen & set(tail),
        MarkerFlag.DROPOUTS: len(seen) < 0.9 * len(frames),
        MarkerFlag.SINGLE_READING: len(track) == 1,
    }
    return tuple(flag for flag, raised in checks.items() if raised)


def _tool_origins(recording: Recording) -> list[PointReading]:
    return [
        PointReading(r.frame, r.matrix[:3, 3], r.tool, r.time_s)
        for r in recording.tools
        if r.usable and r.matrix is not None
    ]


def _reasons(recording: Recording) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in recording.flagged().items()) or "it is empty"
