"""What a DICOM element holds, as texts and numbers; raises `DamagedError` rather than taking something for it."""

from __future__ import annotations

import codecs
import math
import struct
from functools import lru_cache
from typing import Final

from ronnaplan.ct import tags
from ronnaplan.ct.files import DamagedError
from ronnaplan.ct.header import Elements
from ronnaplan.text import printable

Vector = tuple[float, ...]
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
_DECIMAL_STRINGS: Final = b"0123456789+-.eE \\"
"""All that Decimal Strings may hold (PS3.5, 6.2), and what parts them; a control character may be a damaged digit."""
_SEEN_BEFORE: Final = 256
"""So many texts are kept: the files of a series say most things alike."""


def text(elements: Elements, tag: int) -> str:
    """Return an element as one line of printable text, empty if absent."""
    raw = elements.get(tag)
    return _text(raw, elements.get(tags.SPECIFIC_CHARACTER_SET, b"")) if raw else ""


@lru_cache(_SEEN_BEFORE)
def _text(raw: bytes, charset: bytes) -> str:
    return printable(_decode(raw.rstrip(b"\0 "), charset)).strip()


def values(elements: Elements, tag: int) -> tuple[str, ...]:
    """Return the texts of an element of several values, none if absent."""
    written = text(elements, tag)
    return tuple(part.strip() for part in written.split("\\")) if written else ()


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
    if not all(map(math.isfinite, values)) or stripped.translate(None, _DECIMAL_STRINGS):
        shown = printable(stripped[:60].decode("ascii", "replace"))
        raise DamagedError(f"element {tags.element_name(tag)} holds '{shown}', not numbers")
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
        raise DamagedError(f"element {tags.element_name(tag)} has {len(raw)} bytes, expected 2")
    value: int = struct.unpack(_SHORT[big, signed], raw)[0]
    return value
