"""The noise of an image's pixels, told by what no light does from one pixel to the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.circles import Image, box_about

INSIDE = 0.75
"""What is of a ball, in its radii."""
FEWEST_PIXELS = 50
"""Fewer tell no noise, and so do those that are as bright as a pixel gets."""
LEAST_NOISE = 0.002
"""Of the brightest: less is that of rounding."""
SD_PER_MEAN = float(np.sqrt(np.pi / 2))
"""Standard deviation of normal noise, by the mean of its sizes."""


def noise_on(grey: Image, middle_px: FloatArray, radius_px: float, *, apart: int = 1) -> float:
    """Return the standard deviation of the noise of ``grey`` (rows, columns) on a ball; infinite where nothing tells.

    The ball is about ``middle_px`` (2,), column and row. Told by pixels so far ``apart``: compression makes noise alike
    from one to the next, but not to the one after.
    """
    reach = INSIDE * radius_px
    rows, columns = box_about(grey.shape, middle_px, reach)
    window = np.asarray(grey[rows, columns], dtype=np.float64)
    if min(window.shape) < 2 * apart + 1:
        return float("inf")
    across = np.arange(columns.start + apart, columns.stop - apart) - middle_px[0]
    down = np.arange(rows.start + apart, rows.stop - apart)[:, None] - middle_px[1]
    brightest = float(grey.max())
    told = (np.hypot(across, down) < reach) & ~_beside(window == brightest, apart)
    if told.sum() < FEWEST_PIXELS:
        return float("inf")
    return max(SD_PER_MEAN * float(roughness(window, apart)[told].mean()), LEAST_NOISE * brightest)


def roughness(values: FloatArray, apart: int = 1) -> FloatArray:
    """Return the size of the second differences of ``values`` (N, M) both ways, as large as their noise.

    They leave noise alone: no light bends so much from one pixel to the next. (N - 2 A, M - 2 A) of pixels ``apart``.
    """
    across = (values[:, 2 * apart :] - 2 * values[:, apart:-apart] + values[:, : -2 * apart]) / np.sqrt(6.0)
    down: FloatArray = (across[2 * apart :] - 2 * across[apart:-apart] + across[: -2 * apart]) / np.sqrt(6.0)
    return np.abs(down)


def _beside(marked: NDArray[np.bool_], apart: int) -> NDArray[np.bool_]:
    """Return which places but the outermost have one that is ``marked`` (N, M) among them and those ``apart``."""
    across = marked[:, 2 * apart :] | marked[:, apart:-apart] | marked[:, : -2 * apart]
    return across[2 * apart :] | across[apart:-apart] | across[: -2 * apart]
