"""From the stored pixels of one slice to Hounsfield units, straight into its place in the volume."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import LARGEST_HU
from ronnaplan.ct import tags
from ronnaplan.ct.codecs import decode
from ronnaplan.ct.files import inflate
from ronnaplan.ct.flags import Voxels
from ronnaplan.ct.header import DEFLATED_LITTLE, deflated_part
from ronnaplan.ct.limits import Limits, are_hu
from ronnaplan.ct.slices import FLOAT_BYTES, PixelFormat, SliceImage, Stored
from ronnaplan.errors import InputError

INT16: Final = np.iinfo(np.int16)


class DoesNotFitError(Exception):
    """A rescaled value is beyond int16."""


def stored_range(pixels: PixelFormat) -> tuple[int, int]:
    """Return the lowest and highest integer that the pixels can store."""
    if pixels.is_signed:
        return -(1 << pixels.bits_stored - 1), (1 << pixels.bits_stored - 1) - 1
    return 0, (1 << pixels.bits_stored) - 1


def may_be_int16(image: SliceImage) -> bool:
    """Whether the rescaled values are whole numbers, so that int16 is worth trying."""
    whole = image.slope.is_integer() and image.intercept.is_integer()
    return (
        whole and image.pixels.tag not in FLOAT_BYTES and max(abs(image.slope), abs(image.intercept)) <= LARGEST_HU
    )


def read_slice(image: SliceImage, target: Voxels, padding_hu: float | None, limits: Limits) -> None:
    """Fill ``target`` (J, I) with the slice in HU; padding becomes ``padding_hu``.

    Raises `InputError` if the pixels are damaged and `DoesNotFitError` if ``target`` is int16 and too narrow.
    """
    if _is_plain_int16(image) and target.dtype == np.int16:
        _fill(image, target)
        stored: Stored = target
    else:
        stored = _stored(image, limits)
    padded = _padded(stored, image.pixels)
    if image.pixels.tag not in FLOAT_BYTES:
        stored = _significant_bits(stored, image.pixels)
    _rescale(stored, image, target, padded)
    if padded is not None and padding_hu is not None:
        target[padded] = padding_hu


def stored_values(image: SliceImage, limits: Limits) -> Stored:
    """Return the stored values (J, I) of a slice, as they are before any rescale; raises `InputError` for damage."""
    stored = _stored(image, limits)
    return stored if image.pixels.tag in FLOAT_BYTES else _significant_bits(stored, image.pixels)


def _is_plain_int16(image: SliceImage) -> bool:
    pixels = image.pixels
    is_ordinary = pixels.length is not None and pixels.tag == tags.PIXEL_DATA and pixels.bits_allocated == 16
    fits = pixels.is_signed or pixels.bits_stored < 16
    return is_ordinary and fits and not pixels.is_big_endian and pixels.transfer_syntax != DEFLATED_LITTLE


def _fill(image: SliceImage, target: Stored) -> None:
    view = target.view(np.uint8).data.cast("B")
    pixels = image.pixels
    offset = image.frame * pixels.frame_bytes
    if pixels.length is None or offset + pixels.frame_bytes > pixels.length:
        raise InputError(
            f"{image.name} declares {pixels.frame_bytes} bytes of pixels but holds fewer; copy it again"
        )
    if image.instance.blob.read_into(pixels.offset + offset, view) < len(view):
        raise InputError(f"{image.name} ends within its pixels; copy it again")


def _dtype(pixels: PixelFormat) -> np.dtype[np.generic]:
    kind = "f" if pixels.tag in FLOAT_BYTES else "i" if pixels.is_signed else "u"
    return np.dtype(f"{'>' if pixels.is_big_endian else '<'}{kind}{pixels.item_bytes}")


def _stored(image: SliceImage, limits: Limits) -> Stored:
    """Return the stored values (J, I) of a slice in their own type."""
    pixels = image.pixels
    if pixels.length is None:
        return decode(image)
    stored = np.empty((pixels.rows, pixels.columns), _dtype(pixels))
    if pixels.transfer_syntax != DEFLATED_LITTLE:
        _fill(image, stored)
        return stored
    start = pixels.offset + image.frame * pixels.frame_bytes
    content = inflate(deflated_part(image.instance.blob, limits), start + pixels.frame_bytes)
    if len(content) < start + pixels.frame_bytes:
        raise InputError(f"{image.name} ends within its pixels; copy it again")
    return np.frombuffer(content, stored.dtype, count=stored.size, offset=start).reshape(stored.shape)


def _padded(stored: Stored, pixels: PixelFormat) -> NDArray[np.bool_] | None:
    if pixels.padding is None:
        return None
    low, high = pixels.padding
    if stored.dtype == np.int16 and not pixels.is_signed:
        stored = stored.view(np.uint16)
    padded: NDArray[np.bool_] = (stored == low) if low == high else (stored >= low) & (stored <= high)
    return padded if padded.any() else None


def _significant_bits(stored: Stored, pixels: PixelFormat) -> Stored:
    """Clear what some scanners keep above the stored bits (overlays), extending the sign."""
    low, high = stored_range(pixels)
    unused = 8 * stored.dtype.itemsize - pixels.bits_stored
    if unused == 0:
        return stored
    if low <= int(stored.min()) and int(stored.max()) <= high:
        return stored
    if pixels.is_signed:
        return (stored << unused) >> unused
    return stored & high


def has_bits_above(pixels: PixelFormat) -> bool:
    """Whether there are bits above those stored, of values that the header calls signed."""
    return pixels.is_signed and pixels.tag not in FLOAT_BYTES and pixels.bits_stored < 8 * pixels.item_bytes


def may_be_unsigned(image: SliceImage, limits: Limits) -> bool:
    """Whether a slice that `has_bits_above` stores its values as unsigned ones lie.

    Then none of these bits is set, though some values are negative: by the standard they may be anything, but a
    scanner sets them to the sign.
    """
    stored, (_, high) = _stored(image, limits), stored_range(image.pixels)
    return int(stored.min()) >= 0 and high < int(stored.max()) <= 2 * high + 1


def _rescale(stored: Stored, image: SliceImage, target: Voxels, padded: NDArray[np.bool_] | None) -> None:
    slope, intercept = image.slope, image.intercept
    if target.dtype != np.int16:
        with np.errstate(over="ignore", invalid="ignore"):
            target[...] = stored.astype(np.float64) * slope + intercept
        if not are_hu(target if padded is None else target[~padded]):
            raise InputError(
                f"{image.name} holds values that are not finite numbers up to {LARGEST_HU:g} HU; convert it again"
            )
        return
    seen = stored if padded is None else stored[~padded]
    for bound, end in zip(stored_range(image.pixels), (np.min, np.max), strict=True):
        # What a scanner's 12 bits or an intercept below zero cannot bring beyond int16 is not looked at.
        may_exceed = seen.size > 0 and not in_int16(bound * slope + intercept)
        if may_exceed and not in_int16(int(end(seen)) * slope + intercept):
            raise DoesNotFitError
    np.copyto(target, stored, casting="unsafe")
    if slope != 1.0:
        target *= _modulo_int16(slope)
    if intercept != 0.0:
        target += _modulo_int16(intercept)


def in_int16(value: float) -> bool:
    """Return whether ``value`` lies between the ends of an int16."""
    return bool(INT16.min <= value <= INT16.max)


def _modulo_int16(value: float) -> np.int16:
    """Return ``value`` modulo 2^16: sums and products stay exact, since the result is known to fit."""
    return np.int16((int(value) + (1 << 15)) % (1 << 16) - (1 << 15))
