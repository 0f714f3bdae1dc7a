"""Lossless JPEG (ITU-T T.81, annex H: Huffman coding, process 14), the commonest compression of CT archives.

The freely usable decoders either abort the whole process on a damaged stream or return made-up pixels with a
warning; this one refuses any stream that does not decode to exactly the pixels it declares.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.files import DamagedError

_START, _END, _HUFFMAN_TABLES, _LOSSLESS_FRAME, _RESTART_INTERVAL, _SCAN = 0xD8, 0xD9, 0xC4, 0xC3, 0xDD, 0xDA
_OTHER_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {_HUFFMAN_TABLES, _LOSSLESS_FRAME, 0xC8, 0xCC}
_MARKER: Final = re.compile(rb"\xff[^\x00]", re.DOTALL)
_MOST_UNUSED_BYTES: Final = 4
"""A sound scan ends with at most some padding; more left over means that decoding went astray."""
_MOST_CATEGORY: Final = 16


@dataclass
class _Stream:
    """What the markers before the scan say."""

    rows: int = 0
    columns: int = 0
    precision: int = 0
    restart_interval: int = 0
    predictor: int = 0
    point_transform: int = 0
    lookup: NDArray[np.uint16] | None = None


def decode_jpeg_lossless(data: bytes, rows: int, columns: int) -> NDArray[np.uint16]:
    """Return the pixels (rows, columns) of a one-component lossless JPEG; raises `DamagedError`."""
    from ronnaplan.ct.jpeg_kernel import decode_segment

    try:
        stream, scan = _parse(data)
    except (struct.error, IndexError) as error:
        raise DamagedError("its JPEG stream ends too early") from error
    if (stream.rows, stream.columns) != (rows, columns) or stream.lookup is None:
        raise DamagedError(f"its JPEG stream holds {stream.rows} x {stream.columns} pixels")
    pixels = np.zeros(rows * columns, np.uint16)
    interval = stream.restart_interval or pixels.size
    if interval % columns:
        raise DamagedError("its JPEG stream restarts within a line")
    segments = _segments(data, scan)
    if len(segments) != -(-pixels.size // interval):
        raise DamagedError("its JPEG stream is incomplete")
    first = 1 << (stream.precision - stream.point_transform - 1)
    for number, segment in enumerate(segments):
        part = pixels[number * interval : (number + 1) * interval]
        used = decode_segment(segment, stream.lookup, part, columns, stream.predictor, first)
        if used < 0 or len(segment) - used > _MOST_UNUSED_BYTES:
            raise DamagedError("its JPEG stream is corrupt")
    pixels <<= stream.point_transform
    return pixels.reshape(rows, columns)


def _parse(data: bytes) -> tuple[_Stream, int]:
    """Read the markers; return what they say and where the entropy-coded scan begins."""
    stream = _Stream()
    tables: dict[int, NDArray[np.uint16]] = {}
    position = 2
    while True:
        if data[position] != 0xFF:
            raise DamagedError("its JPEG stream is corrupt")
        marker = data[position + 1]
        if marker == 0xFF:
            position += 1
            continue
        length = struct.unpack_from(">H", data, position + 2)[0]
        body = data[position + 4 : position + 2 + length]
        position += 2 + length
        if marker == _SCAN:
            _read_scan(body, stream, tables)
            return stream, position
        _read_segment(marker, body, stream, tables)


def _read_segment(marker: int, body: bytes, stream: _Stream, tables: dict[int, NDArray[np.uint16]]) -> None:
    if marker == _HUFFMAN_TABLES:
        _read_tables(body, tables)
    elif marker == _LOSSLESS_FRAME:
        stream.precision, stream.rows, stream.columns, components = struct.unpack_from(">BHHB", body)
        if components != 1 or not 2 <= stream.precision <= 16:
            raise DamagedError(f"its JPEG stream has {components} components of {stream.precision} bits")
    elif marker == _RESTART_INTERVAL:
        stream.restart_interval = struct.unpack_from(">H", body)[0]
    elif marker in _OTHER_FRAMES or marker in (_START, _END):
        raise DamagedError("its JPEG stream is not of the lossless kind")


def _read_scan(body: bytes, stream: _Stream, tables: dict[int, NDArray[np.uint16]]) -> None:
    components, _, table, predictor, _, transform = struct.unpack_from(">6B", body)
    stream.predictor, stream.point_transform = predictor, transform & 15
    stream.lookup = tables.get(table >> 4)
    if components != 1 or not 1 <= predictor <= 7 or stream.lookup is None:
        raise DamagedError("its JPEG scan is corrupt")
    if stream.point_transform >= stream.precision:
        raise DamagedError("its JPEG scan is corrupt")


def _read_tables(body: bytes, tables: dict[int, NDArray[np.uint16]]) -> None:
    position = 0
    while position < len(body):
        counts = body[position + 1 : position + 17]
        values = body[position + 17 : position + 17 + sum(counts)]
        if len(counts) < 16 or len(values) < sum(counts):
            raise DamagedError("its JPEG Huffman table is corrupt")
        tables[body[position]] = _lookup(counts, values)
        position += 17 + len(values)


def _lookup(counts: bytes, values: bytes) -> NDArray[np.uint16]:
    """Return, for each 16-bit pattern, code length << 8 | category; zero where no code matches."""
    table = np.zeros(1 << 16, np.uint16)
    begin, used = 0, 0
    for length, count in enumerate(counts, start=1):
        for value in values[used : used + count]:
            end = begin + (1 << (16 - length))
            if end > 1 << 16 or value > _MOST_CATEGORY:
                raise DamagedError("its JPEG Huffman table is corrupt")
            table[begin:end] = length << 8 | value
            begin = end
        used += count
    return table


def _segments(data: bytes, position: int) -> list[NDArray[np.uint8]]:
    """Divide the scan at its restart markers and take out the stuffed zeros."""
    segments = []
    while True:
        marker = _MARKER.search(data, position)
        if marker is None:
            raise DamagedError("its JPEG stream ends too early")
        content = data[position : marker.start()].replace(b"\xff\x00", b"\xff")
        segments.append(np.frombuffer(content, np.uint8))
        position = marker.end()
        if not 0xD0 <= data[position - 1] <= 0xD7:
            return segments
