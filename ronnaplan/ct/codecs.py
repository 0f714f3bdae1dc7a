"""Decoding of compressed pixels: lossless JPEG here, all else by pydicom's decoders."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from threading import Lock
from typing import Any, Final, NamedTuple

import numpy as np

from ronnaplan.ct.jpeg_lossless import decode_jpeg_lossless
from ronnaplan.ct.slices import PixelFormat, SliceImage, Stored
from ronnaplan.ct.uids import JPEG_EXTENDED, JPEG_LOSSLESS, JPEG_LS, PLUGINS, RLE
from ronnaplan.errors import InputError
from ronnaplan.text import printable

_JPEG_12_BITS: Final = "JPEG extended, 12 bits, which pylibjpeg-libjpeg decodes"
_JPEG_2000_START: Final = b"\xff\x4f\xff\x51"
_JP2_SIGNATURE: Final = b"jP  \r\n\x87\n"
_EXTENT_AT, _SAMPLES_AT = 8, 40
"""Where a JPEG 2000 stream tells the ends of its image, and how many samples a pixel has of which depth (ISO 15444-1,
A.5.1)."""
_BITS_AT: Final = 4
"""Where a JPEG tells its bits and its size, from the marker of its frame on (ITU-T T.81, B.2.2): behind a length."""
_END_OF_IMAGE: Final = b"\xff\xd9"
_MOST_PADDING: Final = 8
"""Zero bytes that an encoder may leave of its buffer."""
_LONGEST_START: Final = 1 << 12
"""Bytes within which a stream says how it was compressed."""
_JPEG_2000_STYLE: Final = re.compile(rb"\xff\x52.{11}(.)", re.DOTALL)
"""The coding style of JPEG 2000 (ISO 15444-1, A.6.1); its last byte names the wavelet, 0 the irreversible one."""
_SCAN: Final = re.compile(rb"\xff\xda\x00\x08\x01.{2}(.).(.)", re.DOTALL)
"""The start of scan of one component: how far values of JPEG-LS may be off (ITU-T T.87, C.2.3), and in the lower half
of its last byte how many bits lossless JPEG left out (the point transform; ITU-T T.81, B.2.3)."""
_START_OF_FRAME: Final = frozenset({*range(0xC0, 0xD0), 0xF7} - {0xC4, 0xC8, 0xCC})
PACKAGES: Final = {
    "1.2.840.10008.1.2.4.92": "JPEG 2000 multi-component, for which no maintained decoder is known",
    "1.2.840.10008.1.2.4.93": "JPEG 2000 multi-component, for which no maintained decoder is known",
    "1.2.840.10008.1.2.4.110": "JPEG XL lossless, which imagecodecs decodes",
    "1.2.840.10008.1.2.4.111": "JPEG XL recompression, which imagecodecs decodes",
    "1.2.840.10008.1.2.4.112": "JPEG XL, which imagecodecs decodes",
    "1.2.840.10008.1.2.4.100": "MPEG-2 video, which ffmpeg decodes",
    "1.2.840.10008.1.2.4.102": "MPEG-4 video, which ffmpeg decodes",
}
"""Transfer syntaxes that are not read -> what they are and what would decode them."""


class Codestream(NamedTuple):
    """What a compressed image declares of itself."""

    rows: int
    columns: int
    samples: int
    bits: int
    is_signed: bool


_IMPORTING: Final = Lock()
"""pydicom's modules import each other in circles: two threads that begin at different ones fail."""


def why_not_decoded(pixels: PixelFormat) -> str | None:
    """Return why compressed pixels cannot be read, naming their transfer syntax, or None if they can."""
    transfer_syntax = pixels.transfer_syntax
    if transfer_syntax == JPEG_EXTENDED and pixels.bits_stored > 8:
        return f"its transfer syntax {JPEG_EXTENDED} ({_JPEG_12_BITS}) is not supported; export it uncompressed"
    if transfer_syntax in PLUGINS or transfer_syntax in JPEG_LOSSLESS:
        return None
    known = PACKAGES.get(transfer_syntax)
    named = f"{transfer_syntax} ({known})" if known else f"{transfer_syntax} (unknown; gdcmconv may know it)"
    return f"its transfer syntax {named} is not supported; export it uncompressed"


def tells_loss(image: SliceImage) -> bool:
    """Whether a compressed image says that it lost something, whatever its transfer syntax says."""
    if not image.fragments:
        return False
    offset, length = image.fragments[0]
    start = image.instance.blob.read(offset, min(length, _LONGEST_START))
    if image.pixels.transfer_syntax in JPEG_LS | JPEG_LOSSLESS:
        scan = _SCAN.search(start)
        is_near = image.pixels.transfer_syntax in JPEG_LS
        return scan is not None and (scan[1] != b"\0" if is_near else scan[2][0] % 16 > 0)
    at = _codestream_start(start)
    style = _JPEG_2000_STYLE.search(start, at) if start.startswith(_JPEG_2000_START, at) else None
    return style is not None and style[1] == b"\0"


def decode(image: SliceImage) -> Stored:
    """Return the stored values (J, I) of one compressed image; raises `InputError` if it cannot be decoded."""
    blob = image.instance.blob
    frame = b"".join([blob.read(offset, length) for offset, length in image.fragments])
    try:
        return decode_frame(frame, image.pixels)
    except InputError as error:
        raise InputError(f"{image.name} cannot be decoded: {error}") from error


def decode_frame(frame: bytes, pixels: PixelFormat) -> Stored:
    """Decode one compressed frame to (J, I), or (J, I, samples); raises `InputError`."""
    declared = codestream(frame)
    expected = (pixels.rows, pixels.columns, pixels.samples)
    if declared is None:
        if pixels.transfer_syntax != RLE:
            raise InputError("its compressed image does not declare its size; copy it again")
        return _decoded(frame, pixels)
    if declared[:3] != expected:
        raise InputError(
            f"its compressed image has rows, columns and samples {declared[:3]}, its header {expected}; "
            "export it uncompressed"
        )
    if declared.bits > pixels.bits_allocated:
        raise InputError(
            f"its compressed image has values of {declared.bits} bits, its header has room for "
            f"{pixels.bits_allocated}; export it uncompressed"
        )
    stored = _decoded(frame, pixels)
    if _has_doubtful_sign(stored, declared, pixels):
        signs = [f"with{'' if one.is_signed else 'out'} a sign" for one in (declared, pixels)]
        raise InputError(
            f"its compressed image has values of {declared.bits} bits {signs[0]}, its header of {pixels.bits_stored} "
            f"{signs[1]}, and readers differ how they go together; export it uncompressed"
        )
    return stored


def _has_doubtful_sign(stored: Stored, declared: Codestream, pixels: PixelFormat) -> bool:
    """Whether the highest bit of a value's coded bits may be its sign, or not: a header of as many bits tells."""
    if declared.bits >= pixels.bits_stored or declared.is_signed == pixels.is_signed:
        return False
    highest = stored.view(f"u{stored.dtype.itemsize}") & (1 << declared.bits - 1)
    return bool(highest.any())


def _decoded(frame: bytes, pixels: PixelFormat) -> Stored:
    if pixels.transfer_syntax in JPEG_LOSSLESS:
        return decode_jpeg_lossless(frame, pixels.rows, pixels.columns).view(
            f"{'i' if pixels.is_signed else 'u'}2"
        )
    decoder = (
        _decode_jpeg_ls if pixels.transfer_syntax in JPEG_LS and pixels.samples == 1 else _decode_with_pydicom
    )
    try:
        return decoder(frame, pixels)
    except InputError:
        for shorter in _with_less_padding(frame) if pixels.transfer_syntax in JPEG_LS else ():
            with suppress(InputError):
                return decoder(shorter, pixels)
        raise


def _with_less_padding(frame: bytes) -> Iterator[bytes]:
    """Yield the stream with one more zero byte before its end marker left out each time.

    Some encoders write such bytes, and CharLS refuses them. It decodes only what its coded bytes fill exactly, so
    that no zero that is data can be lost.
    """
    end = frame.rfind(_END_OF_IMAGE)
    for count in range(1, _MOST_PADDING + 1):
        if end < count or frame[end - count] != 0:
            return
        yield frame[: end - count] + frame[end:]


def _decode_jpeg_ls(frame: bytes, pixels: PixelFormat) -> Stored:
    """Call the decoder that pydicom would call, without what pydicom imports and checks around each frame."""
    with _IMPORTING:
        from jpeg_ls import decode_pixel_data

    try:
        decoded, told = decode_pixel_data(frame)
        size = 1 if told["bits_per_sample"] <= 8 else 2
        values = np.frombuffer(decoded, f"<{'i' if pixels.is_signed else 'u'}{size}")
        unused = 8 * size - told["bits_per_sample"] if pixels.is_signed else 0
        stored: Stored = ((values << unused) >> unused).reshape(pixels.rows, pixels.columns)  # extends the sign
        return stored
    except Exception as error:  # the decoder raises several kinds
        raise InputError(f"{printable(error)}; export it uncompressed") from error


def _decode_with_pydicom(frame: bytes, pixels: PixelFormat) -> Stored:
    with _IMPORTING:
        from pydicom.encaps import encapsulate
        from pydicom.pixels.decoders.base import get_decoder
        from pydicom.uid import UID

    expected = (pixels.rows, pixels.columns, pixels.samples)
    try:
        decoded, _ = get_decoder(UID(pixels.transfer_syntax)).as_array(
            encapsulate([frame], has_bot=False),
            index=0,
            raw=True,
            decoding_plugin=PLUGINS[pixels.transfer_syntax],
            **_options(pixels),
        )
    except Exception as error:  # each decoder raises its own kinds
        reason = str(error).rpartition("\n")[2].strip()  # which decoders failed stands above
        raise InputError(f"{printable(reason)}; export it uncompressed") from error
    shaped: Stored = decoded.reshape(expected[: 3 if pixels.samples > 1 else 2])
    return shaped


def codestream(frame: bytes) -> Codestream | None:
    """Return what a JPEG, JPEG-LS or JPEG 2000 stream declares, None if it is another.

    Checked before decoding, so that a decoder never makes room for more than the DICOM header says.
    """
    if frame[:2] == b"\xff\xd8":
        return _of_jpeg(frame)
    start = _codestream_start(frame)
    if frame[start : start + 4] != _JPEG_2000_START or len(frame) < start + _SAMPLES_AT + 3:
        return None
    right, bottom, left, top = struct.unpack_from(">4L", frame, start + _EXTENT_AT)
    samples, depth = struct.unpack_from(">HB", frame, start + _SAMPLES_AT)
    return Codestream(bottom - top, right - left, samples, depth % 128 + 1, depth >= 128)


def _codestream_start(frame: bytes) -> int:
    """Return where a JPEG 2000 codestream starts: at once, or in the box of a JP2 file that some writers wrap it in."""
    position = 0
    while frame[4:12] == _JP2_SIGNATURE and position + 8 <= len(frame):
        length, kind = struct.unpack_from(">L4s", frame, position)
        if kind == b"jp2c":
            return position + 8
        position += max(length, 8)
    return position


def _of_jpeg(frame: bytes) -> Codestream | None:
    """Return what a JPEG or JPEG-LS stream declares, None where it has no frame; neither knows a sign."""
    position = 2
    while position + 10 <= len(frame) and frame[position] == 0xFF:
        marker = frame[position + 1]
        if marker in _START_OF_FRAME:
            bits, rows, columns, samples = struct.unpack_from(">BHHB", frame, position + _BITS_AT)
            return Codestream(rows, columns, samples, bits, False)
        position += 1 if marker == 0xFF else 2 + struct.unpack_from(">H", frame, position + 2)[0]
    return None


def _options(pixels: PixelFormat) -> dict[str, Any]:
    return {
        "rows": pixels.rows,
        "columns": pixels.columns,
        "samples_per_pixel": pixels.samples,
        "photometric_interpretation": pixels.photometric,
        "pixel_representation": int(pixels.is_signed),
        "bits_allocated": pixels.bits_allocated,
        "bits_stored": pixels.bits_stored,
        "number_of_frames": 1,
        "pixel_keyword": "PixelData",
        "planar_configuration": 0,
    }
