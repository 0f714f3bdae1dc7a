"""The nearest voxel at a place: what a scan holds there, told without a fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.ct.volume import CTVolume, Voxels
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.cells import cell_directions

Lookup = tuple[Voxels, FloatArray, FloatArray, float]
"""A scan's voxels, its slices' origins (K, 3) along u, v, w, the distances of columns and rows, and the padding."""


def lookup_of(volume: CTVolume) -> Lookup:
    """Return what the compiled functions look voxels up in."""
    grid = volume.grid
    origins_mm = np.ascontiguousarray(grid.origins_mm @ grid.axes.T)
    return volume.voxels_hu, origins_mm, grid.steps_mm, volume.padding_or_nan_hu


def unseen_share(volume: CTVolume, center_mm: FloatArray, radius_mm: float) -> float:
    """Share of the directions about a center (3,) whose surface is outside the scan, or where voxels are padding."""
    return float(np.mean(np.isnan(sample_nearest(volume, center_mm + radius_mm * cell_directions()))))


def sample_nearest(volume: CTVolume, places_mm: FloatArray) -> FloatArray:
    """Nearest voxel's value (N,) at each place (N, 3) in LPS mm; NaN outside the scan and in its padding."""
    places = np.ascontiguousarray(places_mm @ volume.grid.axes.T)
    values = np.empty(len(places))
    fill_nearest(np.zeros(3), places, *lookup_of(volume), values)
    return values


@njit(cache=True, nogil=True)
def fill_nearest(
    place: FloatArray,
    offsets: FloatArray,
    voxels: Voxels,
    origins: FloatArray,
    steps: FloatArray,
    padding: float,
    values: FloatArray,
) -> None:
    """Fill ``values`` (M,) with the nearest voxel's at ``offsets`` (M, 3) from ``place``, along u, v, w.

    NaN outside the scan, which ends half a voxel beyond the last ones, and in its padding.
    """
    nearest = np.empty((len(offsets), 3), dtype=np.intp)
    _find_nearest(place, offsets, voxels.shape, origins, steps, nearest)
    # Where all of them are is known by now, so that the memory is waited for but once.
    for n in range(len(offsets)):
        values[n] = np.nan
        k, j, i = nearest[n]
        if k >= 0 and voxels[k, j, i] != padding:
            values[n] = voxels[k, j, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _find_nearest(
    place: FloatArray,
    offsets: FloatArray,
    shape: tuple[int, int, int],
    origins: FloatArray,
    steps: FloatArray,
    nearest: NDArray[np.intp],
) -> None:
    """Fill ``nearest`` (M, 3) with the slice, row and column of the voxel at each place; slice -1 outside the scan."""
    count, rows, columns = shape
    last = count - 1
    k = int((place[2] - origins[0, 2]) / max(origins[last, 2] - origins[0, 2], 1e-9) * last)
    k = min(max(k, 0), last)
    for n in range(len(offsets)):
        nearest[n, 0] = -1
        w = place[2] + offsets[n, 2]
        while k > 0 and origins[k - 1, 2] >= w:
            k -= 1
        while k <= last and origins[k, 2] < w:
            k += 1
        if 0 < k <= last:
            k -= int(w - origins[k - 1, 2] < origins[k, 2] - w)
        elif last > 0:
            end, before = (0, 1) if k == 0 else (last, last - 1)
            k = end
            if abs(w - origins[end, 2]) > 0.5 * abs(origins[end, 2] - origins[before, 2]):
                continue
        else:
            k = 0
        i = int(np.floor((place[0] + offsets[n, 0] - origins[k, 0]) / steps[0] + 0.5))
        j = int(np.floor((place[1] + offsets[n, 1] - origins[k, 1]) / steps[1] + 0.5))
        if 0 <= i < columns and 0 <= j < rows:
            nearest[n, 0], nearest[n, 1], nearest[n, 2] = k, j, i
