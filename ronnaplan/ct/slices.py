"""What a DICOM file says of itself (`Instance`) and of each image in it (`SliceImage`), as typed values."""

from __future__ import annotations

import codecs
import math
import struct
from dataclasses import dataclass
from typing import Any, Final

from numpy.typing import NDArray

from ronnaplan.ct.files import Blob, DamagedError
from ronnaplan.ct.header import Elements, Header
from ronnaplan.text import printable

CT_IMAGE: Final = "1.2.840.10008.5.1.4.1.1.2"
ENHANCED_CT: Final = "1.2.840.10008.5.1.4.1.1.2.1"
LEGACY_ENHANCED_CT: Final = "1.2.840.10008.5.1.4.1.1.2.2"
MULTI_FRAME_CLASSES: Final = frozenset({ENHANCED_CT, LEGACY_ENHANCED_CT})
LOSSY_SYNTAXES: Final = frozenset(
    f"1.2.840.10008.1.2.4.{number}" for number in (50, 51, 81, 91, 93, 100, 102, 112, 203)
)
_PLAIN_CHARSETS: Final = {
    "": "latin-1",
    "ISO_IR 6": "latin-1",
    "ISO_IR 100": "latin-1",
    "ISO_IR 192": "utf-8",
    "GB18030": "gb18030",
    "GBK": "gbk",
    "ISO_IR 144": "iso8859_5",
    "ISO_IR 13": "shift_jis",
}

FLOAT_BYTES: Final = {0x7FE00008: 4, 0x7FE00009: 8}
"""Tags of float pixels -> bytes of one pixel."""

Vector = tuple[float, ...]
Fragment = tuple[int, int]
"""Offset and length of a run of bytes in a file."""
Stored = NDArray[Any]
"""Pixels (J, I) as they are stored, of any number type."""


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """How the pixels of a file are stored; ``tag`` tells integers (7FE00010) from float (…08) and double (…09)."""

    transfer_syntax: str
    is_big_endian: bool
    tag: int
    offset: int
    length: int | None
    frames: int
    rows: int
    columns: int
    bits_allocated: int
    bits_stored: int
    is_signed: bool
    padding: tuple[float, float] | None
    samples: int
    photometric: str
    high_bit: int

    @property
    def frame_bytes(self) -> int:
        """Bytes of one uncompressed frame."""
        return self.rows * self.columns * self.samples * self.item_bytes

    @property
    def item_bytes(self) -> int:
        """Bytes of one pixel."""
        return FLOAT_BYTES.get(self.tag, self.bits_allocated // 8)


@dataclass(frozen=True, slots=True)
class Instance:
    """One DICOM file. ``pixels`` is None if it holds none; every text is safe to print."""

    blob: Blob
    elements: Elements
    is_big_endian: bool
    sop_class: str
    sop_uid: str
    study_uid: str | None
    series_uid: str | None
    frame_of_reference_uid: str | None
    modality: str
    description: str
    image_type: tuple[str, ...]
    is_lossy: bool
    tilt_tag_deg: float | None
    pixels: PixelFormat | None

    @property
    def patient_name(self) -> str:
        """The patient's name, decoded only when asked for."""
        return text(self.elements, 0x00100010)


@dataclass(frozen=True, slots=True)
class SliceImage:
    """One image of an `Instance`: its place (LPS mm), its rescale to HU, and what may set it apart from others.

    ``orientation`` holds the direction along a row (increasing column) and along a column (increasing row);
    ``spacing_mm`` the distances between rows and between columns. ``fragments`` are the runs of bytes that hold
    a compressed image.
    """

    instance: Instance
    pixels: PixelFormat
    frame: int
    origin_mm: Vector
    orientation: Vector
    spacing_mm: Vector
    slope: float
    intercept: float
    thickness_mm: float | None
    kernel: str
    acquisition: str
    stack_id: str = ""
    fragments: tuple[Fragment, ...] = ()

    @property
    def name(self) -> str:
        """File and frame, for a message."""
        shown = self.instance.blob.name
        return shown if self.pixels.frames == 1 else f"{shown} frame {self.frame + 1}"


def instance_from_header(blob: Blob, header: Header) -> Instance:
    """Interpret ``header``; raises `DamagedError` where an element cannot be read."""
    elements = header.elements
    image_type = tuple(part.strip() for part in text(elements, 0x00080008).split("\\"))
    return Instance(
        blob=blob,
        elements=elements,
        is_big_endian=header.is_big_endian,
        sop_class=text(elements, 0x00080016),
        sop_uid=text(elements, 0x00080018),
        study_uid=text(elements, 0x0020000D) or None,
        series_uid=text(elements, 0x0020000E) or None,
        frame_of_reference_uid=text(elements, 0x00200052) or None,
        modality=text(elements, 0x00080060),
        description=text(elements, 0x0008103E),
        image_type=image_type,
        is_lossy=header.transfer_syntax in LOSSY_SYNTAXES or text(elements, 0x00282110) == "01",
        tilt_tag_deg=number_or_none(elements, 0x00181120),
        pixels=_pixel_format(header),
    )


def _pixel_format(header: Header) -> PixelFormat | None:
    if header.pixel_tag is None:
        return None
    elements, big = header.elements, header.is_big_endian
    rows, columns = integer(elements, 0x00280010, big), integer(elements, 0x00280011, big)
    if not rows or not columns:
        return None
    allocated = integer(elements, 0x00280100, big) or 0
    stored = integer(elements, 0x00280101, big) or allocated
    signed = bool(integer(elements, 0x00280103, big))
    high_bit = integer(elements, 0x00280102, big)
    return PixelFormat(
        transfer_syntax=header.transfer_syntax,
        is_big_endian=big,
        tag=header.pixel_tag,
        offset=header.pixel_offset,
        length=header.pixel_length,
        frames=_frame_count(elements),
        rows=rows,
        columns=columns,
        bits_allocated=allocated,
        bits_stored=stored,
        is_signed=signed,
        padding=_padding(elements, big, signed) if header.pixel_tag == 0x7FE00010 else _float_padding(header),
        samples=integer(elements, 0x00280002, big) or 1,
        photometric=text(elements, 0x00280004),
        high_bit=stored - 1 if high_bit is None else high_bit,
    )


def _frame_count(elements: Elements) -> int:
    written = text(elements, 0x00280008)
    if not written:
        return 1
    if not (written.isascii() and written.isdigit() and len(written) < 10):
        raise DamagedError(f"its number of frames is '{written}'")
    return int(written)


def _padding(elements: Elements, big: bool, signed: bool) -> tuple[int, int] | None:
    """Return the lowest and highest stored value that mean padding.

    The element's own value representation (US or SS) is wrong in many files, so the sign is taken from the
    pixels' representation instead.
    """
    first = integer(elements, 0x00280120, big, signed)
    if first is None:
        return None
    last = integer(elements, 0x00280121, big, signed)
    other = first if last is None else last
    return min(first, other), max(first, other)


def _float_padding(header: Header) -> tuple[float, float] | None:
    tag, form = (0x00280122, "f") if header.pixel_tag == 0x7FE00008 else (0x00280123, "d")
    raw = header.elements.get(tag, b"")
    if len(raw) != struct.calcsize(form):
        return None
    value: float = struct.unpack((">" if header.is_big_endian else "<") + form, raw)[0]
    return value, value


def text(elements: Elements, tag: int) -> str:
    """Return an element as one line of printable text, empty if absent."""
    raw = elements.get(tag)
    if not raw:
        return ""
    charset = elements.get(0x00080005, b"")
    return printable(_decode(raw.rstrip(b"\0 "), charset)).strip()


def _decode(raw: bytes, charset: bytes) -> str:
    if raw.isascii() and b"\x1b" not in raw:
        return raw.decode("ascii")
    names = [name.strip() for name in charset.decode("ascii", "replace").split("\\")]
    if len(names) == 1 and names[0] in _PLAIN_CHARSETS:
        return codecs.decode(raw, _PLAIN_CHARSETS[names[0]], "replace")
    return _decode_with_pydicom(raw, names)


def _decode_with_pydicom(raw: bytes, names: list[str]) -> str:
    import warnings

    from pydicom.charset import convert_encodings, decode_bytes

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return str(decode_bytes(raw[:1024], convert_encodings(names), {0x5C, 0x5E, 0x3D}))
    except (LookupError, UnicodeError, ValueError):
        return raw.decode("latin-1")


def numbers(elements: Elements, tag: int) -> Vector | None:
    """Return the decimal strings of an element, None if absent or empty; raises `DamagedError` if not numbers."""
    raw = elements.get(tag)
    stripped = raw.rstrip(b"\0 ") if raw else b""
    if not stripped:
        return None
    try:
        values = tuple([float(part) for part in stripped.split(b"\\")])
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)) or b"_" in stripped:
        shown = printable(stripped[:60].decode("ascii", "replace"))
        raise DamagedError(f"element ({tag >> 16:04X},{tag & 0xFFFF:04X}) holds '{shown}', not numbers")
    return values


def number_or_none(elements: Elements, tag: int) -> float | None:
    """Return the first decimal string of an element that is not needed for geometry: broken counts as absent."""
    try:
        values = numbers(elements, tag)
    except DamagedError:
        return None
    return values[0] if values else None


_SHORT: Final = {(False, False): "<H", (False, True): "<h", (True, False): ">H", (True, True): ">h"}


def integer(elements: Elements, tag: int, big: bool, signed: bool = False) -> int | None:
    """Return a 2-byte integer element, None if absent or empty; raises `DamagedError` at another length."""
    raw = elements.get(tag)
    if not raw:
        return None
    if len(raw) != 2:
        raise DamagedError(f"element ({tag >> 16:04X},{tag & 0xFFFF:04X}) has {len(raw)} bytes, expected 2")
    value: int = struct.unpack(_SHORT[big, signed], raw)[0]
    return value
