"""How noisy voxels are about a fitted ball."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import SD_PER_DEVIATION, FloatArray
from ronnaplan.localization.fit.algebra import quantile
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.cells import CELL_COUNT, cell_means, direction_cell
from ronnaplan.localization.fit.depth import SURFACE_BLURS, depth_and_blur
from ronnaplan.localization.fit.parameters import BACKGROUND, U, V, W
from ronnaplan.localization.fit.shading import QUANTIZATION_NOISE_HU

CUT_OFF_SHARE = 0.6
"""Half of the air at a scale's lower end is cut off, and the other half tells its noise; of air below it, more is."""

MIN_FLAT_VOXELS = 30
"""A zone with fewer voxels says nothing of the noise."""


def noise_level(fit: BallFit) -> float:
    """Standard deviation of the noise (HU) where the ball and its surroundings are flat.

    Robust to streaks (each direction's mean is taken off, or that of all where hardly two voxels share a direction) and
    to air at the bottom of the scale (only the upper half of the values counts); the quieter of inside and outside, for
    what disturbs only adds. Air below the scale has no noise: where the ball's inside tells, it is not asked.
    """
    around = fit.neighbourhood
    is_measured = fit.jacobian[:, BACKGROUND] != 0.0  # clipped voxels have no noise
    level = _quieter(around.offsets_mm, fit.residuals_hu, fit.used, is_measured, around.is_cut_off, fit.theta)
    if math.isinf(level):
        level = float(np.sqrt(np.mean(fit.residuals_hu[fit.used] ** 2))) if fit.used.any() else 1.0
    return max(level, QUANTIZATION_NOISE_HU)


@njit(cache=True, nogil=True)
def _quieter(
    offsets: FloatArray,
    residuals: FloatArray,
    used: NDArray[np.bool_],
    is_measured: NDArray[np.bool_],
    is_cut_off: NDArray[np.bool_],
    theta: FloatArray,
) -> float:
    """Return the noise of the quieter of inside and outside, by the voxels (N,); infinity where neither tells any."""
    zones, cells = np.full(len(offsets), -1, np.int8), np.empty(len(offsets), np.intp)
    outside = cut_off = 0
    for n in range(len(offsets)):
        u, v, w = offsets[n, U] - theta[U], offsets[n, V] - theta[V], offsets[n, W] - theta[W]
        depth, blur = depth_and_blur(u, v, w, theta)
        if used[n] and abs(depth) > SURFACE_BLURS * blur:
            outside += depth > 0.0
            cut_off += depth > 0.0 and is_cut_off[n]
            if is_measured[n]:
                zones[n], cells[n] = 1 if depth > 0.0 else 0, direction_cell(u, v, w)
    air_is_cut_off = cut_off > CUT_OFF_SHARE * outside
    level = _of_zones(residuals, zones, cells, air_is_cut_off)
    if math.isinf(level):
        level = _of_zones(residuals, zones, np.zeros(len(offsets), np.intp), air_is_cut_off)
    return level if level < math.inf else _noise(residuals, zones, 1, cells)


@njit(cache=True, nogil=True)
def _of_zones(
    residuals: FloatArray, zones: NDArray[np.int8], cells: NDArray[np.intp], air_is_cut_off: bool
) -> float:
    """Return the noise of the quieter of both zones, the inside where air is cut off; infinity if untold."""
    inside = _noise(residuals, zones, 0, cells)
    return inside if air_is_cut_off else min(inside, _noise(residuals, zones, 1, cells))


@njit(cache=True, nogil=True)
def _noise(residuals: FloatArray, zones: NDArray[np.int8], zone: int, cells: NDArray[np.intp]) -> float:
    """Return the noise of the voxels (N,) of a ``zone``, beside the mean of each of their ``cells`` (N,).

    Infinity where they are too few. What a mean of ``count`` voxels takes up of their noise is given back; a voxel that
    is alone in its cell is its own mean, and tells nothing.
    """
    is_there, counts = zones == zone, np.zeros(CELL_COUNT)
    means = cell_means(residuals, cells, is_there)
    for n in range(len(zones)):
        if is_there[n]:
            counts[cells[n]] += 1.0
    left_over, told = np.empty(len(zones)), 0
    for n in range(len(zones)):
        cell = cells[n]
        if is_there[n] and counts[cell] > 1.0:
            left_over[told] = (residuals[n] - means[cell]) / math.sqrt(1.0 - 1.0 / counts[cell])
            told += 1
    if told < MIN_FLAT_VOXELS:
        return math.inf
    middle = quantile(left_over[:told], 0.5)
    upper, above = np.empty(told), 0
    for left in left_over[:told]:
        if left >= middle:
            upper[above] = left - middle
            above += 1
    return float(SD_PER_DEVIATION * quantile(upper[:above], 0.5))
