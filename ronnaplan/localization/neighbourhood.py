"""The voxels about a candidate, at their true places."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray


@dataclass(frozen=True)
class Neighbourhood:
    """Voxels near a place: values in HU, and offsets from ``origin_mm`` along the slice axes u, v, w.

    ``indices`` (N, 3) are (slice, row, column) in the scan; ``offsets_mm`` (N, 3); ``values_hu`` (N,);
    ``axes`` (3, 3) has u, v, w as rows in LPS.
    """

    origin_mm: FloatArray
    axes: FloatArray
    indices: NDArray[np.intp]
    offsets_mm: FloatArray
    values_hu: FloatArray

    def select(self, chosen: NDArray[np.bool_]) -> Neighbourhood:
        """Keep only the ``chosen`` (N,) voxels."""
        return replace(
            self,
            indices=self.indices[chosen],
            offsets_mm=self.offsets_mm[chosen],
            values_hu=self.values_hu[chosen],
        )


def gather(volume: CTVolume, center_mm: FloatArray, reach_mm: float) -> Neighbourhood:
    """Collect the measured voxels within ``reach_mm`` of ``center_mm`` (3,) in LPS."""
    grid = volume.grid
    axes = grid.axes
    places = grid.slice_positions_mm - center_mm @ grid.normal
    first, last = np.searchsorted(places, [-reach_mm, reach_mm])
    center_uv = axes[:2] @ center_mm
    origins_uv = grid.origins_mm[first:last] @ axes[:2].T
    steps = np.array([grid.column_spacing_mm, grid.row_spacing_mm])
    windows = _windows((center_uv - origins_uv) / steps, reach_mm / steps, volume.voxels_hu.shape)
    rows = np.arange(windows[1, 0], windows[1, 1])
    columns = np.arange(windows[0, 0], windows[0, 1])
    k, j, i = np.meshgrid(np.arange(first, last), rows, columns, indexing="ij")
    u = origins_uv[k - first, 0] + i * steps[0] - center_uv[0]
    v = origins_uv[k - first, 1] + j * steps[1] - center_uv[1]
    w = np.broadcast_to(places[k], u.shape)
    values = volume.voxels_hu[first:last, rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] if k.size else u
    near = u * u + v * v + w * w <= reach_mm**2
    if volume.padding_hu is not None:
        near &= values != volume.padding_hu
    offsets = np.stack([u[near], v[near], w[near]], axis=-1)
    indices = np.stack([k[near], j[near], i[near]], axis=-1)
    return Neighbourhood(center_mm, axes, indices, offsets, values[near].astype(np.float64))


def _windows(centers: FloatArray, reach: FloatArray, shape: tuple[int, ...]) -> NDArray[np.intp]:
    """First and past-the-last column and row (2, 2) that cover every slice's window, inside the picture."""
    if len(centers) == 0:
        return np.zeros((2, 2), dtype=np.intp)
    low = np.floor(centers.min(axis=0) - reach)
    high = np.ceil(centers.max(axis=0) + reach) + 1
    size = np.array([shape[2], shape[1]])
    return np.stack([np.clip(low, 0, size), np.clip(high, 0, size)], axis=-1).astype(np.intp)
