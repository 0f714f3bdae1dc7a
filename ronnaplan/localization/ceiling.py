"""Where a scan's scale ends: brighter things, such as metal, show no more than that."""

from __future__ import annotations

import math

import numpy as np

from ronnaplan.ct.pixels import Voxels
from ronnaplan.ct.scratch import one_by_one
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.parts import in_parts

MIN_CEILING_HU = 2000.0
"""No scanner's scale ends below this."""

CLIP_SHOULDER_HU = 10
"""A scale ends where its largest value is commoner than all the values this far below it taken together."""

RAGGED_HU = 30.0
"""Lossy compression, resampling and denoising leave an end so ragged at most where they follow after it. What is bright
and not cut off scatters farther by its own noise, of 10 HU and more."""

STRAY_SHARE = 0.005
"""Share of the bright voxels that ringing may lift beyond a ragged end."""

LEAST_AT_END, ENDS_MORE = 30, 4.0
"""A ragged end holds so many voxels, and so many times those of the band below it, which is as wide as it."""


def scale_end_hu(voxels_hu: Voxels) -> float:
    """Value at which the scale of ``voxels_hu`` (K, J, I) ends, or infinity where its brightest are not cut off.

    Of a ragged end the lower side is told: what lies above tells no more than that it is bright.
    """
    parts = in_parts(lambda first, end: _bright(voxels_hu[first:end]), len(voxels_hu))
    bright = np.sort(np.concatenate([some for part in parts for some in part]))
    top = float(bright[-1]) if len(bright) else -math.inf
    if top < MIN_CEILING_HU:
        return math.inf
    at_top = len(bright) - int(np.searchsorted(bright, top))
    is_sharp = at_top > 1 and 2 * at_top > len(bright) - int(np.searchsorted(bright, top - CLIP_SHOULDER_HU))
    end = top if is_sharp else max(float(bright[int((1.0 - STRAY_SHARE) * (len(bright) - 1))]), MIN_CEILING_HU)
    below, lower, last, upper = np.searchsorted(
        bright, [end - 3.0 * RAGGED_HU, end - RAGGED_HU, end, end + RAGGED_HU]
    )
    around = int((last if is_sharp else upper) - lower)
    if around >= max(LEAST_AT_END, STRAY_SHARE * len(bright)) and around > ENDS_MORE * (lower - below):
        return end - RAGGED_HU
    return top if is_sharp else math.inf


def _bright(slices_hu: Voxels) -> list[FloatArray]:
    """Return what may lie at a scale's end or just below, of each of the slices that show any."""
    least_hu = MIN_CEILING_HU - 3.0 * RAGGED_HU
    return [one[one >= least_hu].astype(np.float64) for one in one_by_one(slices_hu) if one.max() >= least_hu] or [
        np.empty(0)
    ]
