"""Skin and skull as triangles for the 3-D view, coarse: for the eye, nothing is measured on them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray

SURFACES_HU = {"skin": -300.0, "skull": 300.0}

CELL_MM = 2.5
"""Size of the coarse cells that the surface is drawn through."""


def surface(volume: CTVolume, level_hu: float) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the vertices (V, 3) in LPS mm and the triangles (F, 3) of a level; empty where nothing reaches it."""
    return _isosurface(volume, volume.voxels_hu, level_hu)


def region(volume: CTVolume, mask: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the surface of a region (K, J, I) as `surface` does."""
    return _isosurface(volume, mask, 0.5)


def _isosurface(volume: CTVolume, values: NDArray[Any], level: float) -> tuple[FloatArray, NDArray[np.int64]]:
    from skimage.measure import marching_cubes

    gaps = volume.grid.spacings_mm
    sizes = (
        float(np.median(gaps)) if gaps.size else CELL_MM,
        volume.grid.row_spacing_mm,
        volume.grid.column_spacing_mm,
    )
    steps = [max(1, round(CELL_MM / size)) for size in sizes]
    coarse = _coarse(values, steps)
    if min(coarse.shape) < 2 or not coarse.min() < level < coarse.max():
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    vertices, triangles, _, _ = marching_cubes(coarse, level)
    half = (np.array([1, steps[1], steps[2]]) - 1) / 2
    places = volume.grid.positions_mm(vertices * steps + half)
    return places, triangles.astype(np.int64)


def _coarse(values: NDArray[Any], steps: list[int]) -> NDArray[np.float32]:
    """Every ``steps[0]``-th slice, each averaged over blocks of pixels."""
    import cv2

    planes = []
    for plane in values[:: steps[0]]:
        rows, columns = plane.shape[0] // steps[1], plane.shape[1] // steps[2]
        whole = plane[: rows * steps[1], : columns * steps[2]].astype(np.float32)
        planes.append(cv2.resize(np.maximum(whole, -1024.0), (columns, rows), interpolation=cv2.INTER_AREA))
    return np.asarray(planes, dtype=np.float32)
