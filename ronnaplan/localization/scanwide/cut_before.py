"""Metal that a scale cut off before the scan was resampled: its balls' edges tell, and what they hold.

Where the scale ends, metal's blurred foot goes on into a plateau. Between the voxels of both, straight lines, splines
or Fourier's shifts then put values that no blurred ball shows beside a scale that ends: lines put too many just below
the end, and what rings lies about the end on both sides, so that nothing seems cut off and the ball too large. Most is
wrong just below the end. So what is refused there is fitted anew as if the scale had ended lower, by its foot alone.

That is done for balls only that tell so together. Nothing tells where the measured voxels lay: between two of them the
foot rises to its plateau, and how it was drawn there displaces a ball. That is stated as error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ronnaplan.bounds import AIR_HU
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.examine import LEAST_TOGETHER, Examine, Examined, distinct
from ronnaplan.localization.fit.descent import EDGE_BOUNDS
from ronnaplan.localization.fit.model import METAL_CONTRAST_HU
from ronnaplan.localization.fit.neighbourhood import gather
from ronnaplan.localization.fit.parameters import BACKGROUND, CONTRAST, EDGE
from ronnaplan.localization.scanner.scan import Scan

SCALES_END_HU, LEVEL_HU = 3071.0, 60.0
"""Where scales of 12 bits end, to which what rings keeps at the mean of a ball's inside: to 50 HU by Fourier's shifts,
to 20 by splines."""

INSIDE, AROUND = 0.35, 0.75
"""How far from the center a ball's inside, and its edge, are asked for, in diameters."""

RAGGED = 0.06
"""What was cut off and rings misfits by more of the contrast, as if it were an unclipped ball: by 0.07 to 0.3."""

CROWDED = 1.2
"""The uppermost quarter of the scale holds so many times the voxels of the quarter below, at the edges of balls: 0.7
where metal's foot rises into the scale's end, 1.6 and more once that was resampled by straight lines."""

LEFT = 0.75
"""The share of the scale above air that is left for fits. With 0.85 half of what Fourier's shifts have turned is found,
with 0.5 balls lie farther off."""

DRAWN_SHARE = 0.08
"""Standard error, as a share of the voxel along each axis, of where the foot was drawn."""

BRIGHTER = 1.6
"""Balls of metal seem brighter than the others at the median by no more than this factor: titanium shows 7,000 to
12,000 HU, steel 8,000 to 14,000, zirconia 9,000 to 26,000, what is larger by a fifth and more 15,000 to 46,000."""

OF_THE_EDGE = {"thickness", "coverage", "informed", "roundness", "whole", "converged"}
"""Tests that say no more than that an edge is none of a clipped ball."""


def as_cut_before(scan: Scan, examined: Sequence[Examined], examine: Examine) -> tuple[Scan, list[Examined]]:
    """Return the scan and what was ``examined`` in it; anew by ``examine`` what its balls tell was cut off before.

    Nothing changes where fewer than three balls tell. What is a marker remains as it is.
    """
    is_flat = bool(np.isfinite(scan.ceiling_hu))
    asked = [one for one in examined if (_may_be_cut(one) if is_flat else _holds_an_end(scan, one))]
    balls = distinct(one for one in asked if (_is_drawn(one) if is_flat else one.misfit > RAGGED))
    end_hu = min(scan.ceiling_hu, SCALES_END_HU)
    if len(balls) < LEAST_TOGETHER or (is_flat and _crowded(scan, balls, end_hu) < CROWDED):
        return scan, list(examined)
    lower = Scan(scan.volume, scan.slant, scan, scan.summed, ends_at_hu=AIR_HU + LEFT * (end_hu - AIR_HU))
    refused = [one for one in asked if not one.is_marker]
    again = examine(lower, [(one.candidate_mm, one.stated_mm) for one in refused])
    metal = {id(one): other for one, other in zip(refused, again, strict=True) if _is_metal(other)}
    most_hu = BRIGHTER * _usual_contrast_hu([*filter(_is_metal, examined), *metal.values()])
    stated = [
        metal[id(one)] if id(one) in metal and metal[id(one)].parameters[CONTRAST] <= most_hu else one
        for one in examined
    ]
    resampled = Scan(scan.volume.flagged(VolumeFlag.REFORMATTED), scan.slant, scan, scan.summed)
    return resampled, [_drawn(scan, one) if _is_cut(one, end_hu) else one for one in stated]


def _is_metal(one: Examined) -> bool:
    """Whether it is a marker that is so bright that a ball of another size hardly seems to be."""
    return one.is_marker and bool(one.parameters[CONTRAST] > METAL_CONTRAST_HU)


def _usual_contrast_hu(balls: Sequence[Examined]) -> float:
    """How bright the ``balls`` usually seem: larger ones seem brighter."""
    return float(np.median([one.parameters[CONTRAST] for one in distinct(balls)])) if balls else 0.0


def _is_cut(one: Examined, end_hu: float) -> bool:
    """Whether it is a marker that is brighter than where the scale had ended."""
    return one.is_marker and bool(one.parameters[CONTRAST] + one.parameters[BACKGROUND] > end_hu)


def _may_be_cut(one: Examined) -> bool:
    """Whether it may be a ball whose scale ends, but for its edge."""
    return one.is_clipped and one.failed <= OF_THE_EDGE


def _is_drawn(one: Examined) -> bool:
    """Whether a fit that came to rest gave its edge tails as long as any is allowed."""
    return one.failed <= {"coverage", "thickness"} and bool(one.parameters[EDGE] <= EDGE_BOUNDS[0])


def _holds_an_end(scan: Scan, one: Examined) -> bool:
    """Whether it is too large for the ball it may be, and holds what a scale's end shows at the mean."""
    return (
        "diameter" in one.failed <= OF_THE_EDGE | {"diameter"}
        and one.excess_mm > 0.0
        and abs(float(_values_hu(scan, one, INSIDE).mean()) - SCALES_END_HU) <= LEVEL_HU
    )


def _crowded(scan: Scan, balls: Sequence[Examined], end_hu: float) -> float:
    """How many times as many voxels of the ``balls`` lie in the uppermost quarter of the scale as in the one below."""
    values_hu = np.concatenate([_values_hu(scan, one, AROUND) for one in balls])
    shares = (values_hu[values_hu < end_hu] - AIR_HU) / (end_hu - AIR_HU)
    upper, lower = float((shares >= 0.75).sum()), float(((shares >= 0.5) & (shares < 0.75)).sum())
    return upper / max(lower, 1.0)


def _values_hu(scan: Scan, one: Examined, reach: float) -> FloatArray:
    """Values (N,) of the voxels within so many diameters of a ball's center."""
    return gather(scan.volume, one.center_mm, reach * one.stated_mm, scan.volume.grid.axes).values_hu


def _drawn(scan: Scan, one: Examined) -> Examined:
    """State how far off the edge of a marker may have been drawn between voxels."""
    grid = scan.volume.grid
    voxel_mm = np.array([*grid.steps_mm, scan.gap_mm])
    error_mm2: FloatArray = grid.axes.T @ np.diag((DRAWN_SHARE * voxel_mm) ** 2) @ grid.axes
    return replace(one, covariance_mm2=one.covariance_mm2 + error_mm2)
