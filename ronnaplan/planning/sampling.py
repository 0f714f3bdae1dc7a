"""CT values anywhere, each slice taken at its own place: the compiled inner loops of the planning room.

Points are given along the slice axes (u along a row, v down a column, w along the normal). Within a slice the
value is interpolated bilinearly, between the two neighbouring slices linearly along their normal, so that tilted
and unevenly spaced slices are read where they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.detect import slice_axes

AIR_HU = -1024.0
"""Values below air are not physical (padding, the corners of the picture) and are raised to it."""


@dataclass(frozen=True, eq=False)
class Scan:
    """A scan as the compiled loops want it.

    ``voxels`` (K, J, I); rows of ``axes`` (3, 3) are u, v, w in LPS; ``origins_uv_mm`` (K, 2) and ``w_mm`` (K,)
    place the first voxel of each slice; ``steps_mm`` (2,) are the column and row spacing.
    """

    voxels: NDArray[np.int16] | NDArray[np.float32]
    axes: FloatArray
    origins_uv_mm: FloatArray
    w_mm: FloatArray
    steps_mm: FloatArray

    @classmethod
    def of(cls, volume: CTVolume) -> Scan:
        """Lay out ``volume``; its voxels are shared, not copied."""
        axes = slice_axes(volume.grid)
        steps = np.array([volume.grid.column_spacing_mm, volume.grid.row_spacing_mm])
        origins = volume.grid.origins_mm @ axes.T
        return cls(
            volume.voxels_hu if volume.voxels_hu.flags.c_contiguous else volume.voxels_hu.copy(),
            axes,
            np.ascontiguousarray(origins[:, :2]),
            np.ascontiguousarray(origins[:, 2]),
            steps,
        )

    def values_hu(self, points_mm: FloatArray) -> FloatArray:
        """Return the interpolated HU (N,) at LPS ``points_mm`` (N, 3); NaN outside the scan."""
        values = np.empty(len(points_mm))
        local = np.ascontiguousarray(points_mm @ self.axes.T)
        sample_all(self.voxels, self.origins_uv_mm, self.w_mm, self.steps_mm, local, values)
        return values


@njit(cache=True, nogil=True, error_model="numpy")
def slice_below(w_mm: FloatArray, w: float, guess: int) -> int:
    """Return k with ``w_mm[k] <= w <= w_mm[k + 1]``, searched from ``guess``; -1 outside."""
    count = len(w_mm)
    if count < 2 or not (w_mm[0] <= w <= w_mm[count - 1]):
        return -1
    k = min(max(guess, 0), count - 2)
    while w < w_mm[k]:
        k -= 1
    while w > w_mm[k + 1]:
        k += 1
    return k


@njit(cache=True, nogil=True, error_model="numpy")
def bilinear(plane, row, column):  # type: ignore[no-untyped-def]
    """Return the value of ``plane`` (J, I) at a fractional place, at least `AIR_HU`; NaN outside."""
    rows, columns = plane.shape
    if not (0.0 <= row <= rows - 1 and 0.0 <= column <= columns - 1):
        return np.nan
    j, i = min(int(row), rows - 2), min(int(column), columns - 2)
    y, x = row - j, column - i
    upper = (1.0 - x) * max(plane[j, i], AIR_HU) + x * max(plane[j, i + 1], AIR_HU)
    lower = (1.0 - x) * max(plane[j + 1, i], AIR_HU) + x * max(plane[j + 1, i + 1], AIR_HU)
    return (1.0 - y) * upper + y * lower


@njit(cache=True, nogil=True, error_model="numpy")
def sample(voxels, origins, w_mm, steps, u, v, w, guess):  # type: ignore[no-untyped-def]
    """Return the value at (u, v, w) in HU, NaN outside, and the slice below it (a guess for the next call)."""
    k = slice_below(w_mm, w, guess)
    if k < 0:
        return np.nan, guess
    low = bilinear(voxels[k], (v - origins[k, 1]) / steps[1], (u - origins[k, 0]) / steps[0])
    high = bilinear(voxels[k + 1], (v - origins[k + 1, 1]) / steps[1], (u - origins[k + 1, 0]) / steps[0])
    share = (w - w_mm[k]) / (w_mm[k + 1] - w_mm[k])
    return (1.0 - share) * low + share * high, k


@njit(cache=True, nogil=True, error_model="numpy")
def sample_all(voxels, origins, w_mm, steps, points, values):  # type: ignore[no-untyped-def]
    """Fill ``values`` (N,) with the HU at ``points`` (N, 3) = (u, v, w)."""
    guess = 0
    for n in range(len(points)):
        values[n], guess = sample(voxels, origins, w_mm, steps, points[n, 0], points[n, 1], points[n, 2], guess)
