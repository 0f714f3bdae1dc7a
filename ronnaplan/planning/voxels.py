"""The measured voxels about a place, each where its slice really lies; nothing is interpolated."""

from __future__ import annotations

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray


def gap_mm(volume: CTVolume, place_mm: FloatArray) -> float:
    """Return the distance between the slices about a place (3,), LPS mm."""
    positions = volume.grid.slice_positions_mm
    k = int(np.clip(np.searchsorted(positions, place_mm @ volume.grid.normal), 1, len(positions) - 1))
    return float(positions[k] - positions[k - 1])


def voxels_near(volume: CTVolume, center_mm: FloatArray, reach_mm: float) -> tuple[FloatArray, FloatArray]:
    """Return offsets (N, 3) in LPS and values (N,) of the measured voxels within ``reach_mm`` of a place (3,).

    What `localization.fit.neighbourhood.gather` returns, without compiled code: the planner loads no compiler.
    """
    grid = volume.grid
    axes, places = grid.axes, grid.slice_positions_mm - center_mm @ grid.normal
    first, last = np.searchsorted(places, [-reach_mm, reach_mm])
    if first == last:
        return np.empty((0, 3)), np.empty(0)
    origins = grid.origins_mm[first:last] @ axes[:2].T - axes[:2] @ center_mm
    steps = np.array([grid.column_spacing_mm, grid.row_spacing_mm])
    most = np.array(volume.voxels_hu.shape[:0:-1])
    low = np.clip(np.floor((-origins.max(axis=0) - reach_mm) / steps), 0, most).astype(int)
    high = np.clip(np.ceil((-origins.min(axis=0) + reach_mm) / steps) + 1, 0, most).astype(int)
    u = (origins[:, 0, None] + np.arange(low[0], high[0]) * steps[0])[:, None, :]
    v = (origins[:, 1, None] + np.arange(low[1], high[1]) * steps[1])[:, :, None]
    w = places[first:last, None, None]
    values = volume.voxels_hu[first:last, low[1] : high[1], low[0] : high[0]]
    near = u * u + v * v + w * w <= reach_mm**2
    if volume.padding_hu is not None:
        near &= values != volume.padding_hu
    offsets = np.stack([np.broadcast_to(one, near.shape)[near] for one in (u, v, w)], axis=-1)
    return offsets @ axes, values[near].astype(np.float64)
