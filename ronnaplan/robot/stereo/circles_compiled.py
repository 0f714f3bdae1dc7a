"""The compiled kernels of the circles: votes for centers, and the edges that support a radius about one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def halved(grey: NDArray[np.generic]) -> NDArray[np.float32]:
    """Return the image (rows, columns) at half its size: the means of four pixels each."""
    found = np.empty((grey.shape[0] // 2, grey.shape[1] // 2), np.float32)
    for row in range(found.shape[0]):
        for column in range(found.shape[1]):
            upper = np.float32(grey[2 * row, 2 * column]) + np.float32(grey[2 * row, 2 * column + 1])
            lower = np.float32(grey[2 * row + 1, 2 * column]) + np.float32(grey[2 * row + 1, 2 * column + 1])
            found[row, column] = np.float32(0.25) * (upper + lower)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def votes(
    places: FloatArray, gradients: FloatArray, radii: FloatArray, rows: int, columns: int, cell_px: float
) -> FloatArray:
    """Return how many edges at ``places`` (N, 2) have each cell (rows, columns) one of ``radii`` up their gradient."""
    found = np.zeros((rows, columns))
    for n in range(len(places)):
        strength = np.hypot(gradients[n, 0], gradients[n, 1])
        for radius in radii:
            x = (places[n, 0] + gradients[n, 0] / strength * radius) / cell_px
            y = (places[n, 1] + gradients[n, 1] / strength * radius) / cell_px
            if 0.0 < x < columns and 0.0 < y < rows:
                found[int(y), int(x)] += 1.0
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def supporters(
    center: FloatArray,
    places: FloatArray,
    gradients: FloatArray,
    radii: FloatArray,
    angles: int,
    askew: float,
    near: float,
    cell_px: float,
) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.int64], FloatArray]:
    """Return which edges (N, 2) with gradients (N, 2) face ``center`` (2,), and what they make of ``radii`` (R).

    An edge faces it when its gradient points past it by less than ``askew`` of the distance, or a cell; it supports a
    radius when it lies within ``near`` of it, or a cell. Returns the edges' numbers (E) and distances (E), how many
    support each radius (R), and the share of ``angles`` directions in which they do (R).
    """
    count = len(radii)
    numbers, distances = np.empty(len(places), np.int64), np.empty(len(places))
    supporting, directions = np.zeros(count, np.int64), np.zeros((count, angles), np.bool_)
    farthest = (1 + near) * radii[-1] + cell_px
    facing = 0
    for n in range(len(places)):
        x, y = center[0] - places[n, 0], center[1] - places[n, 1]
        across, down = gradients[n, 0], gradients[n, 1]
        distance = np.hypot(x, y)
        if x * across + y * down <= 0.0 or distance >= farthest:
            continue
        if abs(x * down - y * across) >= max(askew * distance, cell_px) * np.hypot(across, down):
            continue
        numbers[facing], distances[facing] = n, distance
        facing += 1
        sector = int((np.arctan2(y, x) / (2 * np.pi) + 0.5) * angles) % angles
        for k in range(count):
            if abs(distance - radii[k]) < max(near * radii[k], cell_px):
                supporting[k] += 1
                directions[k, sector] = True
    share = np.zeros(count)
    for k in range(count):
        share[k] = directions[k].sum() / angles
    return numbers[:facing], distances[:facing], supporting, share
