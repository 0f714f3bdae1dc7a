"""What the bodies of OpenIGTLink's messages of places and poses hold (http://openigtlink.org/protocols)."""

from __future__ import annotations

import math
import struct
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.tracking.recording import OK, quaternion_pose

POINT_ITEM = np.dtype(
    [("name", "S64"), ("group", "S32"), ("rgba", "u1", 4), ("place", ">f4", 3), ("size", ">f4"), ("owner", "S20")]
)
POSITION_ITEM = struct.Struct(">64s32s4B8f20s")
PLACE_BYTES = 12
"""Of a POSITION that tells a place and no rotation."""
POSITION_BYTES = (24, 28)
_TRACKED = [("name", "S20"), ("kind", "u1"), ("reserved", "u1")]
TRACKED_ITEMS = {
    "TDATA": np.dtype([*_TRACKED, ("pose", ">f4", 12)]),
    "QTDATA": np.dtype([*_TRACKED, ("pose", ">f4", 7)]),
}
"""Kinds of messages of several tools -> the item of each: its matrix as a TRANSFORM's, or place and quaternion."""
PLACE_ONLY, NO_TURN = 3, 4
TRACKED_STATUS = {1: OK, 2: OK, PLACE_ONLY: OK, NO_TURN: "its turn about its own axis was not measured (5D)"}
"""What is to be said of a tool by its kind: tracker or reference, tool, tip alone, tip and axis."""
NAMED_TWICE = "its name stands twice in one message: names of tools have 20 letters at most"


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


def matrix_of(columns: FloatArray) -> FloatArray:
    """Return the (4, 4) whose columns (12,), without its last row, are told one after another, the place last."""
    matrix = np.eye(4)
    matrix[:3] = columns.reshape(4, 3).T
    return matrix


@dataclass(frozen=True)
class Tracked:
    """A tool of a TDATA or QTDATA message: where it is (3,), and tracker from tool (4, 4), None where that is no pose.

    Of one that ``is_place`` no rotation was measured, whatever it says of it.
    """

    name: str
    place_mm: FloatArray
    matrix: FloatArray | None
    is_place: bool
    status: str


def tracked(kind: str, content: bytes, device: str) -> list[Tracked]:
    """Return the tools in the body of a message of ``kind``; one without a name is called as its ``device``."""
    layout = TRACKED_ITEMS[kind]
    if not content or len(content) % layout.itemsize:
        raise ValueError(f"{len(content)} bytes")
    items: NDArray[np.void] = np.frombuffer(content, dtype=layout)
    names = [text(name) or device for name in items["name"].tolist()]
    count = Counter(names)
    found = []
    for name, which, pose in zip(names, items["kind"].tolist(), doubles(items["pose"]), strict=True):
        of_matrix = kind == "TDATA"
        place = pose[9:] if of_matrix else pose[:3]
        matrix = matrix_of(pose) if of_matrix else quaternion_pose(pose[[6, 3, 4, 5]], place)
        known = TRACKED_STATUS.get(which, f"a tool of type {which}, which OpenIGTLink does not know")
        status = known if count[name] == 1 else NAMED_TWICE
        found.append(Tracked(name, place, matrix, which == PLACE_ONLY, status))
    return found
