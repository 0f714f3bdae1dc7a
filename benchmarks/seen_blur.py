"""How blurred and how noisy a scan is, measured off the scan itself."""

from __future__ import annotations

import numpy as np
from scipy import ndimage, optimize, special

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray

BODY_HU = -400.0
"""What is brighter belongs to what is scanned."""

EDGE_REACH_MM = 4.0
SHARPEST_SHARE = 0.2
"""The kernel's blur is that of so many of the edges, the sharpest ones: the others are oblique to the slices."""

MOST_EDGES = 400
FLAT_PIXELS = 9
FLATTEST_SHARE = 0.05
"""Noise is that of so many of the places within tissue, the flattest ones: the others hold structures."""


def edge_blur_mm(volume: CTVolume) -> float:
    """Standard deviation of the in-plane blur, from the edges to air of what is scanned."""
    pixel_mm = volume.grid.row_spacing_mm
    along = np.arange(-EDGE_REACH_MM, EDGE_REACH_MM, pixel_mm / 2)
    generator = np.random.default_rng(0)
    widths: list[float] = []
    for picture in volume.voxels_hu[:: max(1, len(volume.voxels_hu) // 12)]:
        image = np.maximum(picture.astype(np.float64), -1000.0)
        smooth = ndimage.gaussian_filter(image, 1.5)
        slope = np.asarray(np.gradient(smooth))
        length = np.linalg.norm(slope, axis=0)
        edge = np.argwhere((np.abs(smooth - BODY_HU) < 60) & (length * 1.5 > 120))
        for row, column in generator.permutation(edge)[: MOST_EDGES // 12]:
            way = slope[:, row, column] / length[row, column] / pixel_mm
            places = np.array([[row], [column]]) + way[:, np.newaxis] * along
            width = _edge_width(along, ndimage.map_coordinates(image, places, order=3, mode="nearest"))
            widths += [width] if width is not None else []
    return float(np.quantile(widths, SHARPEST_SHARE / 2)) if widths else 0.6


def _edge_width(along_mm: FloatArray, profile_hu: FloatArray) -> float | None:
    """Width of a blurred step from air; None for what is no such step."""

    def misses(fitted: FloatArray) -> FloatArray:
        middle, width, low, high = fitted
        return np.asarray(low + (high - low) * special.ndtr((along_mm - middle) / width) - profile_hu)

    fitted = optimize.least_squares(misses, (0.0, 0.6, -1000.0, 0.0), max_nfev=100).x
    misfit = float(np.sqrt(np.mean(misses(fitted) ** 2)))
    height = fitted[3] - fitted[2]
    is_step = height > 600 and misfit < 0.03 * height and abs(fitted[0]) < 2 and 0.15 < fitted[1] < 3
    return float(fitted[1]) if is_step else None


def tissue_noise_hu(volume: CTVolume) -> float:
    """Standard deviation of the noise where what is scanned is flat, so wide as `FLAT_PIXELS`."""
    levels: list[float] = []
    for picture in volume.voxels_hu[:: max(1, len(volume.voxels_hu) // 12)]:
        image = picture.astype(np.float64)
        mean = ndimage.uniform_filter(image, FLAT_PIXELS)
        variance = np.maximum(ndimage.uniform_filter(image**2, FLAT_PIXELS) - mean**2, 0.0)
        inside = (mean > -150) & (mean < 250)
        if inside.any():
            levels.append(float(np.quantile(np.sqrt(variance[inside]), FLATTEST_SHARE)))
    return float(np.median(levels)) if levels else 10.0
