"""The compiled inner loop of lossless JPEG; imported when the first such image is read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit

CORRUPT = np.int64(-1)


@njit(cache=True, nogil=True)
def decode_segment(
    data: NDArray[np.uint8],
    lookup: NDArray[np.uint16],
    pixels: NDArray[np.uint16],
    columns: int,
    predictor: int,
    first: int,
) -> np.int64:
    """Decode one restart interval, ``data`` (B,), into ``pixels`` (N,); return the bytes used, or `CORRUPT`.

    ``lookup`` (65536,) gives code length << 8 | category for each 16-bit pattern, ``first`` predicts the first pixel.
    """
    bits, held, position = np.int64(0), np.int64(0), 0
    for index in range(pixels.size):
        while held <= 32:
            following = np.int64(data[position]) if position < data.size else 0
            bits = ((bits << 8) | following) & 0xFFFFFFFFFF
            position += 1
            held += 8
        entry = np.int64(lookup[(bits >> (held - 16)) & 0xFFFF])
        if entry == 0:
            return CORRUPT
        held -= entry >> 8
        category = entry & 0xFF
        difference = np.int64(32768)
        if category < 16:
            difference = (bits >> (held - category)) & ((1 << category) - 1)
            held -= category
            if category > 0 and difference < 1 << (category - 1):
                difference -= (1 << category) - 1
        pixels[index] = (_predicted(pixels, index, columns, predictor, first) + difference) & 0xFFFF
    used = position - held // 8
    return np.int64(used) if used <= data.size else CORRUPT


@njit(cache=True, nogil=True)
def _predicted(pixels: NDArray[np.uint16], index: int, columns: int, predictor: int, first: int) -> np.int64:
    """Return the prediction of a pixel from its neighbours (T.81, table H.1 and section H.1.2.1)."""
    if index == 0:
        return np.int64(first)
    if index < columns:
        return np.int64(pixels[index - 1])
    above = np.int64(pixels[index - columns])
    if index % columns == 0 or predictor == 2:
        return above
    left, corner = np.int64(pixels[index - 1]), np.int64(pixels[index - columns - 1])
    if predictor == 1:
        return left
    if predictor == 3:
        return corner
    if predictor == 4:
        return left + above - corner
    if predictor == 5:
        return left + ((above - corner) >> 1)
    if predictor == 6:
        return above + ((left - corner) >> 1)
    return (left + above) >> 1
