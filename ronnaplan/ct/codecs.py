"""Decoding of compressed pixels by pydicom's decoders."""

from __future__ import annotations

import warnings
from typing import Any, Final

from ronnaplan.ct.limits import Limits
from ronnaplan.ct.slices import PixelFormat, SliceImage, Stored
from ronnaplan.ct.text import printable
from ronnaplan.errors import InputError

PLUGINS: Final = {
    "1.2.840.10008.1.2.5": "pydicom",  # RLE
    "1.2.840.10008.1.2.4.50": "gdcm",  # JPEG baseline
    "1.2.840.10008.1.2.4.51": "gdcm",  # JPEG extended, 12 bits
    "1.2.840.10008.1.2.4.57": "gdcm",  # JPEG lossless
    "1.2.840.10008.1.2.4.70": "gdcm",  # JPEG lossless, first-order prediction
    "1.2.840.10008.1.2.4.80": "pyjpegls",  # JPEG-LS lossless
    "1.2.840.10008.1.2.4.81": "pyjpegls",  # JPEG-LS near-lossless
    "1.2.840.10008.1.2.4.90": "pylibjpeg",  # JPEG 2000 lossless
    "1.2.840.10008.1.2.4.91": "pylibjpeg",  # JPEG 2000
    "1.2.840.10008.1.2.4.201": "pylibjpeg",  # HTJ2K lossless
    "1.2.840.10008.1.2.4.202": "pylibjpeg",  # HTJ2K lossless, RPCL
    "1.2.840.10008.1.2.4.203": "pylibjpeg",  # HTJ2K
}
"""Transfer syntax -> the pydicom plugin that decodes it: one each, so that no result depends on the machine."""


def decode(image: SliceImage, limits: Limits) -> Stored:
    """Return the stored values (J, I) of one compressed frame; raises `InputError` if it cannot be decoded."""
    from pydicom.encaps import get_frame
    from pydicom.pixels.decoders.base import get_decoder

    pixels = image.pixels
    blob = image.instance.blob
    encapsulated = blob.read(pixels.offset, blob.size - pixels.offset)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            frame = get_frame(encapsulated, image.frame, number_of_frames=pixels.frames)
            decoded, _ = get_decoder(pixels.transfer_syntax).as_array(
                _encapsulate(frame),
                index=0,
                raw=True,
                decoding_plugin=PLUGINS[pixels.transfer_syntax],
                **_options(pixels),
            )
    except Exception as error:
        raise InputError(f"{image.name} cannot be decoded ({printable(error)}); export it uncompressed") from error
    shaped: Stored = decoded.reshape(pixels.rows, pixels.columns)
    return shaped


def _encapsulate(frame: bytes) -> bytes:
    from pydicom.encaps import encapsulate

    return encapsulate([frame], has_bot=False)


def _options(pixels: PixelFormat) -> dict[str, Any]:
    return {
        "rows": pixels.rows,
        "columns": pixels.columns,
        "samples_per_pixel": 1,
        "photometric_interpretation": "MONOCHROME2",
        "pixel_representation": int(pixels.is_signed),
        "bits_allocated": pixels.bits_allocated,
        "bits_stored": pixels.bits_stored,
        "number_of_frames": 1,
        "pixel_keyword": "PixelData",
        "transfer_syntax_uid": pixels.transfer_syntax,
    }
