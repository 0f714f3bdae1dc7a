"""Where in a file the compressed frames are (DICOM PS3.5, annex A.4: encapsulated pixel data)."""

from __future__ import annotations

import struct
from itertools import pairwise
from typing import Final

from ronnaplan.ct.encapsulated import ITEM_HEADER, items
from ronnaplan.ct.files import Blob, DamagedError
from ronnaplan.ct.header import refuse_more
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.ct.slices import Fragment, PixelFormat

_READ_AT_ONCE_BYTES: Final = 4 << 20
_IMAGE_STARTS: Final = (b"\xff\xd8\xff", b"\xff\x4f\xff\x51")
"""How JPEG and JPEG 2000 images begin. JPEG data hold no such marker, those of JPEG 2000 by a chance of one in 2^32."""


def frame_fragments(blob: Blob, pixels: PixelFormat) -> list[tuple[Fragment, ...]]:
    """Return, for each frame, the runs of bytes that hold it; raises `DamagedError`."""
    read = blob.read
    if blob.size <= _READ_AT_ONCE_BYTES:
        content = blob.read(0, blob.size)

        def read(offset: int, count: int) -> bytes:
            return content[offset : offset + count]

    table, fragments = items(read, pixels.offset, blob.size)
    end = sum(fragments[-1]) + ITEM_HEADER.size  # of the delimiter, which has no value
    refuse_more(blob, end, pixels.tag, DEFAULT_LIMITS, is_explicit=True)
    if pixels.frames == 1:
        if any(read(offset, 4).startswith(_IMAGE_STARTS) for offset, _ in fragments[1:]):
            raise DamagedError("it holds several compressed images but declares one")
        return [tuple(fragments)]
    places = {offset - fragments[0][0]: number for number, (offset, _) in enumerate(fragments)}
    starts = [places.get(place, -1) for place in table]  # it counts from the first fragment's item
    has_whole_table = sorted(starts) == list(range(pixels.frames))  # in another order it is refused below
    if len(fragments) == pixels.frames and not has_whole_table:  # one fragment each, which need no table
        return [(fragment,) for fragment in fragments]
    if not table:
        starts = [k for k, (offset, _) in enumerate(fragments) if read(offset, 4).startswith(_IMAGE_STARTS)]
    return _grouped(fragments, starts, pixels.frames)


def require_order(extended_table: bytes) -> None:
    """Raise `DamagedError` where an extended offset table (PS3.3, C.7.6.3.1.8) tells another order than frames lie in.

    Nothing else is asked of it: it is of frames of one fragment each, which need none.
    """
    offsets = struct.unpack(f"<{len(extended_table) // 8}Q", extended_table[: len(extended_table) // 8 * 8])
    if any(after < before for before, after in pairwise(offsets)):
        raise DamagedError(
            "its extended offset table puts frames in another order than they lie in; export it uncompressed"
        )


def _grouped(fragments: list[Fragment], starts: list[int], count: int) -> list[tuple[Fragment, ...]]:
    """Return the fragments of each frame; ``starts`` are the numbers of their first ones."""
    if len(starts) != count or starts[0] != 0 or any(b <= a for a, b in pairwise(starts)):
        raise DamagedError(f"its {count} compressed frames cannot be told apart")
    return [tuple(fragments[a:b]) for a, b in pairwise([*starts, len(fragments)])]
