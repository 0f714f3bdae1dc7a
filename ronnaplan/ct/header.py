"""The few elements of a DICOM file that a reader needs, found in one pass that stops at the pixels.

A general parser spends milliseconds on each file; this one walks the element headers (DICOM PS3.5, section 7)
and keeps only what `tags` names. It is bounded: it never looks past the end of the file, reads at most
``Limits.header_bytes`` and nests at most ``Limits.sequence_depth`` deep.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from ronnaplan.ct import tags
from ronnaplan.ct.files import Blob, DamagedError, NotDicomError, inflate
from ronnaplan.ct.limits import LARGE_DEFLATED, Limits
from ronnaplan.text import printable

IMPLICIT_LITTLE: Final = "1.2.840.10008.1.2"
EXPLICIT_LITTLE: Final = "1.2.840.10008.1.2.1"
DEFLATED_LITTLE: Final = "1.2.840.10008.1.2.1.99"
EXPLICIT_BIG: Final = "1.2.840.10008.1.2.2"

Elements = dict[int, Any]
"""Tag (group << 16 | element) -> raw value: bytes, or a list of `Elements` for a sequence."""

_LONG_FORMS: Final = frozenset(
    {b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV"}
)
_UNDEFINED = _LAST_TAG = 0xFFFFFFFF
_FIRST_READ_BYTES: Final = 1 << 15
_PREAMBLE_BYTES, _META_START = 128, 128 + len(b"DICM")
_SHORT_HEAD_BYTES, _LONG_HEAD_BYTES = 8, 12
"""What stands before an element's value: tag and length, and where its form is one of `_LONG_FORMS` more of it."""
_ITEM_GROUP: Final = 0xFFFE  # without value representation in any transfer syntax (PS3.5, section 7.5)


class _MoreNeededError(Exception):
    """The header goes on beyond the bytes at hand."""


@dataclass(frozen=True, slots=True)
class Header:
    """What `read_header` found: raw elements, and the place of the pixels.

    ``pixel_length`` is what the file holds of the declared length, of which it lacks ``pixels_missing`` bytes; None
    for encapsulated pixels. In a deflated file ``pixel_offset`` counts from the start of the inflated bytes.
    """

    transfer_syntax: str
    elements: Elements
    is_explicit: bool
    is_big_endian: bool
    pixel_tag: int | None
    pixel_form: bytes
    pixel_offset: int
    pixel_length: int | None
    pixels_missing: int


def read_header(blob: Blob, limits: Limits) -> Header:
    """Read the header of ``blob``; raises `NotDicomError` or `DamagedError` (both are `InputError`)."""
    count = _FIRST_READ_BYTES
    while True:
        buffer = blob.read(0, count)
        try:
            header = _parse(buffer, blob.size, limits)
        except _MoreNeededError:
            if count >= blob.size:
                raise DamagedError("it ends too early") from None
            if count >= limits.header_bytes:
                return _of_no_image(buffer, blob.size, limits)
            count = min(count * 8, blob.size, limits.header_bytes)
            continue
        if header.pixel_length is not None and header.transfer_syntax != DEFLATED_LITTLE:
            end, explicit = header.pixel_offset + header.pixel_length, header.is_explicit
            refuse_more(blob, end, header.pixel_tag, limits, is_explicit=explicit, big=header.is_big_endian)
        return header


def refuse_more(
    blob: Blob, end: int, pixel_tag: int | None, limits: Limits, *, is_explicit: bool, big: bool = False
) -> None:
    """Raise `DamagedError` if what follows the pixels, which end at ``end``, is out of order.

    Elements ascend and none stands twice (PS3.5, section 7.1). A second set of pixels would leave it to each
    reader which one is the image.
    """
    if pixel_tag is None or end + _SHORT_HEAD_BYTES > blob.size:
        return
    scanner = _Scanner(blob.read(end, limits.header_bytes), blob.size - end, limits, big=big)
    try:
        scanner.trailer(0, pixel_tag, is_explicit)
    except _MoreNeededError:
        raise DamagedError("too much follows its pixels") from None


def deflated_part(blob: Blob, limits: Limits) -> bytes:
    """Return what follows the meta information of a deflated file."""
    content = blob.read(0, blob.size)
    scanner = _Scanner(content, blob.size, limits, big=False)
    return content[scanner.meta(_META_START)[1] :]


def _of_no_image(buffer: bytes, size: int, limits: Limits) -> Header:
    """Return who a document, a surface or a set of contours is, whose content is its header; an image is refused."""
    with suppress(_MoreNeededError):
        header = _parse(buffer, size, limits, last=tags.ROWS | 0xFFFF)  # to the end of its group
        if tags.ROWS not in header.elements:
            return header
    raise DamagedError("its header is too long")


def is_marked(content: bytes) -> bool:
    """Whether the ``content`` of a file, or its beginning, says that it is a DICOM file (PS3.10, section 7.1)."""
    return content[_PREAMBLE_BYTES:_META_START] == b"DICM"


def _parse(buffer: bytes, size: int, limits: Limits, last: int = _LAST_TAG) -> Header:
    if is_marked(buffer):
        start = _META_START
    elif _looks_like_bare_dataset(buffer):
        start = 0
    else:
        raise NotDicomError("it is not a DICOM file")
    meta, start = _Scanner(buffer, size, limits, big=False).meta(start)
    syntax = printable(meta.get(tags.TRANSFER_SYNTAX_UID, b"").rstrip(b"\0 ").decode("ascii", "replace"))
    if syntax == DEFLATED_LITTLE:
        if len(buffer) < size:
            raise _MoreNeededError if size <= limits.header_bytes else DamagedError(LARGE_DEFLATED)
        buffer = inflate(buffer[start:], limits.header_bytes)
        start, size = 0, len(buffer)
    big = syntax == EXPLICIT_BIG
    explicit = buffer[start + 4 : start + 6].isalpha() and buffer[start + 4 : start + 6].isupper()
    scanner = _Scanner(buffer, size, limits, big=big)
    elements, _ = scanner.dataset(start, size, explicit, depth=0, last=last)
    if syntax == DEFLATED_LITTLE and scanner.pixel_tag is None and size == limits.header_bytes:
        raise DamagedError("its header is too long")
    syntax = syntax or (EXPLICIT_LITTLE if explicit else IMPLICIT_LITTLE)
    tag, form, offset = scanner.pixel_tag, scanner.pixel_form, scanner.pixel_offset
    length, missing = scanner.pixel_length, 0
    if length is not None and tag is not None and (syntax != DEFLATED_LITTLE or size < limits.header_bytes):
        missing = max(0, offset + length - size)
        if syntax == DEFLATED_LITTLE:
            scanner.trailer(offset + length, tag, explicit)
        else:
            length -= missing
    return Header(syntax, elements, explicit, big, tag, form, offset, length, missing)


def _looks_like_bare_dataset(buffer: bytes) -> bool:
    """Whether a file without preamble starts with an element of group 2 or 8, as old exports do."""
    if len(buffer) < 8 or buffer[0:2] not in (b"\x02\x00", b"\x08\x00") or buffer[3] != 0:
        return False
    length: int = struct.unpack_from("<L", buffer, 4)[0]
    return buffer[4:6] in (b"UL", b"OB", b"UI", b"CS", b"SH", b"LO", b"DA", b"TM") or length <= 64


class _Scanner:
    """Walks the elements of ``buffer``, the first bytes of a data set of ``size`` bytes."""

    def __init__(self, buffer: bytes, size: int, limits: Limits, *, big: bool) -> None:
        self.buffer = buffer
        self.size = size
        self.limits = limits
        self.seen = 0
        order = ">" if big else "<"
        self.short_form = struct.Struct(order + "HH2sH").unpack_from
        self.plain_form = struct.Struct(order + "HHL").unpack_from
        self.long_length = struct.Struct(order + "L").unpack_from
        self.pixel_tag: int | None = None
        self.pixel_form, self.pixel_offset = b"", 0
        self.pixel_length: int | None = None

    def meta(self, position: int) -> tuple[Elements, int]:
        """Read the group 2 elements from ``position``; return them and where they end."""
        elements: Elements = {}
        while self.buffer[position : position + 2] == b"\x02\x00":
            tag, _, length, value = self._element(position, explicit=True)
            if length == _UNDEFINED or value + length > self.size:
                raise DamagedError("its file meta information is broken")
            self._require(value + length)
            if tag in tags.VALUES:
                elements[tag] = self.buffer[value : value + length]
            position = value + length
        self._require(min(position + _SHORT_HEAD_BYTES, self.size))
        return elements, position

    def dataset(
        self, position: int, end: int, explicit: bool, depth: int, last: int = _LAST_TAG
    ) -> tuple[Elements, int]:
        """Read elements from ``position`` to ``end``, ``last`` or an item's delimiter; return them and their end."""
        elements: Elements = {}
        buffer = self.buffer
        while position + _SHORT_HEAD_BYTES <= end:
            tag, form, length, value = self._element(position, explicit)
            if tag == tags.ITEM_DELIMITATION_ITEM or tag > last:
                return elements, value
            if depth == 0 and tag in tags.PIXELS:
                self._note_pixels(tag, form, value, length)
                return elements, value
            if length == _UNDEFINED:
                items, position = self._undefined(tag, form, value, end, explicit, depth)
                if tag in tags.SEQUENCES:
                    _keep(elements, tag, items)
                continue
            position = value + length
            if position > end:
                raise DamagedError(f"element {tags.element_name(tag)} is longer than what is left of the file")
            if tag in tags.VALUES:
                self._require(position)
                _keep(elements, tag, buffer[value:position])
            elif tag in tags.SEQUENCES:
                self._require(position)
                _keep(elements, tag, self._items(value, position, explicit and form != b"UN", depth + 1)[0])
        return elements, position

    def trailer(self, position: int, last: int, explicit: bool) -> None:
        """Walk what follows the element ``last``, whose value ends at ``position``; zeros may fill up the end."""
        while position + _SHORT_HEAD_BYTES <= self.size and self.buffer[position:].strip(b"\0"):
            tag, form, length, value = self._element(position, explicit)
            if tag <= last:
                raise DamagedError(
                    f"element {tags.element_name(tag)} follows element {tags.element_name(last)}, out of order"
                )
            if length == _UNDEFINED:
                position = self._undefined(tag, form, value, self.size, explicit, depth=0)[1]
            else:
                position = value + length
            last = tag

    def _element(self, position: int, explicit: bool) -> tuple[int, bytes, int, int]:
        """Return tag, value representation, length and where the value starts."""
        self._require(position + _SHORT_HEAD_BYTES)
        self.seen += 1
        if self.seen > self.limits.header_elements:
            raise DamagedError(f"its header has more than {self.limits.header_elements} elements")
        if not explicit:
            group, element, length = self.plain_form(self.buffer, position)
            return group << 16 | element, b"", length, position + _SHORT_HEAD_BYTES
        group, element, form, length = self.short_form(self.buffer, position)
        tag = group << 16 | element
        if group == _ITEM_GROUP:
            return tag, b"", self.long_length(self.buffer, position + 4)[0], position + _SHORT_HEAD_BYTES
        if form in _LONG_FORMS:
            self._require(position + _LONG_HEAD_BYTES)
            return tag, form, self.long_length(self.buffer, position + 8)[0], position + _LONG_HEAD_BYTES
        if not (form.isalpha() and form.isupper()):
            raise DamagedError(f"element {tags.element_name(tag)} has no valid value representation")
        return tag, form, length, position + _SHORT_HEAD_BYTES

    def _undefined(
        self, tag: int, form: bytes, value: int, end: int, explicit: bool, depth: int
    ) -> tuple[list[Elements], int]:
        """Read an element of undefined length from its ``value`` on; return its items and where it ends."""
        if form in (b"OB", b"OW"):
            return [], self._skip_fragments(value)
        if form not in (b"SQ", b"UN", b""):
            raise DamagedError(f"element {tags.element_name(tag)} has no defined length")
        return self._items(value, end, explicit and form != b"UN", depth + 1)

    def _items(self, position: int, end: int, explicit: bool, depth: int) -> tuple[list[Elements], int]:
        """Read a sequence's items to ``end`` or to its delimiter; return them and where it ended."""
        if depth > self.limits.sequence_depth:
            raise DamagedError(f"its sequences nest deeper than {self.limits.sequence_depth}")
        items: list[Elements] = []
        while position + _SHORT_HEAD_BYTES <= end:
            tag, _, length, value = self._element(position, explicit=False)
            if tag == tags.SEQUENCE_DELIMITATION_ITEM:
                return items, value
            if tag != tags.ITEM:
                raise DamagedError(f"a sequence holds element {tags.element_name(tag)} where an item should start")
            stop = end if length == _UNDEFINED else value + length
            if stop > end:
                raise DamagedError("a sequence item is longer than its sequence")
            item, after = self.dataset(value, stop, explicit, depth)
            position = after if length == _UNDEFINED else stop
            items.append(item)
        return items, position

    def _skip_fragments(self, position: int) -> int:
        while True:
            tag, _, length, value = self._element(position, explicit=False)
            if tag == tags.SEQUENCE_DELIMITATION_ITEM:
                return value
            if tag != tags.ITEM or length == _UNDEFINED:
                raise DamagedError("encapsulated data inside its header is broken")
            position = value + length

    def _note_pixels(self, tag: int, form: bytes, value: int, length: int) -> None:
        self.pixel_tag, self.pixel_form, self.pixel_offset = tag, form, value
        self.pixel_length = None if length == _UNDEFINED else length

    def _require(self, position: int) -> None:
        if position > len(self.buffer):
            if position > self.size:
                raise DamagedError("it ends too early")
            raise _MoreNeededError


def _keep(elements: Elements, tag: int, value: Any) -> None:
    if elements.setdefault(tag, value) != value:
        raise DamagedError(f"it gives element {tags.element_name(tag)} twice, with two values")
