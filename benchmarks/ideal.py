"""The bound that the localizer is held against: a plain fit that is told where to look.

A ball of one level in surroundings of another, its edge blurred by a Gaussian that is as wide along the slices' normal
as fits best, is fitted to the voxels about the true center by SciPy's robust least squares. It finds nothing, judges
nothing and knows nothing of posts, slice profiles or streaks; it shares no code with `ronnaplan`'s own fit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray

REACH = 1.35
"""Voxels within this many radii of the true center are fitted."""

OUTLIER_SHARE = 0.05
"""Residuals beyond this share of the contrast count linearly, not squared: posts, inserts, neighbours."""

LEAST_BLUR_MM = 0.05


def ideal_center(volume: CTVolume, truth_mm: FloatArray, diameter_mm: float) -> FloatArray:
    """Return the center (3,) in LPS of a ball of about ``diameter_mm`` whose true center is ``truth_mm``."""
    offsets_mm, values_hu = _about(volume, truth_mm, REACH * diameter_mm / 2.0)
    normal = volume.grid.normal
    low, high = np.quantile(values_hu, [0.1, 0.9])
    blur_mm = volume.grid.row_spacing_mm

    def residuals(theta: FloatArray) -> FloatArray:
        *center, radius, in_plane, across, contrast, level = theta
        from_center = offsets_mm - center
        distance = np.linalg.norm(from_center, axis=1)
        along = (from_center @ normal / np.maximum(distance, 1e-9)) ** 2
        blur = np.sqrt(in_plane**2 * (1.0 - along) + across**2 * along + LEAST_BLUR_MM**2)
        inside: FloatArray = ndtr((radius - distance) / blur)
        found: FloatArray = level + contrast * inside - values_hu
        return found

    start = np.array([0.0, 0.0, 0.0, diameter_mm / 2.0, blur_mm, blur_mm, high - low, low])
    scale = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, high - low, high - low])
    fitted = least_squares(residuals, start, x_scale=scale, loss="soft_l1", f_scale=OUTLIER_SHARE * (high - low))
    *moved, _radius, _in_plane, _across, _contrast, _level = fitted.x
    center: FloatArray = truth_mm + moved
    return center


def _about(volume: CTVolume, center_mm: FloatArray, reach_mm: float) -> tuple[FloatArray, FloatArray]:
    """Offsets (N, 3) in LPS mm and values (N,) of the voxels within ``reach_mm`` of a place (3,)."""
    grid = volume.grid
    offsets_mm, values_hu = [], []
    for k in np.flatnonzero(np.abs(grid.slice_positions_mm - center_mm @ grid.normal) <= reach_mm):
        from_origin = center_mm - grid.origins_mm[k]
        rows = _window(from_origin, grid.row_step_mm, reach_mm, volume.voxels_hu.shape[1])
        columns = _window(from_origin, grid.column_step_mm, reach_mm, volume.voxels_hu.shape[2])
        j, i = (axis.ravel() for axis in np.meshgrid(rows, columns, indexing="ij"))
        offsets = j[:, np.newaxis] * grid.row_step_mm + i[:, np.newaxis] * grid.column_step_mm - from_origin
        near = np.einsum("nc,nc->n", offsets, offsets) <= reach_mm**2
        offsets_mm.append(offsets[near])
        values_hu.append(volume.voxels_hu[k, j[near], i[near]].astype(np.float64))
    return np.concatenate(offsets_mm), np.concatenate(values_hu)


def _window(from_origin_mm: FloatArray, step_mm: FloatArray, reach_mm: float, count: int) -> NDArray[np.intp]:
    """Which of ``count`` rows or columns, a step apart, come within ``reach_mm`` of a place so far from the first."""
    square = step_mm @ step_mm
    middle, reach = float(from_origin_mm @ step_mm / square), reach_mm / float(np.sqrt(square))
    return np.arange(max(int(np.ceil(middle - reach)), 0), min(int(middle + reach) + 1, count))
