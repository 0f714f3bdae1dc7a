"""What rays through a ball lose to all else, summed up from the picture of its slices."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kernelcache import njit
from ronnaplan.bounds import AIR_HU
from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.parameters import BACKGROUND, BLUR, RADIUS
from ronnaplan.localization.scanner.summed import NO_LOSS_HU, PADDING_HU, WATER_PER_MM

VIEWS, STEP_MM, APART_MM = 45, 3.0, 0.75
"""Directions in which all else is summed up, in these steps along rays that are so far apart."""

HEIGHTS = 0.5
"""All else changes slowly from slice to slice: it is summed up at heights so many radii apart, straight in between."""

CLEAR_BLURS = 1.5
"""What is nearer to the ball's edge is its own blur."""


@dataclass(frozen=True)
class Beside:
    """What rays lose to all but a ball, (K, `VIEWS`, S), in slices at ``heights_mm`` (K,) from its center.

    The rays of each view pass the ball's center at ``places_mm`` (S,).
    """

    heights_mm: FloatArray
    places_mm: FloatArray
    losses: FloatArray


def all_beside(volume: CTVolume, fit: BallFit) -> Beside:
    """Sum up what rays through a ball lose to all else, in the picture, at some of the heights that show it.

    What surrounds the ball is taken for air, if it is nearer to air than to water: the scales of cone beams begin
    elsewhere.
    """
    grid, radius_mm = volume.grid, float(fit.theta[RADIUS])
    above_mm = grid.slice_positions_mm - fit.center_mm @ grid.normal
    wanted_mm = np.arange(-radius_mm, radius_mm + 1e-9, HEIGHTS * radius_mm)
    numbers = np.unique(np.abs(above_mm - wanted_mm[:, np.newaxis]).argmin(axis=1))
    clear_mm = radius_mm + CLEAR_BLURS * float(fit.theta[BLUR])
    places_mm = np.arange(-radius_mm - APART_MM, radius_mm + 2.0 * APART_MM, APART_MM)
    steps_mm, padding_hu = grid.steps_mm, volume.padding_or_nan_hu
    around_hu = float(fit.theta[BACKGROUND])
    air_hu = around_hu if around_hu < 0.5 * AIR_HU else AIR_HU
    losses = np.zeros((len(numbers), VIEWS, len(places_mm)))
    for n, number in enumerate(numbers):
        corner_mm = grid.axes[:2] @ (grid.origins_mm[number] - fit.center_mm)
        picture_hu = volume.voxels_hu[number].copy()  # rays run across its rows: they would wait for the memory
        _sum_up(picture_hu, corner_mm, steps_mm, air_hu, padding_hu, clear_mm, places_mm, losses[n])
    return Beside(above_mm[numbers], places_mm, losses)


@njit(cache=True, nogil=True)
def _sum_up(
    picture: FloatArray,
    corner: FloatArray,
    steps: FloatArray,
    air: float,
    padding: float,
    clear: float,
    places: FloatArray,
    losses: FloatArray,
) -> None:
    """Fill ``losses`` (`VIEWS`, S) with what rays lose to a slice's ``picture`` beyond ``clear`` mm from the ball.

    The ``corner`` is the place of the first pixel from the ball's center, and ``steps`` are between pixels.
    """
    rows, columns = picture.shape
    for view in range(VIEWS):
        angle = (view + 0.5) * math.pi / VIEWS
        across_u, across_v = math.cos(angle), math.sin(angle)
        for s in range(len(places)):
            column = (places[s] * across_u - corner[0]) / steps[0] + 0.5
            row = (places[s] * across_v - corner[1]) / steps[1] + 0.5
            by_column, by_row = -across_v * STEP_MM / steps[0], across_u * STEP_MM / steps[1]
            least, most = -1e9, 1e9
            for start, step, end in ((column, by_column, columns), (row, by_row, rows)):
                if abs(step) < 1e-9:
                    if start < 0.0 or start >= end:
                        most = least
                    continue
                one, other = -start / step, (end - start) / step
                least, most = max(least, min(one, other)), min(most, max(one, other))
            total, square = 0.0, clear * clear - places[s] * places[s]
            for n in range(math.ceil(least), math.floor(most) + 1):
                if n * n * STEP_MM * STEP_MM <= square:
                    continue
                i, j = int(column + n * by_column), int(row + n * by_row)
                if 0 <= i < columns and 0 <= j < rows:
                    value = picture[j, i]
                    if value - air > NO_LOSS_HU - AIR_HU and value < PADDING_HU and value != padding:
                        total += value - air
            losses[view, s] = total * STEP_MM * WATER_PER_MM / 1000.0
