"""Copies of a slice, as in a folder that was filled twice: of each one is kept, and of those cut short none."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from typing import Final

import numpy as np

from ronnaplan.ct.files import Blob, DamagedError
from ronnaplan.ct.header import DEFLATED_LITTLE
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.ct.pixels import stored_values
from ronnaplan.ct.slices import Instance, SliceImage
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray

SAME_PLACE_TOLERANCE_MM: Final = 0.01
"""Slices nearer than this along the normal are at the same place (positions are often rounded to 0.01 mm)."""


CUT_COPY: Final = "the beginning of another, which was taken; it is a copy that was cut short, so delete it"
"""What is told of `without_cut_copies`."""

COMPARED_BYTES: Final = 1 << 20
"""Of two files so much is held at a time."""


def without_cut_copies(damaged: dict[str, list[Instance]], whole: Iterable[Instance]) -> list[Instance]:
    """Take out of ``damaged`` files (by what is wrong with them), and return, those that a ``whole`` one goes on from.

    Only that is a copy cut short: of two files that differ in a byte nobody knows which is right. It goes as far as its
    pixels, so that it is of the same place.
    """
    by_uid = {one.sop_uid: one for one in whole if one.sop_uid}
    cut: list[Instance] = []
    for reason in list(damaged):
        left: list[Instance] = []
        for one in damaged.pop(reason):
            other = by_uid.get(one.sop_uid)
            is_cut = other is not None and one.pixels is not None and _begins(other.blob, one.blob)
            (cut if is_cut else left).append(one)
        if left:
            damaged[reason] = left
    return cut


def _begins(whole: Blob, part: Blob) -> bool:
    """Whether a longer file begins with all that there is of ``part``."""
    if part.size >= whole.size:
        return False
    runs = ((at, min(COMPARED_BYTES, part.size - at)) for at in range(0, part.size, COMPARED_BYTES))
    try:
        return all(part.read(*run) == whole.read(*run) for run in runs)
    except DamagedError:
        return False


def without_copies(images: list[SliceImage], along: FloatArray) -> tuple[list[SliceImage], FloatArray, bool]:
    """Sort by position (``along`` (N,) the normal, mm) and drop copies (same place, same rescale, same stored values).

    Returns what is kept, its positions (K,), and whether anything was dropped. Images of one transfer syntax are
    compared by their bytes, so that none need be decoded; those of several by their values.
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
