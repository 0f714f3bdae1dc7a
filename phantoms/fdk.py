"""Reconstruction from cone-beam projections on a flat panel (Feldkamp, Davis & Kress, J Opt Soc Am A 1:612, 1984)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from phantoms.compiled import compiled, parallel_range
from phantoms.kernels import Kernel
from phantoms.reconstruction import UPSAMPLING, ramp_response
from phantoms.solids import FloatArray

TAPER = 0.25
"""Part of the detector's width by which truncated rows are continued, falling to zero, on either side."""
FFT_WORKERS = 2


class Grid(NamedTuple):
    """A box of voxels in the scanner's axes (column, row, normal), in mm from the isocenter."""

    first_mm: FloatArray
    """(K, 3) middle of the first voxel of each slice"""
    pixel_mm: float


def parker_weights(angles: FloatArray, fan: FloatArray, widest: float) -> FloatArray:
    """Return the weight (V, U) of each ray of a short scan; a ray and its opposite sum to one.

    ``angles`` (V,) go from 0 to pi + 2 ``widest``; ``fan`` (U,) are the rays' angles to the central one, of which
    the opposite ray is taken at ``angle + pi - 2 fan`` (Parker, Med Phys 9:254, 1982). Radians.
    """
    beta, gamma = angles[:, np.newaxis], -fan[np.newaxis, :]
    rise = np.sin(np.pi / 4 * beta / np.maximum(widest - gamma, 1e-9)) ** 2
    fall = np.sin(np.pi / 4 * (np.pi + 2 * widest - beta) / np.maximum(widest + gamma, 1e-9)) ** 2
    weights = np.where(beta < 2 * (widest - gamma), rise, np.where(beta > np.pi - 2 * gamma, fall, 1.0))
    result: FloatArray = np.where(beta > np.pi + 2 * widest, 0.0, weights)
    return result


class RampFilter:
    """Filters detector rows of ``columns`` elements with ramp and kernel, and refines them by `UPSAMPLING`."""

    def __init__(self, columns: int, bin_mm: float, shape: Kernel) -> None:
        self.columns, self.pad = columns, int(np.ceil(TAPER * columns))
        padded = columns + 2 * self.pad
        size = fft.next_fast_len(2 * padded, real=True)
        response = ramp_response(size, bin_mm, shape)
        self._size, self._response = size, (response * UPSAMPLING).astype(np.float32)
        fall = np.cos(np.pi / 2 * (np.arange(self.pad) + 1) / (self.pad + 1)) ** 2
        self._fall = fall.astype(np.float32)

    def __call__(self, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (..., `UPSAMPLING` U) from (..., U)."""
        left, right = rows[..., :1] * self._fall[::-1], rows[..., -1:] * self._fall
        padded = np.concatenate([left, rows, right], axis=-1)
        spectrum = fft.rfft(padded, n=self._size, axis=-1, workers=FFT_WORKERS)
        spectrum *= self._response
        refined = fft.irfft(spectrum, n=self._size * UPSAMPLING, axis=-1, workers=FFT_WORKERS)
        inner = slice(self.pad * UPSAMPLING, (self.pad + self.columns) * UPSAMPLING)
        return np.ascontiguousarray(refined[..., inner], dtype=np.float32)


@compiled(parallel=True)
def back_project_cone(
    filtered: NDArray[np.float32],
    angles: FloatArray,
    source_mm: float,
    first_mm: tuple[float, float],
    step_mm: tuple[float, float],
    grid: Grid,
    images: NDArray[np.float32],
) -> None:
    """Add the views (V, rows, columns) to ``images`` (K, rows, columns).

    Samples of a view lie at ``first + n step`` (columns, rows), in the plane through the axis of rotation.
    """
    count, rows, columns = images.shape
    views, bin_rows, bins = filtered.shape
    for job in parallel_range(count * rows):
        k, row = job // rows, job % rows
        x0, z = grid.first_mm[k, 0], grid.first_mm[k, 2]
        y = grid.first_mm[k, 1] + row * grid.pixel_mm
        line = np.zeros(columns, np.float32)
        for view in range(views):
            cosine, sine = np.cos(angles[view]), np.sin(angles[view])
            values = filtered[view]
            for column in range(columns):
                x = x0 + column * grid.pixel_mm
                scale = source_mm / (source_mm - x * cosine - y * sine)
                u = ((y * cosine - x * sine) * scale - first_mm[0]) / step_mm[0]
                v = (z * scale - first_mm[1]) / step_mm[1]
                u = min(max(u, 0.0), bins - 1.001)
                v = min(max(v, 0.0), bin_rows - 1.001)
                i, j = int(u), int(v)
                a, b = np.float32(u - i), np.float32(v - j)
                low = values[j, i] + a * (values[j, i + 1] - values[j, i])
                high = values[j + 1, i] + a * (values[j + 1, i + 1] - values[j + 1, i])
                line[column] += np.float32(scale * scale) * (low + b * (high - low))
        for column in range(columns):
            images[k, row, column] += line[column]
