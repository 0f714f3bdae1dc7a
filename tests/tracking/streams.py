"""OpenIGTLink messages that pyigtl does not pack: several tools in one."""

import struct
from collections.abc import Mapping, Sequence

import numpy as np
from pyigtl.messages import CRC64


def named(kind: str, device: bytes, body: bytes, version: int = 1, time_s: int = 3) -> bytes:
    return struct.pack(">H12s20sIIQQ", version, kind.encode(), device, time_s, 0, len(body), CRC64(body)) + body


def tool_items(tools: Sequence[tuple[str, int, np.ndarray]]) -> bytes:
    """Pack names, types and matrices as in a TDATA message."""
    return b"".join(
        struct.pack(">20sBB12f", name.encode(), kind, 0, *matrix[:3].T.ravel()) for name, kind, matrix in tools
    )


def tools_of_plus(tools: Mapping[str, tuple[int, np.ndarray]], metadata: Mapping[str, str]) -> bytes:
    """Pack a TDATA message of version 2, as PLUS sends it."""
    head = struct.pack(">H", len(metadata)) + b"".join(
        struct.pack(">HHI", len(key), 3, len(value)) for key, value in metadata.items()
    )
    data = "".join(key + value for key, value in metadata.items()).encode()
    extended = struct.pack(">HHII", 12, len(head), len(data), 0)
    items = tool_items([(name, *tool) for name, tool in tools.items()])
    return named("TDATA", b"TrackedFrame", extended + items + head + data, 2)


def quaternions_of_tools(tools: Mapping[str, tuple[int, Sequence[float]]]) -> bytes:
    """Pack a QTDATA message: of each tool its type, place and quaternion, the scalar last."""
    items = [struct.pack(">20sBB7f", name.encode(), kind, 0, *numbers) for name, (kind, numbers) in tools.items()]
    return named("QTDATA", b"Tracker", b"".join(items))
