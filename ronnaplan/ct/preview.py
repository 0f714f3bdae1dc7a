"""One image of a series, small, to be recognized by: for the eye only."""

from __future__ import annotations

import warnings
from contextlib import suppress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.catalogue import Series
from ronnaplan.ct.files import DamagedError
from ronnaplan.ct.frames import images_of
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.ct.pixels import read_slice
from ronnaplan.errors import InputError

SIDE: Final = 96
"""Pixels of the longer side."""

CT_WINDOW_HU: Final = (-450.0, 1550.0)
SHARES: Final = (1.0, 99.5)
"""What is no CT is shown from the value that so many percent are below to the other."""


def preview(series: Series) -> NDArray[np.uint8] | None:
    """Return the middle image (J, I) of a series in grey, None where it cannot be drawn."""
    import cv2

    with suppress(InputError, DamagedError, MemoryError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what decoders find odd in a stream that they can read
        images = series.stack.slices if series.stack is not None else images_of(series.first)
        image = images[len(images) // 2]
        values = np.empty((image.pixels.rows, image.pixels.columns), dtype=np.float32)
        read_slice(image, values, None, DEFAULT_LIMITS)
        low, high = CT_WINDOW_HU if series.is_usable else np.percentile(values, SHARES)
        grey = np.clip((values - low) * (255.0 / max(high - low, 1e-6)), 0.0, 255.0).astype(np.uint8)
        share = SIDE / max(grey.shape)
        size = (max(1, round(share * grey.shape[1])), max(1, round(share * grey.shape[0])))
        return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA))
    return None
