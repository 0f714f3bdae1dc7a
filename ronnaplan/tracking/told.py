"""What a person should know of readings that were taken: which were left out, and which markers are doubtful."""

from __future__ import annotations

import numpy as np

from ronnaplan.text import counted
from ronnaplan.tracking.markers import MarkerFlag, MarkerReadings
from ronnaplan.tracking.recording import Recording
from ronnaplan.tracking.stray import GATE_MM, MOST_REASONS


def readings_told(recording: Recording, found: MarkerReadings) -> tuple[str, ...]:
    """Return, a sentence each, what the reader met, what was left out, and what is doubtful about the markers."""
    return (
        *recording.notes,
        *_left_out(recording),
        *_doubts(found),
        *(_touches(recording, found) or _moved(found)),
        *_twice(found),
        *_no_markers(found),
    )


def _left_out(recording: Recording) -> list[str]:
    flagged = recording.flagged()
    if len(flagged) > MOST_REASONS:
        return [f"{sum(flagged.values())} readings left out for {len(flagged)} reasons; see their status"]
    return [f"{counted(count, 'reading')} left out: {reason}" for reason, count in sorted(flagged.items())]


def _doubts(found: MarkerReadings) -> list[str]:
    once = MarkerFlag.SINGLE_READING
    all_once = len(found.markers) > 1 and all(once in marker.flags for marker in found.markers)
    told = [f"all {len(found.markers)} markers were {once}"] if all_once else []
    return told + [
        f"reading {marker.label}: {flag}"
        for marker in found.markers
        for flag in marker.flags
        if not (all_once and flag is once)
    ]


def _moved(found: MarkerReadings) -> list[str]:
    """Say how far markers moved, which no covariance of theirs holds: they move together, and the head with them."""
    moved_mm = [marker.moved_mm for marker in found.markers if MarkerFlag.MOVED in marker.flags]
    if not moved_mm:
        return []
    return [
        f"{len(moved_mm)} of {len(found.markers)} readings moved while they were recorded, the farthest by at least "
        f"{max(moved_mm):.1f} mm: the expected error does not count that; have them rest, and record them again"
    ]


def _touches(recording: Recording, found: MarkerReadings) -> list[str]:
    """Say of one tool that went about, and nothing else, how a pointer's touches are told."""
    rested = [marker for marker in found.markers if MarkerFlag.MOVED not in marker.flags]
    if recording.points or rested or len(found.markers) + len(found.rejected) != 1:
        return []
    return [
        "the poses of one tool are one marker, at its origin; of a pointer that touched several markers write each "
        "touch in a row of its own, as label, x, y, z of its tip"
    ]


def _twice(found: MarkerReadings) -> list[str]:
    """Say how many markers stand nearer to another than a marker may be from itself."""
    from scipy.spatial import KDTree

    pairs = KDTree(found.points.positions_mm).query_pairs(GATE_MM, output_type="ndarray")
    twice = len(np.unique(pairs))
    if not twice:
        return []
    return [
        f"{twice} of {len(found.markers)} readings stand within {GATE_MM:g} mm of another, as of a marker that was "
        "read more than once, or of coordinates that are not in mm: number the frames (a column frame), and give one "
        "recording, not several in one file"
    ]


def _no_markers(found: MarkerReadings) -> list[str]:
    return [
        f"{track.readings} readings near {', '.join(f'{value:.1f}' for value in track.position_mm)} left out: "
        f"{track.reason}"
        for track in found.rejected
    ]
