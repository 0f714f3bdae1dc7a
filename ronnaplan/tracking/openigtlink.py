"""Live readings over OpenIGTLink (http://openigtlink.org/protocols): POINT, TRANSFORM and POSITION messages.

pyigtl unpacks the messages; its client keeps only the newest message of a device, so the socket is read here and
nothing is lost. Its POSITION layout is not the protocol's (seven float32), so both layouts are understood here.
"""

from __future__ import annotations

import math
import socket
import struct
import time

import numpy as np
from pyigtl.messages import CRC64, MessageBase, PointMessage, TransformMessage

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import as_pose
from ronnaplan.tracking.recording import OK, PointReading, Recording, ToolReading, quaternion_pose

DEFAULT_PORT = 18944
SILENCE_S = 2.0
"""Without a message for this long, the stream is said to have stopped."""
LARGEST_BODY = 1 << 26
"""A longer message body (64 MB) is not tracker data but a lost byte count."""
POLL_S = 0.1
POSITION_ITEM = struct.Struct(">64s32s4B8f20s")


def record(host: str, port: int = DEFAULT_PORT, *, seconds: float = 5.0) -> Recording:
    """Record all POINT, TRANSFORM and POSITION messages a server at ``host`` sends within ``seconds``.

    A POINT message is one tracker frame of (labelled or stray) markers; TRANSFORM and POSITION are a tool's pose,
    named by its device. If the stream stops or breaks, what came until then is returned, with a note that says so.
    Raises `InputError` if no server answers or no message arrives at all.
    """
    if not math.isfinite(seconds) or seconds <= 0:
        raise InputError(f"{seconds} seconds were asked for; expected a time above zero")
    try:
        connection = socket.create_connection((host, port), timeout=SILENCE_S)
    except (OSError, OverflowError, UnicodeError) as error:
        raise InputError(
            f"no OpenIGTLink server answers at {host}:{port} ({error}); start it, check host and port"
        ) from error
    stream = _Stream()
    with connection:
        connection.settimeout(POLL_S)
        note = _receive(connection, stream, time.monotonic() + seconds)
    if not stream.messages:
        raise InputError(f"{host}:{port} sent no readable message in {seconds:g} s{f' ({note})' if note else ''}")
    notes = stream.notes + ([note] if note else [])
    return Recording(f"openigtlink://{host}:{port}", tuple(stream.points), tuple(stream.tools), notes=tuple(notes))


def _receive(connection: socket.socket, stream: _Stream, until: float) -> str | None:
    """Feed ``stream`` until the time is up; return why it ended early, if it did."""
    last = time.monotonic()
    while time.monotonic() < until:
        try:
            data = connection.recv(1 << 16)
        except TimeoutError:
            if time.monotonic() - last > SILENCE_S:
                return f"the stream stopped: silent for {SILENCE_S:g} s after {stream.messages} messages"
            continue
        except OSError as error:
            return f"the connection broke after {stream.messages} messages ({error})"
        if not data:
            rest = " in the middle of a message" if stream.pending else ""
            return f"the server closed the stream after {stream.messages} messages{rest}"
        last = time.monotonic()
        stream.feed(data)
        if stream.broken:
            return stream.broken
    return None


class _Stream:
    """Cuts the bytes of a connection into messages and collects their readings."""

    def __init__(self) -> None:
        self.points: list[PointReading] = []
        self.tools: list[ToolReading] = []
        self.notes: list[str] = []
        self.messages = 0
        self.broken: str | None = None
        self._buffer = bytearray()
        self._point_frames = 0
        self._tool_frames: dict[str, int] = {}

    @property
    def pending(self) -> bool:
        return bool(self._buffer)

    def feed(self, data: bytes) -> None:
        self._buffer += data
        size = MessageBase.IGTL_HEADER_SIZE
        while len(self._buffer) >= size and not self.broken:
            try:
                header = MessageBase.parse_header(bytes(self._buffer[:size]))
            except (ValueError, struct.error) as error:
                self.broken = f"the stream is not OpenIGTLink ({error}) after {self.messages} messages"
                return
            length = int(header["body_size"])
            if length > LARGEST_BODY:
                self.broken = (
                    f"the stream is not OpenIGTLink: a body of {length} bytes after {self.messages} messages"
                )
                return
            if len(self._buffer) < size + length:
                return
            checksum = struct.unpack(">Q", self._buffer[size - 8 : size])[0]
            body = bytes(self._buffer[size : size + length])
            del self._buffer[: size + length]
            self._take(header, body, checksum)

    def _take(self, header: dict[str, object], body: bytes, checksum: int) -> None:
        kind, device = str(header["message_type"]), str(header["device_name"])
        unpack = {"POINT": self._take_points, "TRANSFORM": self._take_transform, "POSITION": self._take_position}
        if kind not in unpack:
            return
        if checksum not in (0, CRC64(body)):
            self.notes.append(f"a {kind} message of {device} failed its checksum and was left out")
            return
        try:
            unpack[kind](header, body, device, float(str(header["timestamp"])))
        except (ValueError, TypeError, struct.error, IndexError) as error:
            self.notes.append(f"a {kind} message of {device} cannot be read ({error}) and was left out")
            return
        self.messages += 1

    def _take_points(self, header: dict[str, object], body: bytes, device: str, time_s: float) -> None:
        message = PointMessage()
        message.unpack(header, body)
        for name, position in zip(message.names, message.positions, strict=True):
            place = np.array(position, dtype=np.float64)
            status = OK if np.isfinite(place).all() else "no position"
            self.points.append(PointReading(self._point_frames, place, name, time_s, None, status))
        self._point_frames += 1

    def _take_transform(self, header: dict[str, object], body: bytes, device: str, time_s: float) -> None:
        message = TransformMessage()
        message.unpack(header, body)
        try:
            self._add_pose(device, as_pose(message.matrix), time_s, OK)
        except InputError as error:
            self._add_pose(device, None, time_s, f"no pose: {error}")

    def _take_position(self, header: dict[str, object], body: bytes, device: str, time_s: float) -> None:
        message = MessageBase()
        content: list[bytes] = []
        message._unpack_content = content.append
        message.unpack(header, body)
        for name, position, quaternion in _positions(content[0]):
            matrix = quaternion_pose(quaternion, position)
            self._add_pose(name or device, matrix, time_s, OK if matrix is not None else "no pose")

    def _add_pose(self, tool: str, matrix: FloatArray | None, time_s: float, status: str) -> None:
        frame = self._tool_frames.get(tool, 0)
        self._tool_frames[tool] = frame + 1
        self.tools.append(ToolReading(frame, tool, matrix, time_s, None, status))


def _positions(content: bytes) -> list[tuple[str, FloatArray, FloatArray]]:
    """Return (name, position, scalar-first quaternion) of a POSITION body, in either layout."""
    if len(content) in (12, 24, 28):
        values = np.frombuffer(content, dtype=">f4").astype(np.float64)
        if len(values) == 3:
            quaternion = np.array([1.0, 0, 0, 0])
        elif len(values) == 6:  # the protocol leaves out the scalar part, which is not negative
            quaternion = np.array([math.sqrt(max(0.0, 1.0 - float(values[3:] @ values[3:]))), *values[3:]])
        else:
            quaternion = values[[6, 3, 4, 5]]
        return [("", values[:3], quaternion)]
    if not content or len(content) % POSITION_ITEM.size:
        raise ValueError(f"a body of {len(content)} bytes")
    found = []
    for item in POSITION_ITEM.iter_unpack(content):
        numbers = np.array(item[6:13], dtype=np.float64)
        name = item[0].decode().rstrip(" \0")
        found.append((name, numbers[:3], numbers[[6, 3, 4, 5]]))
    return found
