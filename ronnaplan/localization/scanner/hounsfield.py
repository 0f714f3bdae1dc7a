"""Values in a unit of their own, brought to Hounsfield units: air at -1000, what is scanned in it 1000 above.

Mobile C-arms and exports of pictures give grey values, from 0 to 255, say. A ball of plastic is then fainter than the
faintest that is looked for, and none is found. That a factor is wrong is told where no value can be air's or tissue's
(`ct.scale`), and air and what is scanned in it lie too near together, or too far apart; an offset alone displaces both.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from ronnaplan.ct.scale import doubts_of_scale, seen_values
from ronnaplan.ct.scratch import one_by_one
from ronnaplan.ct.volume import CTVolume, VolumeFlag
from ronnaplan.geometry import FloatArray

WRONG_SCALE: Final = {VolumeFlag.NO_AIR, VolumeFlag.NO_TISSUE}
"""What a wrong factor makes of a scan. What is inverted has no balls brighter than what is around them."""

APART_HU: Final = 1000.0
"""Tissue, or water, is brighter than air by this."""

NEAREST_HU, FARTHEST_HU = 600.0, 1700.0
"""Where they lie no nearer and no farther apart, all is found: cone beams are off by 30 % and are left as they are."""

LEAST_SHARE: Final = 0.01
"""What is scanned in air fills more of a scan than this; metal in tissue, in a crop that shows no air, does not."""

BRIGHTEST: Final = 4.0
"""Bone, and the end of a scale of 12 bits, are brighter than tissue by less than so many times what tissue is brighter
than air. In a crop that shows no air, but bone, fat and brain lie much nearer together than that."""

LEVELS, FEW = 256, 0.005
"""So many levels tell where two kinds of values part, between the ends that this share of the values lies beyond."""


def in_hounsfield(volume: CTVolume) -> CTVolume:
    """Return the scan in Hounsfield units, flagged so; itself where nothing tells that it is not."""
    doubts = set(doubts_of_scale(volume.voxels_hu, volume.padding_hu))
    if not doubts or not doubts <= WRONG_SCALE:
        return volume
    seen = np.sort(seen_values(volume.voxels_hu, volume.padding_hu).astype(np.float64))
    told = _air_and_tissue(seen) if seen.size else None
    if told is None:
        return volume
    air, tissue = told
    factor = APART_HU / (tissue - air)
    ends = np.iinfo(np.int16)
    scaled = np.empty(volume.voxels_hu.shape, np.int16)
    for plane, values in zip(scaled, one_by_one(volume.voxels_hu), strict=True):
        hu = (values.astype(np.float32) - air) * factor - APART_HU
        plane[...] = np.clip(hu, ends.min, ends.max).round()
    padding = volume.padding_hu
    if padding is not None:
        padding = float(np.clip((padding - air) * factor - APART_HU, ends.min, ends.max).round())
    return replace(volume, voxels_hu=scaled, padding_hu=padding, flags=(*volume.flags, VolumeFlag.SCALED))


def _air_and_tissue(values: FloatArray) -> tuple[float, float] | None:
    """Return the levels of air and of what is in it, by sorted ``values`` (N,); None where they may be HU."""
    air, tissue = _two_kinds(values)
    if len(tissue) < LEAST_SHARE * len(values):
        return None
    dark, bright = float(np.median(air)), float(np.median(tissue))
    apart = bright - dark
    if NEAREST_HU <= apart <= FARTHEST_HU or apart <= 0.0:
        return None
    if apart < NEAREST_HU and values[-1] - bright > BRIGHTEST * apart:
        return None
    return dark, bright


def _two_kinds(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Part sorted ``values`` (N,) in two where they differ most from each other (Otsu, IEEE T-SMC 9:62, 1979)."""
    from skimage.filters import threshold_otsu

    lowest, highest = np.quantile(values, [FEW, 1.0 - FEW])
    if lowest == highest:
        return values, values[:0]
    threshold = threshold_otsu(np.clip(values, lowest, highest), nbins=LEVELS)
    dark = np.searchsorted(values, threshold, side="right")
    return values[:dark], values[dark:]
