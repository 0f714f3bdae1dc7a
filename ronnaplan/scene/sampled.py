"""What a scan holds in a flat cut, each voxel taken from where it is: tilt and uneven slices included."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.scene.cut import Cut

ROWS_AT_ONCE = 64
"""Of a picture: what is worked with needs six times the memory of the values."""

LEAST_SLOPE = 1e-9
"""A plane that rises less than this along its rows is level there."""


def values_hu(scan: SliceSampler, cut: Cut, shape: tuple[int, int], beyond_hu: float) -> NDArray[np.float32]:
    """Return the values ``shape`` = (rows, columns) of the scan in a cut, ``beyond_hu`` where there is no voxel.

    The picture's shorter side is as long as the cut's ``field_mm``; its pixels are square. Between two slices a value
    is interpolated along the way from a voxel to its like in the next slice.
    """
    across, across_down = _steps_mm(cut, shape, 1), _steps_mm(cut, shape, 0)[:, np.newaxis]
    values = np.empty(shape, dtype=np.float32)
    for first in range(0, shape[0], ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        _sample(scan, cut, across, across_down[rows], beyond_hu, values[rows])
    return values


def _sample(
    scan: SliceSampler,
    cut: Cut,
    across: FloatArray,
    across_down: FloatArray,
    beyond_hu: float,
    values: NDArray[np.float32],
) -> None:
    """Fill in ``values`` (rows, columns), whose pixels lie ``across`` and ``across_down`` (mm) from the middle."""
    from scipy.ndimage import map_coordinates

    (u0, v0, w0), right, down = (scan.axes @ vector for vector in (cut.center_mm, cut.right, cut.down))
    # Where rows of the picture run along the slices, one number stands for a whole row.
    w = w0 + across_down * down[2] + (across * right[2] if abs(right[2]) > LEAST_SLOPE else 0.0)
    k = np.interp(w, scan.w_mm, np.arange(len(scan.w_mm)), left=-1.0, right=-1.0)
    origins_u, origins_v = (np.interp(w, scan.w_mm, origin) for origin in scan.origins_uv_mm.T)
    places = np.empty((3, *values.shape))
    places[0] = k
    places[1] = (v0 - origins_v + across_down * down[1] + across * right[1]) / scan.steps_mm[1]
    places[2] = (u0 - origins_u + across_down * down[0] + across * right[0]) / scan.steps_mm[0]
    map_coordinates(scan.voxels, places, output=values, order=1, mode="constant", cval=beyond_hu)


def _steps_mm(cut: Cut, shape: tuple[int, int], axis: int) -> FloatArray:
    """Return how far the pixels along one axis of the picture lie from its middle."""
    pixels = np.arange(shape[axis], dtype=np.float64) + 0.5 - shape[axis] / 2
    steps: FloatArray = pixels * (cut.field_mm / min(shape))
    return steps
