"""Coarse copies of a scan, in which balls are looked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.bounds import LOWEST_HU
from ronnaplan.ct.grid import SliceGrid
from ronnaplan.ct.volume import CTVolume, Voxels
from ronnaplan.threads import in_parts

COARSE_SHARE = 1.0 / 5.0
"""The coarse copy's voxels are at most this share of the diameter, enough to see the marker's surface turn ..."""

COARSE_FLOOR_MM = 1.0
"""... but need not be smaller than this, unless the marker is smaller than three of them."""

HIGHEST_HU = 32767
"""Values above are metal at its brightest, of which the copy's 16 bits hold no more; those below `LOWEST_HU` are raised
to it."""

Blocks = tuple[int, int, int]
"""How many slices, rows and columns of a scan make one voxel of its copy."""


def coarse_voxel_mm(diameter_mm: float, coarse_share: float = COARSE_SHARE) -> float:
    """Largest voxel of the copy in which balls of ``diameter_mm`` are looked for."""
    return max(diameter_mm * coarse_share, min(diameter_mm / 3.0, COARSE_FLOOR_MM))


def coarsen(volume: CTVolume, voxel_mm: float) -> CTVolume:
    """Average whole blocks of voxels so that none grows beyond ``voxel_mm`` where it was smaller before."""
    by = blocks(volume, voxel_mm)
    if by == (1, 1, 1) and volume.voxels_hu.dtype == np.int16 and volume.voxels_hu.min() >= LOWEST_HU:
        return volume
    grid = coarse_grid(volume, by)
    return replace(volume, voxels_hu=averaged(volume, by, 0, len(grid.origins_mm)), grid=grid)


def blocks(volume: CTVolume, voxel_mm: float) -> Blocks:
    """Return how many slices, rows and columns of a scan, of which there are so many, make one voxel so coarse.

    Where the slices of a part lie farther apart, no more are taken than make a voxel there.
    """
    grid = volume.grid
    gap_mm = grid.typical_gap_mm if grid.is_evenly_spaced else float(grid.spacings_mm.max())
    sizes_mm = gap_mm, grid.row_spacing_mm, grid.column_spacing_mm
    by_k, by_j, by_i = (
        min(max(1, int(voxel_mm / size_mm)), count)
        for size_mm, count in zip(sizes_mm, volume.voxels_hu.shape, strict=True)
    )
    return by_k, by_j, by_i


def coarse_grid(volume: CTVolume, by: Blocks) -> SliceGrid:
    """Return where the voxels of a copy lie."""
    grid, (by_k, by_j, by_i) = volume.grid, by
    slices = len(volume.voxels_hu) // by_k
    origins = grid.origins_mm[: slices * by_k].reshape(slices, by_k, 3).mean(axis=1)
    return replace(
        grid,
        origins_mm=origins + (by_j - 1) / 2 * grid.row_step_mm + (by_i - 1) / 2 * grid.column_step_mm,
        row_step_mm=grid.row_step_mm * by_j,
        column_step_mm=grid.column_step_mm * by_i,
    )


def averaged(volume: CTVolume, by: Blocks, first: int, end: int) -> NDArray[np.int16]:
    """Return the slices ``first`` to before ``end`` of a copy (K, J, I): means of blocks of voxels."""
    by_k, by_j, by_i = by
    _, rows, columns = volume.voxels_hu.shape
    coarse = np.empty((end - first, rows // by_j, columns // by_i), dtype=np.int16)
    fine = volume.voxels_hu[first * by_k : end * by_k]
    in_parts(lambda some, past: _average(fine, by_k, by_j, by_i, coarse, some, past), len(coarse))
    return coarse


@njit(cache=True, nogil=True)
def _average(
    fine: Voxels,
    by_k: int,
    by_j: int,
    by_i: int,
    coarse: NDArray[np.int16],
    first: int,
    end: int,
) -> None:
    """Fill the slices ``first`` to ``end`` of ``coarse`` with means of so many voxels, within what the copy holds."""
    _, rows, columns = coarse.shape
    sums, means = np.empty(columns * by_i, dtype=np.float32), np.empty(columns, dtype=np.float32)
    per_pixel, per_slice = np.float32(1.0 / (by_j * by_i)), np.float32(1.0 / by_k)
    lowest, highest = np.float32(LOWEST_HU), np.float32(HIGHEST_HU)
    for k in range(first, end):
        for j in range(rows):
            means[:] = 0.0
            for a in range(by_k):
                sums[:] = 0.0
                for b in range(by_j):
                    row = fine[k * by_k + a, j * by_j + b]
                    for i in range(len(sums)):
                        sums[i] += max(np.float32(row[i]), lowest)
                _add_means(sums, by_i, per_pixel, means)
            for i in range(columns):
                coarse[k, j, i] = np.int16(min(means[i] * per_slice, highest))


@njit(cache=True, nogil=True)
def _add_means(sums: NDArray[np.float32], by_i: int, per_pixel: np.float32, means: NDArray[np.float32]) -> None:
    """Add to ``means`` what each ``by_i`` of the ``sums`` tell, in whole HU."""
    if by_i == 2:  # the commonest ones, several means at once
        for i in range(len(means)):
            means[i] += np.floor((sums[2 * i] + sums[2 * i + 1]) * per_pixel + np.float32(0.5))
    elif by_i == 1:
        for i in range(len(means)):
            means[i] += np.rint(sums[i] * per_pixel)
    elif by_i == 3:
        for i in range(len(means)):
            means[i] += np.rint((sums[3 * i] + sums[3 * i + 1] + sums[3 * i + 2]) * per_pixel)
    elif by_i == 4:
        for i in range(len(means)):
            total = (sums[4 * i] + sums[4 * i + 1]) + (sums[4 * i + 2] + sums[4 * i + 3])
            means[i] += np.rint(total * per_pixel)
    else:
        for i in range(len(means)):
            means[i] += np.rint(_sum(sums, i * by_i, (i + 1) * by_i) * per_pixel)


@njit(cache=True, nogil=True)
def _sum(values: NDArray[np.float32], first: int, end: int) -> np.float32:
    """Sum up without the array that a slice would make."""
    total = np.float32(0.0)
    for n in range(first, end):
        total += values[n]
    return total
