"""Balls that are embedded in a plate, a block or a splint, whose faces are near: air beyond these is not their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ronnaplan.localization.fit.algebra import quantile
from ronnaplan.localization.fit.cells import CELL_COUNT, direction_cells
from ronnaplan.localization.fit.depth import TYPICAL_BLUR_MM
from ronnaplan.localization.fit.neighbourhood import Neighbourhood

AIR_QUANTILE, AIR_STEP_HU = 0.05, 600.0
"""What this share of the voxels outside a candidate do not exceed is air, if the middle one of them, which is what
holds a ball, is brighter by so much: by more than half of what lies between air and water."""

FACE_SHARE = 0.1
"""What is darker than the holder by more than this share of its step to air is seen beyond a face."""

FACE_MM = 2.0
"""A face nearer to the ball than this takes from its edge: its blur reaches so far, under the softest kernels, too."""

HALO_MM = 1.7
"""The blur of bright balls hides the air beside them as far as this. Balls of metal and ceramic that are half sunk in
gel, or lie in hollows of the skin, were taken for embedded by faces at 0.5 to 1.5 mm, and 75 to 170 um off."""

MOST_ENDING = 0.35
"""No more than this share of the directions is left out for faces, the nearest ones: in all others there is a ball."""


def within_its_holder(around: Neighbourhood, diameter_mm: float, layer_mm: float) -> Neighbourhood:
    """Return the voxels ``around`` a candidate as if what a ball is embedded in went on beyond its faces.

    Directions in which a face is near are left out; a candidate that is not embedded keeps all. ``layer_mm`` is the
    thickness of what is wrapped around the ball.
    """
    depth_mm = around.distances_mm - diameter_mm / 2.0 - max(layer_mm, 0.0)
    outside_hu = around.values_hu[depth_mm > TYPICAL_BLUR_MM]
    if not outside_hu.size:
        return around
    air_hu, middle_hu = (quantile(outside_hu, share) for share in (AIR_QUANTILE, 0.5))
    if middle_hu - air_hu < AIR_STEP_HU:
        return around
    halfway_hu = (air_hu + middle_hu) / 2.0
    is_air = (depth_mm > 0.0) & (around.values_hu < halfway_hu)
    cells, face_mm = direction_cells(around.offsets_mm), np.full(CELL_COUNT, np.inf)
    np.minimum.at(face_mm, cells[is_air], depth_mm[is_air])
    near_mm = min(float(np.quantile(face_mm, MOST_ENDING, method="lower")), FACE_MM)
    if near_mm < HALO_MM:  # it lies in air, or is held by less than most of its surface
        return around
    holder_hu = float(np.median(outside_hu[outside_hu > halfway_hu]))
    is_beyond = (depth_mm > 0.0) & (around.values_hu < holder_hu - FACE_SHARE * (holder_hu - air_hu))
    ends = face_mm < near_mm
    whole = replace(
        around, values_hu=np.where(is_beyond, holder_hu, around.values_hu), ending_share=float(np.mean(ends))
    )
    return whole.select(~ends[cells])
