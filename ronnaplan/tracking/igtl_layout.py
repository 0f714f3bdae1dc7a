"""How OpenIGTLink's messages of places and poses are laid out (http://openigtlink.org/protocols).

What stands around the body of each, what PLUS tells beside it (its metadata), and what the body holds.
"""

from __future__ import annotations

import math
import re
import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.text import printable
from ronnaplan.tracking.cells import stated_status
from ronnaplan.tracking.recording import OK, quaternion_pose

HEADER = struct.Struct(">H12s20sIIQQ")
EXTENDED_HEADER = struct.Struct(">HHII")
METADATA_ITEM = struct.Struct(">HHI")
POSE = "Transform"
"""Before ``Status`` and ``Valid``, the name of a message's pose in what PLUS tells of it; of several, their tools'."""
VERSIONS = (1, 2, 3)
KIND = re.compile(rb"[A-Za-z0-9_]+")
"""The type of a message; those that ask for another one, or answer that, begin with ``GET_``, ``STT_``, ``RTS_``."""
LARGEST_BODY = 1 << 26
"""A longer message body (64 MB) is not tracker data but a lost byte count."""
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


@dataclass(frozen=True)
class Message:
    """One message: its kind and device as printable text, its body's bytes."""

    kind: str
    device: str
    time_s: float
    version: int
    checksum: int
    length: int

    @classmethod
    def of_header(cls, header: bytes) -> Message:
        """Return the message that ``header`` (58 bytes) announces; raises ValueError for what is no such header."""
        version, kind, device, seconds, fraction, length, checksum = HEADER.unpack(header)
        bare = kind.split(b"\0")[0]
        if version not in VERSIONS or KIND.fullmatch(bare) is None:
            raise ValueError(f"a header of version {version} and type {printable(bare)}")
        if length > LARGEST_BODY:
            raise ValueError(f"a body of {length} bytes")
        return cls(bare.decode(), text(device), seconds + fraction / 2**32, version, checksum, length)

    def content(self, body: bytes) -> bytes:
        """Return ``body`` without the extended header and the metadata of versions 2 and 3."""
        return self._parts(body)[0]

    def metadata(self, body: bytes) -> dict[str, str]:
        """Return what ``body`` tells beside its content."""
        _, header, data = self._parts(body)
        told, at = {}, 0
        for item in range(int.from_bytes(header[:2])):
            key_size, _, value_size = METADATA_ITEM.unpack_from(header, 2 + item * METADATA_ITEM.size)
            middle, end = at + key_size, at + key_size + value_size
            told[text(data[at:middle])] = text(data[middle:end])
            at = end
        return told

    def _parts(self, body: bytes) -> tuple[bytes, bytes, bytes]:
        """Return the content of ``body``, the header of the metadata, and their keys and values."""
        if self.version == 1:
            return body, b"", b""
        size, metadata_header, metadata, _ = EXTENDED_HEADER.unpack_from(body)
        end, data = len(body) - metadata_header - metadata, len(body) - metadata
        if not EXTENDED_HEADER.size <= size <= end:
            raise ValueError("an extended header beyond the body")
        return body[size:end], body[end:data], body[data:]


def pose_status(metadata: Mapping[str, str], tool: str = POSE) -> str:
    """Return what a message's ``metadata`` say of the pose of ``tool``: `OK` where they say nothing."""
    # a truth value may be a byte that is no text
    valid = (metadata.get(f"{tool}Valid", "1") or "0").replace("\1", "1")
    return stated_status({"status": metadata.get(f"{tool}Status", ""), "valid": valid})


def doubles(floats: NDArray[np.void]) -> FloatArray:
    """Return numbers (...) of four bytes as ours."""
    with np.errstate(invalid="ignore"):  # of a signalling NaN, which becomes a quiet one
        return floats.astype(np.float64)


def positions(content: bytes) -> list[tuple[str, FloatArray, FloatArray]]:
    """Return (name, position (3,) in mm, scalar-first quaternion (4,)) of a POSITION body, in either layout."""
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
