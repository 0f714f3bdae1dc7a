"""Did the head move while it was scanned? What its markers show by themselves, all of them alike, or a few."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.judge.motion import (
    LEAST_TOGETHER,
    OF_SLICES,
    PATTERN_ERRORS_MM,
    PATTERNS,
    Movement,
    largest,
)

LIMIT = 4.0
"""A marker is suspected when a pattern is so many standard errors large. Of the still markers of `docs/localization.md`
fewer than one in two hundred are."""

SIDEWAYS = [n for n, name in enumerate(PATTERNS[:OF_SLICES]) if " w " not in name]
"""What differs from slice to slice within them; along w cone beams show as much where nothing moves."""

SHARED = 1.5
"""What is alike in all markers of a scan is less by this factor than what differs between them, in still scans."""

STEADY_ERRORS_MM = PATTERN_ERRORS_MM / [1.0 if " w " in name else 2.0 for name in PATTERNS]
"""What markers have in common where voxels are no cubes, as cone beams have them, is told by less: the medians of 31
still scans of twenty were within 1 um for harmonics and 3 um (10 in oblique slices) for what differs by slice. Jumps
along w are what slices with a lopsided profile show, too."""

OF_SLICES_ALIKE, OF_TURNS_ALIKE = 2, 3
"""So many markers tell of all by what they show alike from slice to slice, and by harmonics: of these two may show the
same beside the edge of the field of view."""

LEAST_USUAL = 0.5
"""What a scan's markers usually show is their median, but no less than so many standard errors. Two show one of
`SIDEWAYS` to the same side by 2.6 times that at most in 38 still scans, and by 5.1 to 12 times in five where the head
jumped while a helix or slices passed it; three a harmonic by 2.6 times in 85 and by 6.7 where it jumped in a turn."""

MOST_EXCUSED = 2.0
"""Cone beams show differences between slices where nothing moves, for their rays slant: 1.2 to 2.6 standard errors
beside what all markers have in common (other scans 0.9 at most). There a pattern has to be as much larger, up to so
many times."""

MEDIAN_SPREAD = 1.25
"""Standard error of a median over that of a mean. One marker that met a jump does not speak for the others."""

AS_LONG = 0.8
"""Six harmonics together are by chance 5 standard errors long as seldom as one of them is 4. Of 24 still scans by a
simulator made apart they are 2.5 long at most in all but one, which has 4.4."""


def suspected(movements: Sequence[Movement], *, in_cubes: bool = False) -> list[bool]:
    """Whether each marker of a scan shows motion by itself, all of them do together, or a few tell of all.

    What two show alike from slice to slice, or three within one turn, and the others do not, is the head's: those above
    and below them were not scanned in one place. Voxels that are cubes (``in_cubes``) are cone beams', of which less is
    believed: all is made in one turn there.
    """
    if len(movements) < LEAST_TOGETHER:
        return [one.statistic > LIMIT for one in movements]
    amplitudes = np.array([one.amplitudes_mm for one in movements])
    noise = np.array([one.errors_mm for one in movements])
    errors = np.hypot(noise, PATTERN_ERRORS_MM)
    ratios = np.nan_to_num(amplitudes / errors)
    of_few = _alike(ratios[:, SIDEWAYS], OF_SLICES_ALIKE)
    if in_cubes:
        beside = np.nan_to_num((amplitudes - _middle(amplitudes)) / errors)[:, SIDEWAYS]
        errors[:, :OF_SLICES] *= min(max(_usual(beside), 1.0), MOST_EXCUSED)
        of_all = _in_common(amplitudes, errors, PATTERN_ERRORS_MM)
    else:
        of_few = max(of_few, _alike(ratios[:, OF_SLICES:], OF_TURNS_ALIKE))
        of_all = _in_common(amplitudes, np.hypot(noise, STEADY_ERRORS_MM), STEADY_ERRORS_MM)
    return [max(of_all, of_few) > LIMIT or largest(own) > LIMIT for own in amplitudes / errors]


def _alike(ratios: FloatArray, count: int) -> float:
    """Return how many times as large as usual a pattern (N, P) is that ``count`` markers show to the same side."""
    ordered = np.sort(ratios, axis=0)
    return float(max(ordered[-count].max(), -ordered[count - 1].min())) / max(_usual(ratios), LEAST_USUAL)


def _in_common(amplitudes: FloatArray, errors: FloatArray, still_mm: FloatArray) -> float:
    """Return the largest median of patterns (N, P) in standard errors, beside what still scans show (P,).

    A head that moves in a turn shows in several harmonics, whose medians count together.
    """
    spread = MEDIAN_SPREAD * np.sqrt(np.median(np.nan_to_num(errors**2), axis=0) / len(amplitudes))
    shown = _middle(amplitudes) / np.hypot(spread, still_mm / SHARED)
    return max(largest(shown), AS_LONG * float(np.linalg.norm(np.nan_to_num(shown[OF_SLICES:]))))


def _middle(amplitudes: FloatArray) -> FloatArray:
    """Return the median of each pattern (N, P); NaN for those that not all voxels tell."""
    told = np.isfinite(amplitudes).all(axis=0)
    return np.where(told, np.median(np.nan_to_num(amplitudes), axis=0), np.nan)


def _usual(ratios: FloatArray) -> float:
    """Return what the middle one of N markers shows of any pattern (N, P)."""
    return float(np.median(np.abs(ratios).max(axis=1)))
