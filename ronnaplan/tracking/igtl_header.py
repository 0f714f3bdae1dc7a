"""What stands around the body of each OpenIGTLink message, and what PLUS tells beside it (its metadata)."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from ronnaplan.text import printable
from ronnaplan.tracking.cells import stated_status
from ronnaplan.tracking.igtl_bodies import text

HEADER = struct.Struct(">H12s20sIIQQ")
EXTENDED_HEADER = struct.Struct(">HHII")
METADATA_ITEM = struct.Struct(">HHI")
POSE = "Transform"
"""Before ``Status`` and ``Valid``, the name of a message's pose in what PLUS tells of it; of several, their tools'."""
VERSIONS = (1, 2, 3)
LARGEST_BODY = 1 << 26
"""A longer message body (64 MB) is not tracker data but a lost byte count."""


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
        if version not in VERSIONS or not bare.isalnum():
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
