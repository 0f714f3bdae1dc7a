"""Where a scan's scale ends: brighter things, such as metal, show no more than that."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.scratch import one_by_one, runs
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.threads import in_parts

MIN_CEILING_HU, SCANNERS_CEILING_HU = 300.0, 2000.0
"""Nobody cuts a scale off below the first, and no scanner below the second; exports for soft tissue or bone may do."""

CLIP_SHOULDER_HU = 10.0
"""A scale ends where its largest value is commoner than all the values this far below it taken together."""

RAGGED_HU = 30.0
"""Lossy compression, resampling and denoising leave an end so ragged at most where they follow after it. What is bright
and not cut off scatters farther by its own noise, of 10 HU and more."""

NEAR_HU = 5.0 * RAGGED_HU
"""So far below the largest value what is there tells whether and how the scale ends."""

STRAY_SHARE = 0.005
"""Share of these voxels that ringing may lift beyond a ragged end."""

LEAST_AT_END, ENDS_MORE = 30, 4.0
"""A ragged end holds so many voxels, and so many times those of the band below it, which is as wide as it."""


def scale_end_hu(voxels_hu: NDArray[Any]) -> float:
    """Value at which the scale of ``voxels_hu`` (K, J, I) ends, or infinity where its brightest are not cut off.

    Of a ragged end the lower side is told: what lies above tells no more than that it is bright. Raises `InputError`
    where a voxel is no number.
    """

    def highest(first: int, end: int) -> list[NDArray[Any]]:
        return [voxels_hu[start:stop].max(axis=(1, 2)) for start, stop in runs(voxels_hu, first, end)]

    tops = np.concatenate([top for part in in_parts(highest, len(voxels_hu)) for top in part]).astype(np.float64)
    top = float(tops.max())
    if math.isnan(top):
        raise InputError(
            "voxels hold values that are no numbers; expected HU, and air's where nothing was measured"
        )
    if top < MIN_CEILING_HU:
        return math.inf
    least = voxels_hu.dtype.type(top - NEAR_HU)  # as voxels are, which are compared a third faster then

    def bright(first: int, end: int) -> list[NDArray[Any]]:
        each = zip(one_by_one(voxels_hu[first:end]), tops[first:end], strict=True)
        return [one[one >= least] for one, its_top in each if its_top >= least]

    parts = in_parts(bright, len(voxels_hu))
    near = np.sort(np.concatenate([one for part in parts for one in part])).astype(np.float64)
    at_top, beside = (len(near) - int(np.searchsorted(near, least)) for least in (top, top - CLIP_SHOULDER_HU))
    is_scanners = top >= SCANNERS_CEILING_HU
    is_sharp = at_top >= (2 if is_scanners else LEAST_AT_END) and 2 * at_top > beside
    end = top if is_sharp else float(near[int((1.0 - STRAY_SHARE) * (len(near) - 1))])
    if is_scanners and _is_ragged(near, end, is_sharp):
        return end - RAGGED_HU
    return top if is_sharp else math.inf


def _is_ragged(near: FloatArray, end_hu: float, is_sharp: bool) -> bool:
    """Whether the sorted values ``near`` the largest gather about an end, or below it where it is sharp."""
    reach = (end_hu - 3.0 * RAGGED_HU, end_hu - RAGGED_HU, end_hu if is_sharp else end_hu + RAGGED_HU)
    below, lower, upper = np.searchsorted(near, reach).tolist()
    gathered = upper - lower
    return bool(gathered >= max(LEAST_AT_END, STRAY_SHARE * len(near)) and gathered > ENDS_MORE * (lower - below))
