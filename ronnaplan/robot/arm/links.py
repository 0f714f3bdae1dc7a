"""Where an arm's links are, and products of poses, as compiled loops take them."""

from __future__ import annotations

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def times(left: FloatArray, right: FloatArray, product: FloatArray) -> None:
    """Fill ``product`` (3, 3) with that of the upper left 3 x 3 of two matrices."""
    for a in range(3):
        for b in range(3):
            product[a, b] = left[a, 0] * right[0, b] + left[a, 1] * right[1, b] + left[a, 2] * right[2, b]


@njit(cache=True, nogil=True, error_model="numpy")
def invert_into(inverse: FloatArray, pose: FloatArray) -> None:
    """Fill the upper three rows of ``inverse`` with those of a pose's (4, 4)."""
    for a in range(3):
        inverse[a, 3] = 0.0
        for b in range(3):
            inverse[a, b] = pose[b, a]
            inverse[a, 3] -= pose[b, a] * pose[b, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def place_links(origins: FloatArray, axes: FloatArray, angles: FloatArray, frames: FloatArray) -> None:
    """Fill ``frames`` (N + 1, 4, 4), base from link; the first is given, ``origins`` (N, 4, 4), ``axes`` (N, 3)."""
    turn, placed = np.empty((3, 3)), np.empty((3, 3))
    for n in range(len(axes)):
        x, y, z = axes[n]
        c, s = np.cos(angles[n]), np.sin(angles[n])
        v = 1.0 - c
        turn[0, 0], turn[0, 1], turn[0, 2] = c + x * x * v, x * y * v - z * s, x * z * v + y * s
        turn[1, 0], turn[1, 1], turn[1, 2] = x * y * v + z * s, c + y * y * v, y * z * v - x * s
        turn[2, 0], turn[2, 1], turn[2, 2] = x * z * v - y * s, y * z * v + x * s, c + z * z * v
        before, after, origin = frames[n], frames[n + 1], origins[n]
        for a in range(3):
            after[a, 3] = before[a, 3]
            for b in range(3):
                after[a, 3] += before[a, b] * origin[b, 3]
            after[3, a] = 0.0
        after[3, 3] = 1.0
        times(before, origin, placed)
        times(placed, turn, after)
