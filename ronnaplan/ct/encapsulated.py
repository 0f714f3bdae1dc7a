"""The items of encapsulated pixels (DICOM PS3.5, annex A.4), and whether pixels are there to their end.

Apart from what arranges them into frames: the node's receiver asks for no more, and loads no arrays.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Final

from ronnaplan.ct import tags
from ronnaplan.ct.files import Blob, DamagedError
from ronnaplan.ct.header import Header
from ronnaplan.ct.uids import CT_IMAGE, ENHANCED_CT, LEGACY_ENHANCED_CT
from ronnaplan.ct.values import text

_WITH_PIXELS: Final = frozenset({CT_IMAGE, ENHANCED_CT, LEGACY_ENHANCED_CT})
ITEM_HEADER: Final = struct.Struct("<HHL")
MOST_FRAGMENTS: Final = 1 << 16
"""More compressed fragments than this in one file are taken for damage."""

Read = Callable[[int, int], bytes]
Run = tuple[int, int]
"""Where some bytes are in a file, and how many."""


class CutOffError(DamagedError):
    """The compressed pixels end amid an item."""

    def __init__(self) -> None:
        super().__init__("it ends within its compressed pixels")


def require_whole(blob: Blob, header: Header) -> None:
    """Raise `DamagedError` where the pixels end before they should: it is a part of a file.

    Of whole ones nothing else is asked: it may be a picture that nobody here reads.
    """
    if header.pixel_tag is None and text(header.elements, tags.SOP_CLASS_UID) in _WITH_PIXELS:
        raise DamagedError("it ends before its pixels; copy it again")
    if header.pixels_missing:
        raise DamagedError(f"{header.pixels_missing} bytes of its pixels are missing; copy it again")
    if header.pixel_tag is not None and header.pixel_length is None:
        try:
            for _ in _runs(blob.read, header.pixel_offset, blob.size):
                pass
        except CutOffError:
            raise
        except DamagedError:
            pass


def items(read: Read, position: int, size: int) -> tuple[tuple[int, ...], list[Run]]:
    """Return the offset table and all fragments of the encapsulated value at ``position``."""
    fragments = list(islice(_runs(read, position, size), MOST_FRAGMENTS + 2))
    if len(fragments) > MOST_FRAGMENTS + 1:
        raise DamagedError(f"its compressed pixels lie in more than {MOST_FRAGMENTS} fragments")
    if len(fragments) < 2:
        raise DamagedError("its compressed pixels are empty; copy it again")
    start, length = fragments.pop(0)
    content = read(start, min(length, 4 * MOST_FRAGMENTS))
    return struct.unpack(f"<{len(content) // 4}L", content[: len(content) // 4 * 4]), fragments


def _runs(read: Read, position: int, size: int) -> Iterator[Run]:
    while (length := _item_length(read, position)) is not None:
        start = position + ITEM_HEADER.size
        position = start + length
        if position > size:
            raise CutOffError
        yield start, length


def _item_length(read: Read, position: int) -> int | None:
    """Return the length of the item at ``position``, None at the end (which some writers leave out)."""
    header = read(position, ITEM_HEADER.size)
    if not header:
        return None
    if len(header) < ITEM_HEADER.size:
        raise CutOffError
    group, element, length = ITEM_HEADER.unpack(header)
    tag = group << 16 | element
    if tag == tags.SEQUENCE_DELIMITATION_ITEM:
        return None
    if tag != tags.ITEM:
        raise DamagedError("its compressed pixels are broken; copy it again")
    return int(length)
