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

Places = tuple[FloatArray, FloatArray, FloatArray]
"""Indices of slice, row and column, each for all rows and columns of a picture by numpy's rules."""


def values_hu(scan: SliceSampler, cut: Cut, shape: tuple[int, int], beyond_hu: float) -> NDArray[np.float32]:
    """Return the values ``shape`` = (rows, columns) of the scan in a cut, ``beyond_hu`` where there is no voxel.

    The picture's shorter side is as long as the cut's ``field_mm``; its pixels are square. Between two slices a value
    is interpolated along the way from a voxel to its like in the next slice.
    """
    across, across_down = _steps_mm(cut, shape, 1), _steps_mm(cut, shape, 0)[:, np.newaxis]
    values = np.empty(shape, dtype=np.float32)
    level = _level_axis(scan, cut)
    plane = None if level is None else _plane(scan, level, _places(scan, cut, across[:1], across_down[:1])[level])
    for first in range(0, shape[0], ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        places = _places(scan, cut, across, across_down[rows])
        if level is None:
            _interpolate(scan, places, beyond_hu, values[rows])
        elif plane is None:
            values[rows] = beyond_hu
        else:
            _interpolate_level(plane, places[:level] + places[level + 1 :], beyond_hu, values[rows])
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


def _places(scan: SliceSampler, cut: Cut, across: FloatArray, across_down: FloatArray) -> Places:
    """Return the indices of pixels that lie ``across`` (columns,) and ``across_down`` (rows, 1) (mm) from the middle.

    Where rows or columns of the picture run along the scan's, one number stands for a whole row or column.
    """
    (u0, v0, w0), right, down = (scan.axes @ vector for vector in (cut.center_mm, cut.right, cut.down))

    def moved(start: FloatArray, axis: int) -> FloatArray:
        for steps, slope in ((across_down, down[axis]), (across, right[axis])):
            start = start + steps * slope if abs(slope) > LEAST_SLOPE else start
        return start

    w = np.atleast_2d(moved(w0, 2))
    k = np.interp(w, scan.w_mm, np.arange(len(scan.w_mm)), left=-1.0, right=-1.0)
    origins_u, origins_v = (np.interp(w, scan.w_mm, origin) for origin in scan.origins_uv_mm.T)
    return k, moved(v0 - origins_v, 1) / scan.steps_mm[1], moved(u0 - origins_u, 0) / scan.steps_mm[0]


def _interpolate(scan: SliceSampler, places: Places, beyond_hu: float, values: NDArray[np.float32]) -> None:
    """Fill in ``values`` (rows, columns) at ``places``."""
    from scipy.ndimage import map_coordinates

    whole = np.stack([np.broadcast_to(one, values.shape) for one in places])
    map_coordinates(scan.voxels, whole, output=values, order=1, mode="constant", cval=beyond_hu)


def _plane(scan: SliceSampler, axis: int, place: FloatArray) -> NDArray[np.float32] | None:
    """Return the scan's values where the index ``axis`` is that of a ``place`` (1, 1); None where it has none."""
    at, last = place.item(), scan.voxels.shape[axis] - 1
    if not 0.0 <= at <= last:
        return None
    first = min(int(at), max(last - 1, 0))
    both = [slice(None)] * axis + [slice(first, first + 2)]
    pair = np.moveaxis(scan.voxels[tuple(both)], axis, 0).astype(np.float32)
    plane: NDArray[np.float32] = pair[-1] - pair[0]
    plane *= np.float32(at - first)
    plane += pair[0]
    return plane


def _interpolate_level(
    plane: NDArray[np.float32], places: tuple[FloatArray, ...], beyond_hu: float, values: NDArray[np.float32]
) -> None:
    """Fill in ``values`` (rows, columns) at ``places`` in a plane of the scan's: several times as fast."""
    import cv2

    y, x = places
    inside = (y >= 0.0) & (y <= plane.shape[0] - 1) & (x >= 0.0) & (x <= plane.shape[1] - 1)
    maps = [np.ascontiguousarray(np.broadcast_to(one.astype(np.float32), values.shape)) for one in (x, y)]
    values[:] = cv2.remap(plane, maps[0], maps[1], cv2.INTER_LINEAR)
    np.copyto(values, np.float32(beyond_hu), where=~inside)


def _steps_mm(cut: Cut, shape: tuple[int, int], axis: int) -> FloatArray:
    """Return how far the pixels along one axis of the picture lie from its middle."""
    pixels = np.arange(shape[axis], dtype=np.float64) + 0.5 - shape[axis] / 2
    steps: FloatArray = pixels * (cut.field_mm / min(shape))
    return steps
