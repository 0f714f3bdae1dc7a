"""A scan as it looks from three sides, for the eye only: the brightest voxel behind each place."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import AIR_HU
from ronnaplan.ct.volume import WAYS_TO_A_VOLUME, CTVolume
from ronnaplan.errors import check_type

PIXEL_MM = 2.5
MOST_VOXELS = 2_000_000
"""Of more voxels, every second, third ... is looked at."""

Silhouette = tuple[NDArray[np.float32], tuple[float, float, float, float]]


def silhouettes(volume: CTVolume) -> dict[tuple[int, int], Silhouette]:
    """Return for each pair of LPS axes (across, up) the brightest HU and where it lies, (left, right, bottom, top) mm.

    Each voxel goes to the pixel it lies in: slices may be tilted, rotated and unevenly spaced.
    """
    check_type(volume, CTVolume, "the volume", WAYS_TO_A_VOLUME)
    step = max(1, round((volume.voxels_hu.size / MOST_VOXELS) ** (1 / 3)))
    slices, rows, columns = (range(0, size, step) for size in volume.voxels_hu.shape)
    hu = volume.voxels_hu[::step, ::step, ::step].reshape(-1)
    kji = np.stack(np.meshgrid(slices, rows, columns, indexing="ij"), axis=-1).astype(np.float64)
    places = volume.grid.positions_mm(kji).reshape(-1, 3)
    low, high = places.min(axis=0), places.max(axis=0)
    pixel = max(PIXEL_MM, 1.2 * step * max(volume.grid.typical_gap_mm, volume.grid.row_spacing_mm))
    cells = ((places - low) / pixel).astype(np.int64)
    counts = cells.max(axis=0) + 1
    images: dict[tuple[int, int], Any] = {}
    for across, up in ((0, 1), (0, 2), (1, 2)):
        image = np.full(counts[[up, across]], AIR_HU, dtype=np.float32)
        np.maximum.at(image, (cells[:, up], cells[:, across]), hu)
        ends = low + counts * pixel
        images[across, up] = image, (low[across], ends[across], low[up], ends[up])
    assert (high <= low + counts * pixel).all()
    return images
