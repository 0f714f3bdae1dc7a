"""Copies of a slice, as in a folder that was filled twice: of each one is kept."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from typing import Final

import numpy as np

from ronnaplan.ct.header import DEFLATED_LITTLE
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.ct.pixels import stored_values
from ronnaplan.ct.slices import SliceImage
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray

SAME_PLACE_TOLERANCE_MM: Final = 0.01
"""Slices nearer than this along the normal are at the same place (positions are often rounded to 0.01 mm)."""


def without_copies(images: list[SliceImage], along: FloatArray) -> tuple[list[SliceImage], FloatArray, bool]:
    """Sort by position (``along`` the normal, mm) and drop copies (same place, same rescale, same stored values).

    Returns what is kept, its positions, and whether anything was dropped. Images of one transfer syntax are compared
    by their bytes, so that none need be decoded; those of several by their values.
    """
    order = np.argsort(along, kind="stable")
    starts = np.flatnonzero(np.diff(along[order]) > SAME_PLACE_TOLERANCE_MM) + 1
    kept: list[int] = []
    for group in np.split(order, starts):
        if len(group) == 1:
            kept.append(int(group[0]))
        else:
            by_values = len({images[index].pixels.transfer_syntax for index in group}) > 1
            unlike: dict[tuple[object, ...], int] = {}
            for index in group:
                unlike.setdefault(_fingerprint(images[index], by_values), int(index))
            kept.extend(unlike.values())
    return [images[index] for index in kept], along[kept], len(kept) < len(images)


def _fingerprint(image: SliceImage, by_values: bool) -> tuple[object, ...]:
    """Return what two images must share to be the same one twice."""
    place = tuple(round(value, 3) for value in image.origin_mm)
    if by_values:
        with suppress(InputError):  # one that cannot be read is no copy of another
            values = stored_values(image, DEFAULT_LIMITS).astype("<f8")
            return place, image.slope, image.intercept, hashlib.sha256(values.tobytes()).digest()
    return place, image.slope, image.intercept, *_written(image)


def _written(image: SliceImage) -> tuple[object, ...]:
    """Return which frame of which bytes holds an image."""
    pixels, blob = image.pixels, image.instance.blob
    start, count, frame = pixels.offset, pixels.length, 0
    if pixels.transfer_syntax == DEFLATED_LITTLE:
        start, count, frame = 0, blob.size, image.frame
    elif count is None:
        count, frame = blob.size - start, image.frame
    elif pixels.frames > 1:
        start, count = start + image.frame * pixels.frame_bytes, pixels.frame_bytes
    return frame, hashlib.sha256(blob.read(start, count)).digest()
