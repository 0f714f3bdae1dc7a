"""From stray readings over many frames to markers, each with a mean and a covariance.

Trackers list stray markers in any order, drop some, and add reflections. Readings are followed from frame to
frame: each frame's readings are assigned to the tracks known so far at the least total distance, within a
gate; what fits none begins a track. Tracks seen in too few frames are rejected, with that reason.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import SD_PER_DEVIATION, FloatArray, require_sigma
from ronnaplan.sigmas import SIGMA_OTS_MM
from ronnaplan.tracking.markers import MarkerFlag, MarkerReadings, RejectedTrack, TrackedMarker
from ronnaplan.tracking.recording import PointReading, Recording, require_one_system

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
"""A marker unseen in this last share of the frames is lost; elsewhere in it, it has moved."""
FEWEST_LAST = 2
"""One reading alone may be an outlier."""
MOST_MARKERS = 1000
"""No tracker sees more at once: a recording that names more does not name markers."""
MOST_STRAYS = 200
"""No tracker lists more unnamed readings in one frame; the time to follow them grows with their cube."""
MOST_TRACKS = 20_000
"""An hour of frames, each with a reflection elsewhere, has fewer."""
MOST_REASONS = 5
"""Kinds of flagged readings that are told one by one; more are summed up."""
FAR = 1e6
"""Cost of a pair beyond the gate: more than any sum of distances within it."""


def find_markers(recording: Recording, *, sigma_mm: float = SIGMA_OTS_MM) -> MarkerReadings:
    """Return the markers that ``recording`` saw, labelled as the source does or 1, 2, ... in order of appearance.

    ``sigma_mm`` is the tracker's error per axis that averaging does not remove. Readings that share a label
    are one marker; a recording of tool poses alone gives each tool's origin. Raises `InputError` if nothing
    usable was read.
    """
    check_type(recording, Recording, "the recording", "read_recording returns one")
    require_sigma(sigma_mm, "the tracker error")
    readings = [r for r in recording.points if r.usable] or _tool_origins(recording)
    readings.sort(key=lambda reading: reading.frame)  # some programs list the newest first
    if not readings:
        raise InputError(
            f"{recording.source} holds no usable reading ({_reasons(recording)}); record it again, or correct it"
        )
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
    markers: list[TrackedMarker] = []
    rejected: list[RejectedTrack] = []
    for track in [*named.values(), *_follow(strays)]:
        if not track[0].label and len({r.frame for r in track}) < SEEN_SHARE * len(frames):
            middle = np.median([r.position_mm for r in track], axis=0)
            seen = f"seen in {len({r.frame for r in track})} of {len(frames)} frames"
            rejected.append(RejectedTrack(middle, len(track), seen))
            continue
        agreeing = _agreeing(np.array([r.position_mm for r in track]))
        agree = [reading for reading, kept in zip(track, agreeing, strict=True) if kept]
        reason = "no two of its coordinates agree" if not agree else _contradiction(agree)
        if reason:
            middle = np.median([r.position_mm for r in track], axis=0)
            rejected.append(RejectedTrack(middle, len(track), reason))
            continue
        markers.append(_summarize(track, agreeing, track[0].label or _unused_number(markers), frames, sigma_mm))
    return MarkerReadings(tuple(markers), tuple(rejected), len(frames), recording.frame)


def _unused_number(markers: list[TrackedMarker]) -> str:
    used = {marker.label for marker in markers}
    return next(str(n) for n in range(1, len(markers) + 2) if str(n) not in used)


def _follow(readings: Sequence[PointReading]) -> list[list[PointReading]]:
    """Return the tracks of unlabelled ``readings``, frame by frame; raises `InputError` for too many of either."""
    tracks: list[list[PointReading]] = []
    recent_mm = np.full((MOST_TRACKS, RECENT, 3), np.nan)
    last_mm = np.empty((MOST_TRACKS, 3))
    by_frame: dict[int, list[PointReading]] = {}
    for reading in readings:
        by_frame.setdefault(reading.frame, []).append(reading)
    for number in sorted(by_frame):
        current = by_frame[number]
        if len(current) > MOST_STRAYS:
            raise InputError(f"frame {number} holds {len(current)} stray readings; expected {MOST_STRAYS} at most")
        taken = assigned(np.array([r.position_mm for r in current]), last_mm[: len(tracks)], GATE_MM)
        places = [taken.get(i, -1) for i in range(len(current))]
        for i, reading in enumerate(current):
            if places[i] < 0:
                if len(tracks) == MOST_TRACKS:
                    raise InputError(
                        f"stray readings appear at more than {MOST_TRACKS} places; check the recording"
                    )
                places[i] = len(tracks)
                tracks.append([])
            recent_mm[places[i], len(tracks[places[i]]) % RECENT] = reading.position_mm
            tracks[places[i]].append(reading)
        last_mm[places] = _medians(recent_mm[places])
    return tracks


def _medians(recent_mm: FloatArray) -> FloatArray:
    """Return the medians (N, 3) of ``recent_mm`` (N, `RECENT`, 3), NaN where there were fewer readings."""
    ordered = np.sort(recent_mm, axis=1)  # NaN comes last
    counts = np.isfinite(recent_mm[:, :, 0]).sum(axis=1)
    rows = np.arange(len(ordered))
    medians: FloatArray = 0.5 * (ordered[rows, (counts - 1) // 2] + ordered[rows, counts // 2])
    return medians


def assigned(current_mm: FloatArray, last_mm: FloatArray, gate_mm: float) -> dict[int, int]:
    """Return {reading: track} of readings (N, 3) and tracks (M, 3) at the least total distance, within ``gate_mm``."""
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    if not (len(current_mm) and len(last_mm)):
        return {}
    apart_mm = cdist(current_mm, last_mm)
    near = apart_mm <= gate_mm
    # most readings have one track within the gate, which has no other: no least sum is to be found for them
    i, j = np.nonzero(near & (near.sum(axis=1, keepdims=True) == 1) & (near.sum(axis=0) == 1))
    found = dict(zip(i.tolist(), j.tolist(), strict=True))
    near[i, j] = False
    rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
    of_rest = np.ix_(rows, columns)
    pairs = zip(*linear_sum_assignment(np.where(near[of_rest], apart_mm[of_rest], FAR)), strict=True)
    return found | {int(rows[i]): int(columns[j]) for i, j in pairs if near[rows[i], columns[j]]}


def _agreeing(positions_mm: FloatArray) -> NDArray[np.bool_]:
    """Return which of ``positions_mm`` (N, 3) are no outliers on any axis; none where each is one on some axis."""
    middle = np.median(positions_mm, axis=0)
    spread = np.maximum(SD_PER_DEVIATION * np.median(np.abs(positions_mm - middle), axis=0), SMALLEST_SD_MM)
    return np.asarray((np.abs(positions_mm - middle) <= OUTLIER_SDS * spread).all(axis=1))


def _contradiction(track: Sequence[PointReading]) -> str | None:
    """Return in words that ``track`` is at several places in one frame, None where it is not."""
    by_frame: dict[int, list[FloatArray]] = {}
    for reading in track:
        by_frame.setdefault(reading.frame, []).append(reading.position_mm)
    spread = max((float(np.ptp(each, axis=0).max()) for each in by_frame.values() if len(each) > 1), default=0.0)
    return f"its name stands at places {spread:.1f} mm apart in one frame" if spread > 2 * GATE_MM else None


def _summarize(
    track: list[PointReading], agreeing: NDArray[np.bool_], label: str, frames: list[int], sigma_mm: float
) -> TrackedMarker:
    positions = np.array([r.position_mm for r in track])
    kept = positions[agreeing]
    sigmas = np.array([sigma_mm if r.sigma_mm is None else r.sigma_mm for r in track])[agreeing]
    covariance = float(np.mean(np.square(sigmas))) * np.eye(3)
    if len(kept) > 1:
        covariance = covariance + np.cov(kept.T) / len(kept)
    moved_mm = max(_moved_mm(kept), _left_mm(positions, agreeing))
    flags = _flags(track, moved_mm > 0, frames)
    return TrackedMarker(label, kept.mean(axis=0), covariance, len(kept), len(track) - len(kept), flags, moved_mm)


def _moved_mm(kept: FloatArray) -> float:
    """Return how far the readings that count (n, 3), in order, end from where they began, or lie apart; 0 if unsure."""
    apart = float(np.ptp(kept, axis=0).max())
    moved = apart if apart > 2 * GATE_MM else 0.0
    quarter = len(kept) // 4
    if quarter < 2:
        return moved
    first, last = kept[:quarter], kept[-quarter:]
    error = float(np.sqrt((first.var(axis=0, ddof=1).sum() + last.var(axis=0, ddof=1).sum()) / quarter))
    way = float(np.linalg.norm(last.mean(axis=0) - first.mean(axis=0)))
    return max(moved, way) if way > max(MOVED_MM, 5 * error) else moved


def _left_mm(positions: FloatArray, agreeing: NDArray[np.bool_]) -> float:
    """Return how far the last of all readings (n, 3) lie from those that count, if none is there: it was before."""
    last = max(FEWEST_LAST, int(LOST_SHARE * len(positions)))
    away = float(np.linalg.norm(np.median(positions[-last:], axis=0) - positions[agreeing].mean(axis=0)))
    return 0.0 if agreeing[-last:].any() or away <= MOVED_MM else away


def _flags(track: list[PointReading], moved: bool, frames: list[int]) -> tuple[MarkerFlag, ...]:
    seen = {r.frame for r in track}
    tail = frames[-max(1, int(LOST_SHARE * len(frames))) :]
    checks = {
        MarkerFlag.MOVED: moved,
        MarkerFlag.LOST: not seen & set(tail),
        MarkerFlag.DROPOUTS: len(seen) < 0.9 * len(frames),
        MarkerFlag.SINGLE_READING: len(track) == 1,
    }
    return tuple(flag for flag, raised in checks.items() if raised)


def _tool_origins(recording: Recording) -> list[PointReading]:
    require_one_system((r.tool for r in recording.tools if r.usable), recording.source)
    return [
        PointReading(r.frame, r.matrix[:3, 3], r.tool, r.time_s)
        for r in recording.tools
        if r.usable and r.matrix is not None
    ]


def _reasons(recording: Recording) -> str:
    told = [f"{count} {reason}" for reason, count in recording.flagged().items()]
    if len(told) > MOST_REASONS:
        told = [*told[:MOST_REASONS], f"and {len(told) - MOST_REASONS} more reasons"]
    return ", ".join(told) or "it is empty"
