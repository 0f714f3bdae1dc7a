"""From detected signal to Hounsfield units: water correction, filtering, back-projection."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from phantoms.beam import Beam
from phantoms.compiled import compiled, parallel_range
from phantoms.kernels import Kernel
from phantoms.solids import FloatArray

UPSAMPLING = 2
"""Filtered projections are refined by this factor (band-limited), so that linear interpolation blurs little."""


class WaterCorrection:
    """Turns attenuation measured with a polychromatic ``beam`` into mm of water (beam-hardening correction)."""

    LONGEST_MM = 3000.0

    def __init__(self, beam: Beam) -> None:
        attenuation = beam.attenuation_per_mm(("water",))[0]
        lengths = np.concatenate([np.linspace(0, 500, 2001), np.linspace(505, self.LONGEST_MM, 500)])
        arriving = np.exp(-lengths[:, np.newaxis] * attenuation) @ beam.weights
        self._lengths = lengths
        self._depths = -np.log(arriving)

    def __call__(self, depth: FloatArray) -> FloatArray:
        """Map ``-log(I / I0)`` to mm of water; negative values (noise in air) are continued linearly."""
        slope = self._lengths[1] / self._depths[1]
        length = np.interp(depth, self._depths, self._lengths)
        water_mm: FloatArray = np.where(depth < 0, depth * slope, length)
        return water_mm


def ramp_response(size: int, bin_mm: float, shape: Kernel) -> FloatArray:
    """Return what ramp and kernel do to each frequency of ``size`` bins, as a real transform orders them.

    The ramp is the transform of its band-limited spatial form, which leaves no offset (Kak & Slaney, Eq. 3.61).
    """
    offset = np.minimum(np.arange(size), size - np.arange(size))
    ramp = np.zeros(size)
    ramp[0] = 1 / (4 * bin_mm**2)
    odd = offset % 2 == 1
    ramp[odd] = -1 / (np.pi * offset[odd] * bin_mm) ** 2
    response: FloatArray = fft.rfft(ramp).real * bin_mm * shape.response(fft.rfftfreq(size, bin_mm))
    return response


def filter_projections(
    projections: NDArray[np.floating[Any]], bin_mm: float, shape: Kernel
) -> NDArray[np.float32]:
    """Filter ``projections`` (V, U) with ramp and kernel; returns (V, `UPSAMPLING` U) at ``bin_mm / UPSAMPLING``."""
    views, bins = projections.shape
    size = fft.next_fast_len(2 * bins, real=True)
    response = ramp_response(size, bin_mm, shape)
    spectrum = fft.rfft(projections.astype(np.float32), n=size, axis=1) * response.astype(np.float32)
    refined = fft.irfft(spectrum, n=size * UPSAMPLING, axis=1) * UPSAMPLING
    return np.ascontiguousarray(refined[:, : bins * UPSAMPLING] * (np.pi / views), dtype=np.float32)


@compiled(parallel=True)
def back_project(
    filtered: NDArray[np.float32],
    angles: FloatArray,
    first_mm: float,
    step_mm: float,
    aside_mm: tuple[float, float],
    pixel_mm: float,
    image: NDArray[np.float32],
) -> None:
    """Add the views (V, U) to ``image`` (rows, columns), whose center lies ``aside_mm`` (x, y) of the axis.

    The samples of a view lie at ``first + n step``.
    """
    rows, columns = image.shape
    views, bins = filtered.shape
    scale = pixel_mm / step_mm
    for row in parallel_range(rows):
        y = (row - (rows - 1) / 2) * scale + aside_mm[1] / step_mm
        x = aside_mm[0] / step_mm - (columns - 1) / 2 * scale
        line = np.zeros(columns, np.float32)
        for view in range(views):
            cosine = np.cos(angles[view])
            start = y * np.sin(angles[view]) + x * cosine - first_mm / step_mm
            step = np.float32(scale * cosine)
            values = filtered[view]
            place = np.float32(start)
            for column in range(columns):
                t = place + np.float32(column) * step
                t = min(max(t, np.float32(0)), np.float32(bins - 2))
                n = int(t)
                fraction = t - np.float32(n)
                line[column] += values[n] + fraction * (values[n + 1] - values[n])
        for column in range(columns):
            image[row, column] += line[column]
