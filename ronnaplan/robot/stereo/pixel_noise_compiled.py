"""The compiled kernel of the noise on a ball and beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def roughness_about(
    window: FloatArray,
    middle: FloatArray,
    radius: float,
    inside: float,
    beside: tuple[float, float],
    sectors: int,
    brightest: float,
) -> tuple[tuple[float, int, int], FloatArray, NDArray[np.int64]]:
    """Return the sums of `pixel_noise.roughness` on a ball and in each sector (S) beside it, and of how many pixels.

    The ball has this ``radius`` (px) about ``middle`` (2,), column and row, of the ``window`` (rows, columns). Taken
    are its pixels up to ``inside``, and beside it those between ``beside``, in its radii; of the ball's also how many
    are as bright as the ``brightest``. ``sectors`` is a multiple of four.
    """
    sums, counts = np.zeros(sectors), np.zeros(sectors, np.int64)
    quarter, on_ball, pixels, bright = sectors // 4, 0.0, 0, 0
    slopes = np.tan(2.0 * np.pi / sectors * np.arange(1, quarter))
    squares = (inside * radius) ** 2, (beside[0] * radius) ** 2, (beside[1] * radius) ** 2
    for row in range(1, window.shape[0] - 1):
        y = row - middle[1]
        for column in range(1, window.shape[1] - 1):
            x = column - middle[0]
            away = x * x + y * y
            if away >= squares[2] or squares[0] <= away <= squares[1]:
                continue
            bent = 4.0 * window[row, column]
            for side in (-1, 1):
                bent -= 2.0 * (window[row + side, column] + window[row, column + side])
                bent += window[row + side, column - 1] + window[row + side, column + 1]
            if away < squares[0]:
                on_ball, pixels = on_ball + abs(bent) / 6.0, pixels + 1
                bright += window[row, column] == brightest
                continue
            sector = quarter * (2 * (y > 0.0) + (x > 0.0))
            for slope in slopes:
                sector += abs(y) > slope * abs(x)
            sums[sector] += abs(bent) / 6.0
            counts[sector] += 1
    return (on_ball, pixels, bright), sums, counts
