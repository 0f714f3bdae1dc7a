"""What a scan holds in a flat cut, each voxel taken from where it is: tilt and uneven slices included."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.scene.cut import Cut

ROWS_AT_ONCE = 128
"""Of a picture: what is worked with needs six times the memory of the values."""

LEAST_SLOPE = 1e-9
"""A plane that rises less than this along its rows is level there."""

LEAST_SHIFT_MM = 1e-6
"""Slices that are shifted less against each other lie straight above each other."""


def values_hu(scan: SliceSampler, cut: Cut, shape: tuple[int, int], beyond_hu: float) -> NDArray[np.float32]:
    """Return the values ``shape`` = (rows, columns) of the scan in a cut, ``beyond_hu`` where there is no voxel.

    The picture's shorter side is as long as the cut's ``field_mm``; its pixels are square. Between two slices a value
    is interpolated along the way from a voxel to its like in the next slice.
    """
    across, across_down = _steps_mm(cut, shape, 1), _steps_mm(cut, shape, 0)[:, np.newaxis]
    values = np.empty(shape, dtype=np.float32)
    level = _level_axis(scan, cut)
    for first in range(0, shape[0], ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        places = _places(scan, cut, across, across_down[rows])
        if level is None:
            _interpolate(scan, places, beyond_hu, values[rows])
        else:
            _interpolate_level(scan, places, level, beyond_hu, values[rows])
    return values


def _level_axis(scan: SliceSampler, cut: Cut) -> int | None:
    """Return the index (0 slice, 1 row, 2 column) that is the same all over a cut; None for an oblique one."""
    slopes = np.abs(np.stack([scan.axes @ cut.right, scan.axes @ cut.down])).max(axis=0)
    if slopes[2] < LEAST_SLOPE:
        return 0
    upright = np.ptp(scan.origins_uv_mm, axis=0) < LEAST_SHIFT_MM
    if slopes[1] < LEAST_SLOPE and upright[1]:
        return 1
    return 2 if slopes[0] < LEAST_SLOPE and upright[0] else None


def _places(scan: SliceSampler, cut: Cut, across: FloatArray, across_down: FloatArray) -> FloatArray:
    """Return the indices (3, rows, columns) of pixels that lie ``across`` and ``across_down`` (mm) from the middle."""
    (u0, v0, w0), right, down = (scan.axes @ vector for vector in (cut.center_mm, cut.right, cut.down))
    # Where rows of the picture run along the slices, one number stands for a whole row.
    w = w0 + across_down * down[2] + (across * right[2] if abs(right[2]) > LEAST_SLOPE else 0.0)
    k = np.interp(w, scan.w_mm, np.arange(len(scan.w_mm)), left=-1.0, right=-1.0)
    origins_u, origins_v = (np.interp(w, scan.w_mm, origin) for origin in scan.origins_uv_mm.T)
    places = np.empty((3, len(across_down), len(across)))
    places[0] = k
    places[1] = (v0 - origins_v + across_down * down[1] + across * right[1]) / scan.steps_mm[1]
    places[2] = (u0 - origins_u + across_down * down[0] + across * right[0]) / scan.steps_mm[0]
    return places


def _interpolate(scan: SliceSampler, places: FloatArray, beyond_hu: float, values: NDArray[np.float32]) -> None:
    """Fill in ``values`` (rows, columns) at ``places`` (3, rows, columns)."""
    from scipy.ndimage import map_coordinates

    map_coordinates(scan.voxels, places, output=values, order=1, mode="constant", cval=beyond_hu)


def _interpolate_level(
    scan: SliceSampler, places: FloatArray, axis: int, beyond_hu: float, values: NDArray[np.float32]
) -> None:
    """The same where the index ``axis`` is that of the first pixel everywhere: several times as fast."""
    import cv2

    at, last = float(places[axis, 0, 0]), scan.voxels.shape[axis] - 1
    values[:] = beyond_hu
    if not 0.0 <= at <= last:
        return
    first = min(int(at), max(last - 1, 0))
    both = [slice(None)] * axis + [slice(first, first + 2)]
    pair = np.moveaxis(scan.voxels[tuple(both)], axis, 0).astype(np.float32)
    plane = pair[0] + np.float32(at - first) * (pair[-1] - pair[0])
    y, x = (places[n] for n in range(3) if n != axis)
    inside = (y >= 0.0) & (y <= plane.shape[0] - 1) & (x >= 0.0) & (x <= plane.shape[1] - 1)
    found = cv2.remap(plane, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    np.copyto(values, found, where=inside)


def _steps_mm(cut: Cut, shape: tuple[int, int], axis: int) -> FloatArray:
    """Return how far the pixels along one axis of the picture lie from its middle."""
    pixels = np.arange(shape[axis], dtype=np.float64) + 0.5 - shape[axis] / 2
    steps: FloatArray = pixels * (cut.field_mm / min(shape))
    return steps
