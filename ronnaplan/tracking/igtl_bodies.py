"""What the bodies of OpenIGTLink's POINT and POSITION messages hold (http://openigtlink.org/protocols)."""

from __future__ import annotations

import math
import struct

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray

POINT_ITEM = np.dtype(
    [("name", "S64"), ("group", "S32"), ("rgba", "u1", 4), ("place", ">f4", 3), ("size", ">f4"), ("owner", "S20")]
)
POSITION_ITEM = struct.Struct(">64s32s4B8f20s")
PLACE_BYTES = 12
"""Of a POSITION that tells a place and no rotation."""
POSITION_BYTES = (24, 28)


def text(field: bytes) -> str:
    """Return the name in a field of fixed length; bytes that are no UTF-8 are escaped, so that names stay apart."""
    return field.split(b"\0")[0].decode(errors="backslashreplace").strip()


def doubles(floats: NDArray[np.void]) -> FloatArray:
    """Return numbers of four bytes as ours."""
    with np.errstate(invalid="ignore"):  # of a signalling NaN, which becomes a quiet one
        return floats.astype(np.float64)


def positions(content: bytes) -> list[tuple[str, FloatArray, FloatArray]]:
    """Return (name, position, scalar-first quaternion) of a POSITION body, in either layout."""
    if len(content) in POSITION_BYTES:
        values = doubles(np.frombuffer(content, dtype=">f4"))
        if len(values) == 6:  # the protocol leaves out the scalar part, which is not negative
            quaternion = np.array([math.sqrt(max(0.0, 1.0 - float(values[3:] @ values[3:]))), *values[3:]])
        else:
            quaternion = values[[6, 3, 4, 5]]
        return [("", values[:3], quaternion)]
    if not content or len(content) % POSITION_ITEM.size:
        raise ValueError(f"{len(content)} bytes")
    found = []
    for item in POSITION_ITEM.iter_unpack(content):
        numbers = np.array(item[6:13], dtype=np.float64)
        found.append((text(item[0]), numbers[:3], numbers[[6, 3, 4, 5]]))
    return found
