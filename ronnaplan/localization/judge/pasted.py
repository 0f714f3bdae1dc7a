"""Metal that artifact reduction cut out and put back in: no voxel at its edge is as bright as one half-way should be.

A scanner blurs every edge over more than a voxel, so that all values between a ball's level and its surroundings' stand
about it. Metal artifact reduction keeps what is brighter than its threshold, and computes the rest anew without the
metal: what is a little fainter than the threshold is gone, and with it where the metal ended.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import quantile
from ronnaplan.localization.fit.neighbourhood import gather

BESIDE_MM = 1.0
"""What lies so far beyond a ball's surface is looked at with it."""

LEAST_METAL_HU = 1500.0
"""Artifact reduction takes what is brighter than 2,000 to 3,000 HU for metal, less where it is careful."""

LEVELS, GAP_SHARE = (0.1, 0.9), 0.1
"""The ball and its surroundings, what these shares of the voxels do not exceed, and how much of what lies between them
is gone at least: 0.13 to 0.8 about balls of steel and alumina that were put back, 0.07 at most elsewhere."""

LEAST_ROUND = 0.3
"""Flat sides along the voxels show no values between, either; of what is looked at there less is a sphere's."""

PUT_BACK = "as what artifact reduction puts back in; localize in the images without it"

LEAST_VOXELS = 1000
"""Fewer voxels may leave out as much by chance, as those of a screw in coarse slices."""


def left_out_hu(
    volume: CTVolume, center_mm: FloatArray, diameter_mm: float, axes: FloatArray
) -> tuple[float, float] | None:
    """Return between which values no voxel about a place (3,) is, if what ends there was put back in; else None."""
    around_hu = gather(volume, center_mm, diameter_mm / 2.0 + BESIDE_MM, axes).values_hu
    if len(around_hu) < LEAST_VOXELS or around_hu.max() < LEAST_METAL_HU:
        return None
    low_hu, high_hu = (quantile(around_hu, share) for share in LEVELS)
    between_hu = np.sort(around_hu[(around_hu >= low_hu) & (around_hu <= high_hu)])
    widest = int(np.argmax(np.diff(between_hu)))
    below_hu, above_hu = float(between_hu[widest]), float(between_hu[widest + 1])
    is_gone = above_hu >= LEAST_METAL_HU and above_hu - below_hu > GAP_SHARE * (high_hu - low_hu)
    return (below_hu, above_hu) if is_gone else None
