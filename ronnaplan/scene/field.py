"""A scan on even cells, blurred before it is sampled: what surfaces are drawn from, never to measure on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.ct.reader import in_parallel
from ronnaplan.geometry import FloatArray
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.scene.cut import Cut
from ronnaplan.scene.sampled import values_hu

CELL_MM = 1.6
"""Fine enough for ears and markers, coarse enough for a browser."""

BLUR_CELLS = 0.7
"""Standard deviation of the blur: what is finer than the cells would come out as steps and rings."""

BLUR_GAPS = 0.85
"""Least standard deviation of the blur across the slices, in gaps between them, which would come out as terraces."""

GREATEST_HU = 2500.0
"""Metal is lowered to this, or it would spread as far as it is bright."""


@dataclass(frozen=True, eq=False)
class Field:
    """Values in HU (nz, ny, nx) on cubic cells along LPS; ``origin_mm`` (3,) is the center of the first, in LPS."""

    values: NDArray[np.float32]
    origin_mm: FloatArray
    cell_mm: float

    @classmethod
    def of(cls, volume: CTVolume, cell_mm: float = CELL_MM) -> Field:
        """Sample a scan; what lies outside it is air."""
        low, high = bounds_mm(volume)
        columns, rows, planes = (np.floor((high - low) / cell_mm).astype(int) + 1).tolist()
        if volume.voxels_hu.shape[0] < 2 or min(volume.voxels_hu.shape[1:]) * min(rows, columns) < 4:
            return cls(np.full((1, 1, 1), LOWEST_HU, dtype=np.float32), low, cell_mm)
        scan = SliceSampler.of(_blurred(volume, cell_mm))
        values = np.empty((planes, rows, columns), dtype=np.float32)
        middle = low + cell_mm * (np.array([columns, rows, 0]) - np.array([1, 1, 0])) / 2

        def fill(number: int) -> None:
            center = middle + np.array([0.0, 0.0, cell_mm * number])
            cut = Cut(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), center, cell_mm * min(rows, columns))
            values[number] = values_hu(scan, cut, (rows, columns), LOWEST_HU)

        in_parallel(fill, planes, progress=False)
        return cls(values, low, cell_mm)


def of_mask(volume: CTVolume, mask: NDArray[np.bool_]) -> Field:
    """Sample a region (K, J, I) of a scan: 1 inside, 0 outside."""
    whole = replace(volume, voxels_hu=mask.astype(np.float32))
    found = Field.of(whole)
    return replace(found, values=np.maximum(found.values, 0.0))


def bounds_mm(volume: CTVolume) -> tuple[FloatArray, FloatArray]:
    """Return smallest and largest LPS coordinates (3,) of the voxel centers."""
    ends = [[0.0, n - 1.0] for n in volume.voxels_hu.shape]
    corners = volume.grid.positions_mm(np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 3))
    return corners.min(axis=0), corners.max(axis=0)


def _blurred(volume: CTVolume, cell_mm: float) -> CTVolume:
    """Return a scan whose slices have pixels of about a cell, blurred within the slices and across them."""
    import cv2
    from scipy.ndimage import gaussian_filter1d

    grid, (_, rows, columns) = volume.grid, volume.voxels_hu.shape
    across = max(2, round(columns * min(1.0, grid.column_spacing_mm / cell_mm)))
    down = max(2, round(rows * min(1.0, grid.row_spacing_mm / cell_mm)))
    values = np.empty((len(volume.voxels_hu), down, across), dtype=np.float32)
    blur = BLUR_CELLS * cell_mm * across / columns / grid.column_spacing_mm

    def fill(number: int) -> None:
        whole = np.clip(volume.voxels_hu[number].astype(np.float32), LOWEST_HU, GREATEST_HU)
        small = cv2.resize(whole, (across, down), interpolation=cv2.INTER_AREA)
        values[number] = cv2.GaussianBlur(small, (0, 0), blur)

    in_parallel(fill, len(values), progress=False)
    blur_slices = max(BLUR_GAPS, BLUR_CELLS * cell_mm / grid.typical_gap_mm)
    gaussian_filter1d(values, blur_slices, axis=0, mode="nearest", output=values)
    wide, high = columns / across, rows / down
    first = grid.origins_mm + (wide - 1) / 2 * grid.column_step_mm + (high - 1) / 2 * grid.row_step_mm
    coarse = SliceGrid(first, grid.row_step_mm * high, grid.column_step_mm * wide, grid.thickness_mm)
    return replace(volume, voxels_hu=values, grid=coarse)
