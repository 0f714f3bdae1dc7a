"""What a DICOM file says of itself (`Instance`) and of each image in it (`SliceImage`), as typed values."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, Final

from numpy.typing import NDArray

from ronnaplan.ct import tags
from ronnaplan.ct.files import Blob, DamagedError
from ronnaplan.ct.header import Elements, Header
from ronnaplan.ct.uids import CT_IMAGE, ENHANCED_CT, LEGACY_ENHANCED_CT
from ronnaplan.ct.values import Vector, integer, number_or_none, text, values

MULTI_FRAME_CLASSES: Final = frozenset({ENHANCED_CT, LEGACY_ENHANCED_CT})
CT_ONLY: Final = {"CT": MULTI_FRAME_CLASSES | {CT_IMAGE, ""}}
"""Modality -> SOP classes of what is read as a scan; an empty class where the file gives none."""
CT_OR_MR: Final = CT_ONLY | {
    "MR": frozenset(f"1.2.840.10008.5.1.4.1.1.4{rest}" for rest in ("", ".1", ".4")) | {""}
}
"""The same with MR (classic, enhanced, legacy converted), which has no unit: to be looked at, not measured in."""
LOSSY_SYNTAXES: Final = frozenset(
    f"1.2.840.10008.1.2.4.{number}" for number in (50, 51, 81, 91, 93, 100, 102, 112, 203)
)

_PATIENT: Final = (
    tags.PATIENT_ID,
    tags.ISSUER_OF_PATIENT_ID,
    tags.PATIENT_NAME,
    tags.PATIENT_BIRTH_DATE,
    tags.PATIENT_SEX,
)
FLOAT_BYTES: Final = {tags.FLOAT_PIXEL_DATA: 4, tags.DOUBLE_FLOAT_PIXEL_DATA: 8}
"""Tags of float pixels -> bytes of one pixel."""

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
    fault: str | None = None
    """What the header leaves open about them, so that they cannot be read."""

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
    """One DICOM file. ``pixels`` is None if it holds none; every text is safe to print.

    ``concatenation`` is the UID of the image whose frames several files share, "" where it has a file to itself;
    ``file_number`` of ``file_count`` is this one, as far as it is told.
    """

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
    technique: str
    is_lossy: bool
    tilt_tag_deg: float | None
    pixels: PixelFormat | None
    concatenation: str
    file_number: int
    file_count: int

    @property
    def patient(self) -> tuple[bytes, ...]:
        """What tells patients apart, as it is written."""
        return tuple(self._written(tag) for tag in _PATIENT)

    @property
    def series_number(self) -> str:
        """The number that a person knows the series by."""
        return text(self.elements, tags.SERIES_NUMBER)

    @property
    def patient_position(self) -> bytes:
        """How the patient lay, as it is written."""
        return self._written(tags.PATIENT_POSITION)

    def _written(self, tag: int) -> bytes:
        value: bytes = self.elements.get(tag, b"").strip(b"\0 ^")
        return value

    @property
    def patient_name(self) -> str:
        """The patient's name, decoded only when asked for."""
        return text(self.elements, tags.PATIENT_NAME)


@dataclass(frozen=True, slots=True)
class SliceImage:
    """One image of an `Instance`: its place (LPS mm), its rescale to HU, and what may set it apart from others.

    ``orientation`` holds the direction along a row (increasing column) and along a column (increasing row);
    ``spacing_mm`` the distances between rows and between columns. ``taken_s`` is the time of acquisition in seconds
    since any fixed day; ``fragments`` are the runs of bytes that hold a compressed image.
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
    phase: str = ""
    image_type: tuple[str, ...] = ()
    technique: str = ""
    tube_voltage_kv: float | None = None
    taken_s: float | None = None
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
    return Instance(
        blob=blob,
        elements=elements,
        is_big_endian=header.is_big_endian,
        sop_class=text(elements, tags.SOP_CLASS_UID),
        sop_uid=text(elements, tags.SOP_INSTANCE_UID),
        study_uid=text(elements, tags.STUDY_INSTANCE_UID) or None,
        series_uid=text(elements, tags.SERIES_INSTANCE_UID) or None,
        frame_of_reference_uid=text(elements, tags.FRAME_OF_REFERENCE_UID) or None,
        modality=text(elements, tags.MODALITY),
        description=text(elements, tags.SERIES_DESCRIPTION),
        image_type=values(elements, tags.IMAGE_TYPE),
        technique=text(elements, tags.VOLUME_BASED_CALCULATION_TECHNIQUE),
        is_lossy=header.transfer_syntax in LOSSY_SYNTAXES or text(elements, tags.LOSSY_IMAGE_COMPRESSION) == "01",
        tilt_tag_deg=number_or_none(elements, tags.GANTRY_DETECTOR_TILT),
        pixels=_pixel_format(header),
        concatenation=text(elements, tags.CONCATENATION_UID),
        file_number=integer(elements, tags.IN_CONCATENATION_NUMBER, header.is_big_endian) or 1,
        file_count=integer(elements, tags.IN_CONCATENATION_TOTAL_NUMBER, header.is_big_endian) or 1,
    )


_REPRESENTATION, _SAMPLES = "pixel representation", "samples per pixel"
_PIXEL_NUMBERS: Final = {
    "bits allocated": tags.BITS_ALLOCATED,
    "bits stored": tags.BITS_STORED,
    "high bit": tags.HIGH_BIT,
    _REPRESENTATION: tags.PIXEL_REPRESENTATION,
    _SAMPLES: tags.SAMPLES_PER_PIXEL,
}
"""What the standard requires of integer pixels, by what a message calls it."""


def _pixel_format(header: Header) -> PixelFormat | None:
    if header.pixel_tag is None:
        return None
    elements, big = header.elements, header.is_big_endian
    rows, columns = integer(elements, tags.ROWS, big), integer(elements, tags.COLUMNS, big)
    if not rows or not columns:
        return None
    numbers = {name: integer(elements, tag, big) for name, tag in _PIXEL_NUMBERS.items()}
    photometric = text(elements, tags.PHOTOMETRIC_INTERPRETATION)
    is_float, is_signed = header.pixel_tag in FLOAT_BYTES, numbers[_REPRESENTATION] == 1
    return PixelFormat(
        transfer_syntax=header.transfer_syntax,
        is_big_endian=big,
        tag=header.pixel_tag,
        offset=header.pixel_offset,
        length=header.pixel_length,
        frames=_frame_count(elements),
        rows=rows,
        columns=columns,
        bits_allocated=numbers["bits allocated"] or 0,
        bits_stored=numbers["bits stored"] or 0,
        is_signed=is_signed,
        padding=_float_padding(header) if is_float else _padding(elements, big, is_signed),
        samples=numbers[_SAMPLES] or 0,
        photometric=photometric,
        high_bit=numbers["high bit"] or 0,
        fault=_fault({_SAMPLES: numbers[_SAMPLES]} if is_float else numbers, photometric)
        or _fault_of_order(header, numbers["bits allocated"]),
    )


def _fault(needed: dict[str, int | None], photometric: str) -> str | None:
    """Return what of the attributes that the standard requires of pixels (PS3.3 C.7.6.3) is not given."""
    absent = [name for name, value in needed.items() if value is None]
    if not photometric:
        absent.append("photometric interpretation")
    if absent:
        return f"its header gives no {' and no '.join(absent)}"
    if needed.get(_REPRESENTATION, 0) not in (0, 1):
        return f"its pixel representation is {needed[_REPRESENTATION]}, expected 0 (unsigned) or 1 (signed)"
    return None


def _fault_of_order(header: Header, bits_allocated: int | None) -> str | None:
    """Return why pixels of 8 or 32 bits in big endian words of 16 (OW; PS3.5, 7.3 and 8.1.1) cannot be read."""
    if header.is_big_endian and header.pixel_form == b"OW" and bits_allocated in (8, 32):
        return (
            f"its pixels of {bits_allocated} bits lie in big endian words of 16, which readers put together in two "
            "ways; export it in little endian"
        )
    return None


def _frame_count(elements: Elements) -> int:
    written = text(elements, tags.NUMBER_OF_FRAMES)
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
    first = integer(elements, tags.PIXEL_PADDING_VALUE, big, signed)
    if first is None:
        return None
    last = integer(elements, tags.PIXEL_PADDING_RANGE_LIMIT, big, signed)
    other = first if last is None else last
    return min(first, other), max(first, other)


_FLOAT_PADDING: Final = {
    tags.FLOAT_PIXEL_DATA: (tags.FLOAT_PIXEL_PADDING_VALUE, "f"),
    tags.DOUBLE_FLOAT_PIXEL_DATA: (tags.DOUBLE_FLOAT_PIXEL_PADDING_VALUE, "d"),
}


def _float_padding(header: Header) -> tuple[float, float] | None:
    if header.pixel_tag is None:
        return None
    tag, form = _FLOAT_PADDING[header.pixel_tag]
    raw = header.elements.get(tag, b"")
    if len(raw) != struct.calcsize(form):
        return None
    value: float = struct.unpack((">" if header.is_big_endian else "<") + form, raw)[0]
    return value, value
