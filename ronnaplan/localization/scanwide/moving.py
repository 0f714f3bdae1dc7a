"""Did the head move while it was scanned? What its markers show by themselves, all of them alike, or a few.

Where slices are made of one whole turn, each edge is seen twice, from either side. Of a head that jumped meanwhile most
edges are seen in both places, so that their middle is where it should be, and nothing is bent (`judge.motion`). But all
markers are blurred along the jump, by p (1 - p) d^2 where it went by d after a share p of the turn: they are smeared. A
gantry that turns while it looks blurs, too, but across the line to its axis, and by the square of the distance from
there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from ronnaplan.geometry import SD_PER_DEVIATION, FloatArray
from ronnaplan.localization.examine import LEAST_TOGETHER, Examined
from ronnaplan.localization.judge.motion import (
    OF_SLICES,
    PATTERN_ERRORS_MM,
    PATTERNS,
    Movement,
    largest,
)
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.jump import jump_at_one_height

LIMIT = 4.0
"""A marker is suspected when a pattern is so many standard errors large, and all are when their smear is. Of the still
markers of `docs/localization.md` fewer than one in two hundred are. Of 48 still scans none is smeared by more than
2.7."""

SIDEWAYS = [n for n, name in enumerate(PATTERNS[:OF_SLICES]) if " w " not in name]
"""What differs from slice to slice within them; along w cone beams show as much where nothing moves."""

SHARED = 1.5
"""What is alike in all markers of a scan is less by this factor than what differs between them, in still scans."""

STEADY_ERRORS_MM = PATTERN_ERRORS_MM / [1.0 if " w " in name else 2.0 for name in PATTERNS]
"""What markers have in common where voxels are no cubes, as cone beams have them, is told by less: the medians of 31
still scans of twenty were within 1 um for harmonics and 3 um (10 in oblique slices) for what differs by slice. Jumps
along w are what slices with a lopsided profile show, too."""

OF_SLICES_ALIKE, OF_TURNS_ALIKE, ALIKE_AMONG = 2, 3, 20
"""So many markers tell of all by what they show alike from slice to slice, and by harmonics: of these two may show the
same beside the edge of the field of view. Among more than 20 it takes as large a share of them, for a jump is met by a
share, and by chance the more show the same."""

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

LEAST_SMEARED = 6
"""So many markers tell a smear: the five numbers that are fitted would suit fewer by chance."""

USUAL_MM2, TURN_SHARE = 0.002, 0.3
"""Standard deviations of the blur that still scans show beside noise: kernels are no circles; and what the turn blurs
is told to first order only, and grows as the square of the distance from the axis but for this share of itself."""

STEEPEST = 1.5
"""A blur that leads out of the slices more steeply than this is not the head's but of thicker slices, from which these
were computed obliquely."""

RIM_MM = 100.0
"""The rim of a head from its middle."""

LARGEST_OFFSET = 1.5
"""The axis of a gantry is no farther from the markers' middle, in rims of a head."""

DOUBTED, ROUNDS = 2.5, 20
"""A marker that is so many standard deviations unlike the others counts half; so often are all weighed anew."""

FITTED: Final = 5
"""Unknowns of the fit of blurs: what stretches all alike (2), the turn, and its products with the axis' place (2)."""
LEAST_SCATTER_MM2: Final = 1e-4
"""Blurs scatter about that fit by no less."""


def moved(scan: Scan, markers: Sequence[Examined]) -> list[bool]:
    """Whether each marker of a scan is suspected to have moved while it was made."""
    in_cubes = scan.volume.grid.is_in_cubes
    movements = [one.movement for one in markers if one.movement is not None]
    places_mm = np.array([scan.axes @ one.center_mm for one in markers]).reshape(-1, 3)
    if in_cubes:
        blurs_mm2 = np.array([scan.axes @ one.blur_mm2 @ scan.axes.T for one in markers]).reshape(-1, 3, 3)
        of_all = are_smeared(places_mm, blurs_mm2)
    else:
        radii_mm = np.array([one.diameter_mm / 2.0 for one in markers])
        of_all = jump_at_one_height(places_mm[:, 2], radii_mm, movements) > LIMIT
    return [of_all or one for one in suspected(movements, in_cubes=in_cubes)]


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
    """Return how many times as large as usual a pattern (N, P) is that ``count`` of up to 20 show to the same side."""
    ordered, count = np.sort(ratios, axis=0), max(count, math.ceil(count * len(ratios) / ALIKE_AMONG))
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


def are_smeared(places_mm: FloatArray, blurs_mm2: FloatArray) -> bool:
    """Tell whether markers at ``places_mm`` (N, 3) along u, v, w are blurred (N, 3, 3) alike, within the slices.

    Markers whose blur is not known (NaN) do not count.
    """
    known = np.isfinite(blurs_mm2).all(axis=(1, 2))
    blurs_mm2 = blurs_mm2[known]
    if len(blurs_mm2) < LEAST_SMEARED:
        return False
    alike_mm2, error_mm2 = _smeared_mm2(places_mm[known, :2] / RIM_MM, blurs_mm2)
    within_mm2 = 2.0 * math.hypot(*alike_mm2)
    across_mm2 = math.hypot(*np.median(blurs_mm2[:, 2, :2], axis=0))
    return within_mm2 > 2.0 * LIMIT * error_mm2 and across_mm2 < STEEPEST * within_mm2


def _smeared_mm2(places: FloatArray, blurs_mm2: FloatArray) -> tuple[FloatArray, float]:
    """Return what stretches the blurs along u and along u = v (2,) in all ``places`` (N, 2) alike, and its error, mm^2.

    Fitted beside blur across the line to an axis: ``turn`` times the square of the distance from it, and by its
    products with the axis' place, so that all is linear; robustly, for what touches a marker may disturb its blur.
    """
    x, y = (places - places.mean(axis=0)).T
    none, one = np.zeros_like(x), np.ones_like(x)
    stretch, shear = [one, none, (y * y - x * x) / 2.0, x, -y], [none, one, -x * y, y, x]
    design = np.hstack([stretch, shear]).T
    told = np.concatenate([(blurs_mm2[:, 0, 0] - blurs_mm2[:, 1, 1]) / 2.0, blurs_mm2[:, 0, 1]])
    errors, weights, freedom = one, np.ones(len(told)), len(told) - FITTED
    for _ in range(ROUNDS):
        weighed = design * weights[:, np.newaxis]
        fitted = np.linalg.lstsq(weighed, told * weights)[0]
        left = np.abs(told - design @ fitted)
        turn = max(float(fitted[2]), 0.0)
        u, v = np.clip(fitted[3:] / turn, -LARGEST_OFFSET, LARGEST_OFFSET) if turn > 0.0 else np.zeros(2)
        scatter = SD_PER_DEVIATION * float(np.median(left / np.tile(errors, 2))) * math.sqrt(len(told) / freedom)
        scatter = max(scatter, LEAST_SCATTER_MM2)
        errors = np.hypot(1.0, TURN_SHARE * turn / 2.0 * ((x - u) ** 2 + (y - v) ** 2) / scatter)
        unlike = np.hypot(*left.reshape(2, -1)) / (DOUBTED * scatter * errors)
        weights = np.tile(1.0 / (errors * np.sqrt(1.0 + unlike**2)), 2)
    alike = fitted[:2] - turn * np.array([(v * v - u * u) / 2.0, -u * v])
    student = freedom / (freedom - 2.0)  # few markers tell their scatter badly
    covariance = np.linalg.pinv(weighed.T @ weighed, hermitian=True) * scatter**2 * student
    return alike, math.hypot(math.sqrt((covariance[0, 0] + covariance[1, 1]) / 2.0), USUAL_MM2)
