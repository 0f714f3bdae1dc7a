"""Which slices of a scan were measured, and which were computed between others.

Workstations resample thick slices to thinner ones, most by straight lines from slice to slice, and headers do not say
so. What is seen of a ball then depends on where between two measured slices a computed one lies, so no slice profile
describes them all. But such slices hold nothing of their own: each is the mean of its neighbours, to rounding, in every
voxel, which a measured one, with its own noise, never is. Without them the scan is again the one that was made.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.ct.volume import CTVolume, VolumeFlag
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.parts import in_parts

ROUNDED_HU = 1.0
"""Whole numbers that were computed from whole numbers are off by no more than this."""

WITHIN_SCALE_HU = (-1000.0, 3000.0)
"""What a scale's end may have cut off after slices were computed is not asked: air, and metal."""

CHANGE_HU = 10.0
"""Neighbours that nowhere differ by more say nothing of what lies between them."""

LEAST_GAP_SHARE = 0.75
"""Slices that were measured lie no closer to each other than this share of their usual distance; where they seem to,
what was computed does not hold what was measured, but mixtures."""


def measured(volume: CTVolume) -> CTVolume:
    """Return the scan without the slices that were computed from others, flagged so; itself where there are none."""
    if len(volume.voxels_hu) < 3:
        return volume
    kept = _without_ends(~computed_slices(volume), volume.grid.slice_positions_mm)
    if kept.all():
        return volume
    gaps_mm = np.diff(volume.grid.slice_positions_mm[kept])
    if gaps_mm.min(initial=np.inf) < LEAST_GAP_SHARE * np.median(gaps_mm):
        return volume
    flags = dict.fromkeys([*volume.flags, VolumeFlag.REFORMATTED])
    grid = replace(volume.grid, origins_mm=volume.grid.origins_mm[kept])
    return replace(volume, voxels_hu=volume.voxels_hu[kept], grid=grid, flags=tuple(flags))


def computed_slices(volume: CTVolume) -> NDArray[np.bool_]:
    """Mark the slices (K,) that lie on straight lines between their neighbours in every voxel."""
    voxels_hu, places_mm = volume.voxels_hu, volume.grid.slice_positions_mm
    shares = np.zeros(len(places_mm))
    shares[1:-1] = (places_mm[1:-1] - places_mm[:-2]) / (places_mm[2:] - places_mm[:-2])
    computed = np.zeros(len(places_mm), dtype=np.bool_)

    def mark(first: int, end: int) -> None:
        for k in range(first + 1, end + 1):
            computed[k] = _is_between(voxels_hu[k - 1], voxels_hu[k], voxels_hu[k + 1], shares[k])

    in_parts(mark, len(places_mm) - 2)
    return computed


def _without_ends(kept: NDArray[np.bool_], places_mm: FloatArray) -> NDArray[np.bool_]:
    """Leave out a first or last slice, too, that lies closer to a measured one than these do: it was computed."""
    chosen = np.flatnonzero(kept)
    if kept.all() or len(chosen) < 4:
        return kept
    gaps_mm = np.diff(places_mm[chosen])
    close_mm = LEAST_GAP_SHARE * np.median(gaps_mm)
    trimmed = kept.copy()
    trimmed[chosen[0]] = gaps_mm[0] >= close_mm
    trimmed[chosen[-1]] = gaps_mm[-1] >= close_mm
    return trimmed


@njit(cache=True, nogil=True)
def _is_between(
    before: NDArray[np.int16] | NDArray[np.float32],
    here: NDArray[np.int16] | NDArray[np.float32],
    after: NDArray[np.int16] | NDArray[np.float32],
    share: float,
) -> bool:
    """Whether every voxel is what a straight line gives at this ``share`` of the way; the first ones tell most."""
    rows, columns = here.shape
    changes = False
    for n in range(rows):
        j = (n + rows // 2) % rows  # from the middle on: the corners are often empty
        for i in range(columns):
            low, value, high = float(before[j, i]), float(here[j, i]), float(after[j, i])
            if min(low, value, high) <= WITHIN_SCALE_HU[0] or max(low, value, high) >= WITHIN_SCALE_HU[1]:
                continue
            if abs(value - low - share * (high - low)) > ROUNDED_HU + 1e-6:
                return False
            changes = changes or abs(high - low) > CHANGE_HU
    return changes
