"""The measured voxels about a place, each where its slice really lies; nothing is interpolated.

Of voxels finer than any usual scan's only every second or so is taken: a ball of some millimetres then holds no more of
them, and what is fitted to them takes no longer, however fine the scan is.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray

LEAST_MM3 = 0.06
"""Voxels taken have at least this much room each (0.39 mm to all sides), which the scans of whole heads mostly have."""


def gap_mm(volume: CTVolume, place_mm: FloatArray) -> float:
    """Return the distance between the slices about a place (3,), LPS mm."""
    positions = volume.grid.slice_positions_mm
    k = int(np.clip(np.searchsorted(positions, place_mm @ volume.grid.normal), 1, len(positions) - 1))
    return float(positions[k] - positions[k - 1])


def voxels_near(volume: CTVolume, center_mm: FloatArray, reach_mm: float) -> tuple[FloatArray, FloatArray]:
    """Return offsets (N, 3) in LPS and values (N,) of the measured voxels within ``reach_mm`` of a place (3,).

    Of fine ones every so manyth in each direction (`LEAST_MM3`). Of others it is what
    `localization.fit.neighbourhood.gather` returns, without compiled code: the planner loads no compiler.
    """
    grid = volume.grid
    axes, places = grid.axes, grid.slice_positions_mm - center_mm @ grid.normal
    first, last = np.searchsorted(places, [-reach_mm, reach_mm])
    if first == last:
        return np.empty((0, 3)), np.empty(0)
    origins = grid.origins_mm[first:last] @ axes[:2].T - axes[:2] @ center_mm
    steps = grid.steps_mm
    most = np.array(volume.voxels_hu.shape[:0:-1])
    low = np.clip(np.floor((-origins.max(axis=0) - reach_mm) / steps), 0, most).astype(int)
    high = np.clip(np.ceil((-origins.min(axis=0) + reach_mm) / steps) + 1, 0, most).astype(int)
    every = _every(np.array([*steps, np.diff(places[max(first - 1, 0) : last + 1]).max(initial=0.0)]))
    u = (origins[:: every[2], 0, None] + np.arange(low[0], high[0], every[0]) * steps[0])[:, None, :]
    v = (origins[:: every[2], 1, None] + np.arange(low[1], high[1], every[1]) * steps[1])[:, :, None]
    w = places[first : last : every[2], None, None]
    values = volume.voxels_hu[first : last : every[2], low[1] : high[1] : every[1], low[0] : high[0] : every[0]]
    near = u * u + v * v + w * w <= reach_mm**2
    if volume.padding_hu is not None:
        near &= values != volume.padding_hu
    offsets = np.stack([np.broadcast_to(one, near.shape)[near] for one in (u, v, w)], axis=-1)
    return offsets @ axes, values[near].astype(np.float64)


def _every(spacings_mm: FloatArray) -> list[int]:
    """Return the how manyth voxels are taken along a row, down a column and across slices so far apart (3,).

    Where they lie closest they are thinned out first: neighbours tell the same.
    """
    every = np.ones(3, dtype=int)
    while 0.0 < (spacings_mm * every).prod() < LEAST_MM3:
        every[(spacings_mm * every).argmin()] += 1
    return [int(one) for one in every]
