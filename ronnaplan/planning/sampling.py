"""CT values anywhere, each slice taken at its own place.

Within a slice the value is interpolated bilinearly, between the two neighbouring slices linearly along their
normal, so that tilted and unevenly spaced slices are read where they are. `ronnaplan.planning.compiled` does the
same for tens of thousands of rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.ct.volume import CTVolume, Voxels
from ronnaplan.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class SliceSampler:
    """A scan as the loops over its voxels want it.

    ``voxels`` (K, J, I); rows of ``axes`` (3, 3) are u (along a row), v (down a column), w (along the normal) in
    LPS; ``origins_uv_mm`` (K, 2) and ``w_mm`` (K,) place the first voxel of each slice; ``steps_mm`` (2,) are the
    column and row spacing.
    """

    voxels: Voxels
    axes: FloatArray
    origins_uv_mm: FloatArray
    w_mm: FloatArray
    steps_mm: FloatArray

    @classmethod
    def of(cls, volume: CTVolume) -> SliceSampler:
        """Lay out ``volume``; its voxels are shared, not copied."""
        axes = volume.grid.axes
        origins = volume.grid.origins_mm @ axes.T
        return cls(
            volume.voxels_hu if volume.voxels_hu.flags.c_contiguous else volume.voxels_hu.copy(),
            axes,
            np.ascontiguousarray(origins[:, :2]),
            np.ascontiguousarray(origins[:, 2]),
            volume.grid.steps_mm,
        )

    def values_hu(self, points_mm: FloatArray) -> FloatArray:
        """Return the interpolated HU (N,) at LPS ``points_mm`` (N, 3); NaN outside the scan."""
        u, v, w = (points_mm @ self.axes.T).T
        slices = len(self.w_mm)
        if slices < 2:
            return np.full(len(points_mm), np.nan)
        k = np.clip(np.searchsorted(self.w_mm, w, side="right") - 1, 0, slices - 2)
        share = (w - self.w_mm[k]) / (self.w_mm[k + 1] - self.w_mm[k])
        values = (1.0 - share) * self._bilinear(k, u, v) + share * self._bilinear(k + 1, u, v)
        return np.where((self.w_mm[0] <= w) & (w <= self.w_mm[-1]), values, np.nan)

    def _bilinear(self, k: NDArray[np.intp], u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the values (N,) in slices ``k``, at least `LOWEST_HU`; NaN outside."""
        rows, columns = self.voxels.shape[1:]
        row = (v - self.origins_uv_mm[k, 1]) / self.steps_mm[1]
        column = (u - self.origins_uv_mm[k, 0]) / self.steps_mm[0]
        outside = ~((row >= 0.0) & (row <= rows - 1) & (column >= 0.0) & (column <= columns - 1))
        row[outside] = column[outside] = 0.0
        j, i = np.minimum(row.astype(np.intp), rows - 2), np.minimum(column.astype(np.intp), columns - 2)
        y, x = row - j, column - i

        def at(below: int, beside: int) -> FloatArray:
            values: FloatArray = self.voxels[k, j + below, i + beside].astype(np.float64)
            return np.maximum(values, LOWEST_HU)

        values: FloatArray = (1.0 - y) * ((1.0 - x) * at(0, 0) + x * at(0, 1))
        values += y * ((1.0 - x) * at(1, 0) + x * at(1, 1))
        values[outside] = np.nan
        return values
