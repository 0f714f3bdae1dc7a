"""The slices of a scan that were measured, without those that were computed from them.

Workstations resample thick slices to thinner ones, most by straight lines from slice to slice, and headers do not say
so. What is seen of a ball then depends on where between two measured slices a computed one lies, so no slice profile
describes them all. But such slices hold nothing of their own. One that lies between others of its line is, in every
voxel and to rounding, what these say, as none is that has noise of its own; and where the lines of two slices here and
of two slices there meet at one height in every voxel, there was a measured slice, which they tell. With these alone the
scan is again the one that was made.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.bounds import AIR_HU
from ronnaplan.ct.scratch import runs
from ronnaplan.ct.volume import CTVolume, VolumeFlag, Voxels
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.threads import in_parts

ROUNDED_HU = 1.0
"""Whole numbers that lie on one line before they are rounded are off it by no more than this, and so are such whose
fraction is cut off. Toward zero, as ITK cuts it off, it is by no more than twice this where some lie to either side."""

WITHIN_SCALE_HU = (AIR_HU, 3000.0)
"""What a scale's end may have cut off after slices were computed is not asked: air, and metal."""

CHANGE_HU = 10.0
"""Where nothing changes by more, nothing is told."""

NO_CHANGE_HU = 1e-6
"""Lines that close in by no more than this never meet, but for rounding."""

AT_A_SLICE = 0.02
"""Lines that meet closer to a slice than this share of the gap meet in it."""

UNEVEN, AT_AN_END = 0.05, 2
"""Measured slices lie as far apart as is usual, to this share of it. So many at either end may lie closer, which were
computed from slices that are not there. Where others do not, not all were told from computed ones, and the scan is left
as it is: a mixture of both would show markers through different profiles."""


@dataclass(frozen=True)
class _Measured:
    """A measured slice: ``share`` of the way from slice ``below`` to the next one; 0 where it is that slice itself."""

    below: int
    share: float


def measured(volume: CTVolume) -> CTVolume:
    """Return the scan without the slices that were computed from others, flagged so; itself where there are none.

    Raises `InputError` for a single slice, in which nothing is told along its normal.
    """
    count = len(volume.voxels_hu)
    if count < 2:
        raise InputError("the scan has a single slice; markers are found in two at least: give the whole series")
    slices = _slices(volume)
    if len(slices) == count or len(slices) < 4:
        return volume
    places = np.array([one.below + one.share for one in slices])
    heights_mm = np.interp(places, np.arange(count), volume.grid.slice_positions_mm)
    gaps_mm = np.diff(heights_mm)
    usual_mm = float(np.median(gaps_mm))
    alike = np.flatnonzero(np.abs(gaps_mm - usual_mm) <= UNEVEN * usual_mm)
    if len(alike) == 0 or gaps_mm.max() > (1.0 + UNEVEN) * usual_mm:
        return volume
    first, last = int(alike[0]), int(alike[-1])
    if len(alike) < last + 1 - first or max(first, len(gaps_mm) - 1 - last) > AT_AN_END:
        return volume
    kept = slice(first, last + 2)
    voxels_hu: NDArray[Any] = np.stack([_voxels(volume, one) for one in slices[kept]])
    return replace(
        volume.flagged(VolumeFlag.REFORMATTED),
        voxels_hu=voxels_hu,
        grid=volume.grid.at_slices(places[kept]),
    )


def _slices(volume: CTVolume) -> list[_Measured]:
    """Find all slices that were measured, in order."""
    voxels_hu, gaps_mm = volume.voxels_hu, volume.grid.spacings_mm
    count = len(voxels_hu)
    computed, meeting = np.zeros(count, dtype=np.bool_), np.full(count, np.nan)

    def mark(first: int, end: int) -> None:
        for start, stop in runs(voxels_hu, first + 1, end + 1):
            _mark_computed(voxels_hu, gaps_mm, start, stop, computed)

    def meet(first: int, end: int) -> None:
        for start, stop in runs(voxels_hu, first + 1, end + 1):
            _find_meeting(voxels_hu, gaps_mm, start, stop, computed, meeting)

    in_parts(mark, max(count - 2, 0))
    in_parts(meet, max(count - 3, 0))
    slices: list[_Measured] = []
    meeting[np.isnan(meeting)] = 0.0
    for k in np.flatnonzero(~computed).tolist():
        if k > 0 and meeting[k - 1] > 0.0:
            continue  # both sides of the measured slice before
        slices.append(_Measured(k, meeting[k]))
    return slices


@njit(cache=True, nogil=True)
def _ratios(gaps_mm: FloatArray) -> tuple[float, float]:
    """Return the middle one of three gaps as a multiple of the one before and of the one behind."""
    return gaps_mm[1] / gaps_mm[0], gaps_mm[1] / gaps_mm[2]


def _voxels(volume: CTVolume, one: _Measured) -> Voxels:
    """Return the measured slice's voxels (J, I): of both lines that meet in it, the one of the nearer slice more."""
    k, share = one.below, one.share
    here: Voxels = volume.voxels_hu[k]
    if share == 0.0:
        return here
    before, behind = _ratios(volume.grid.spacings_mm[k - 1 : k + 2])
    first, low, high, last = volume.voxels_hu[k - 1 : k + 3].astype(np.float32)
    from_below, from_above = low + share * before * (low - first), high - (1.0 - share) * behind * (last - high)
    told: FloatArray = (1.0 - share) * from_below + share * from_above
    return told.astype(np.float32) if here.dtype == np.float32 else np.round(told).astype(np.int16)


@njit(cache=True, nogil=True)
def _mark_computed(voxels: Voxels, gaps: FloatArray, first: int, end: int, computed: NDArray[np.bool_]) -> None:
    """Mark in ``computed`` (K,) which of the slices ``first`` to ``end`` lie on lines between their neighbours."""
    for k in range(first, end):
        share = gaps[k - 1] / (gaps[k - 1] + gaps[k])
        computed[k] = _is_between(voxels[k - 1], voxels[k], voxels[k + 1], share)


@njit(cache=True, nogil=True)
def _is_between(before: Voxels, here: Voxels, after: Voxels, share: float) -> bool:
    """Whether every voxel is what a straight line gives at this ``share`` of the way; the first ones tell most."""
    rows, columns = here.shape
    changes = False
    for n in range(rows):
        j = (n + rows // 2) % rows  # from the middle on: the corners are often empty
        for i in range(columns):
            low, value, high = float(before[j, i]), float(here[j, i]), float(after[j, i])
            least, most = min(low, value, high), max(low, value, high)
            if least <= WITHIN_SCALE_HU[0] or most >= WITHIN_SCALE_HU[1]:
                continue
            if abs(value - low - share * (high - low)) > _rounded_hu(least, most):
                return False
            changes = changes or abs(high - low) > CHANGE_HU
    return changes


@njit(cache=True, nogil=True)
def _rounded_hu(least_hu: float, most_hu: float) -> float:
    """How far values from ``least_hu`` to ``most_hu`` may be off their line, as whole numbers."""
    return (2.0 if least_hu <= 0.0 <= most_hu else 1.0) * ROUNDED_HU + 1e-6


@njit(cache=True, nogil=True)
def _find_meeting(
    voxels: Voxels, gaps: FloatArray, first: int, end: int, computed: NDArray[np.bool_], meeting: FloatArray
) -> None:
    """Fill ``meeting`` (K,) behind the slices ``first`` to ``end`` with what `_meet` tells, where none was computed."""
    for k in range(first, end):
        if not (computed[k] or computed[k + 1]):
            before, behind = _ratios(gaps[k - 1 : k + 2])
            meeting[k] = _meet(voxels[k - 1 : k + 3], before, behind)


@njit(cache=True, nogil=True)
def _meet(four: Voxels, before: float, behind: float) -> float:
    """Where, as a share of the middle gap, the lines of the first and the last two of ``four`` (4, J, I) slices meet.

    NaN where they do not meet at one height in every voxel. ``before`` and ``behind`` are what `_ratios` gives.
    """
    rows = four.shape[1]
    across = squares = 0.0
    least, most = -math.inf, math.inf
    for n in range(rows):
        for i in range(four.shape[2]):
            apart, closing, rounded_hu = _lines(four[:, (n + rows // 2) % rows, i], before, behind)
            across += apart * closing
            squares += closing * closing
            if abs(closing) > NO_CHANGE_HU:
                middle, wide = -apart / closing, abs(rounded_hu / closing)
                least, most = max(least, middle - wide), min(most, middle + wide)
            elif abs(apart) > rounded_hu:
                return math.nan
            if least > most:
                return math.nan
    share = min(max(-across / max(squares, 1e-9), least), most)
    is_told = squares > CHANGE_HU * CHANGE_HU and AT_A_SLICE < share < 1.0 - AT_A_SLICE
    return share if is_told else math.nan


@njit(cache=True, nogil=True)
def _lines(four: Voxels, before: float, behind: float) -> tuple[float, float, float]:
    """How far the lines of a voxel (4,) are apart at the second slice, and by how much less at the third.

    Beside it by how much that may be off, as the values are whole numbers. Nothing where the scale may have ended.
    """
    first, low, high, last = float(four[0]), float(four[1]), float(four[2]), float(four[3])
    least, most = min(first, low, high, last), max(first, low, high, last)
    if least <= WITHIN_SCALE_HU[0] or most >= WITHIN_SCALE_HU[1]:
        return 0.0, 0.0, 0.0
    rise = behind * (last - high)
    return low - high + rise, before * (low - first) - rise, (1.0 + before + behind) * _rounded_hu(least, most)
