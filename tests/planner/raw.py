"""HTTP and web-socket bytes as they are, so that wrong ones can be sent, too."""

from __future__ import annotations

import base64
import os
import socket
import struct
from typing import Any

import msgpack

from tests.planner.pages import HELLO, request

BINARY, CLOSE = 2, 8


def framed(content: bytes, *, opcode: int = BINARY, last: bool = True, claimed: int | None = None) -> bytes:
    """One masked web-socket frame as a browser sends it; ``claimed`` is the length it says it has."""
    length = len(content) if claimed is None else claimed
    head = bytes([opcode | 0x80 * last])
    if length < 126:
        head += bytes([0x80 | length])
    elif length < 2**16:
        head += bytes([0x80 | 126]) + struct.pack(">H", length)
    else:
        head += bytes([0x80 | 127]) + struct.pack(">Q", length)
    mask = os.urandom(4)
    return head + mask + bytes(byte ^ mask[k % 4] for k, byte in enumerate(content))


def answered(address: tuple[str, int], request: bytes, wait_s: float) -> int:
    """Send an HTTP request; return the status of the answer, 0 where the connection is closed without any.

    Raises `TimeoutError` where neither happens: the request may be one that is not complete.
    """
    with socket.create_connection(address, wait_s) as connection:
        try:
            connection.sendall(request)
            start = connection.recv(64)
        except ConnectionError:
            return 0
    return int(start.split()[1]) if start.startswith(b"HTTP/") else 0


def _sound(answer: dict[str, Any]) -> dict[str, Any]:
    data = answer.get("error", {}).get("data", {})
    assert not isinstance(data, dict) or "trace" not in data, data["trace"]
    return dict(answer.get("result") or {})


class RawSocket:
    """One web socket, open until either side closes it."""

    def __init__(self, address: tuple[str, int], token: str, wait_s: float) -> None:
        host, self.wait_s = f"{address[0]}:{address[1]}", wait_s
        self._connection = socket.create_connection(address, wait_s)
        self._connection.sendall(
            f"GET /ws?token={token} HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
            "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Key: {base64.b64encode(os.urandom(16)).decode()}\r\n\r\n".encode()
        )
        self._unread = b""
        while b"\r\n\r\n" not in self._unread:
            self._fill()
        head, _, self._unread = self._unread.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 101"), head
        self.send(framed(HELLO))
        self.send(framed(request("trame.state.get", number="rpc:begin")))

    def send(self, data: bytes) -> None:
        self._connection.sendall(data)

    def close(self) -> None:
        self._connection.close()

    def message(self) -> dict[str, Any]:
        """Return the next whole message of the planner; raises `ConnectionError` once the connection is closed."""
        content = b""
        while True:
            opcode, part = self._frame()
            if opcode == CLOSE:
                raise ConnectionResetError("closed")
            if opcode == BINARY:
                content += part[12:]
                if len(content) >= int.from_bytes(part[8:12], "little"):
                    return dict(msgpack.unpackb(content))

    def act(self, name: str, *arguments: Any) -> bool:
        """Ask for an action of the planner; return whether it was done, and not refused in a sentence."""
        self.send(framed(request("trame.trigger", name, list(arguments), {}, number="rpc:act")))
        return self.is_done("rpc:act")

    def is_done(self, *numbers: str) -> bool:
        """Read until requests ``numbers`` and one more are answered: what they changed is told before that.

        Raises `AssertionError` for an answer that holds a traceback.
        """
        done = True
        for number in (*numbers, "rpc:next", "rpc:last"):
            if number not in numbers:
                self.send(framed(request("trame.lifecycle.update", "client_unmounted", number=number)))
            while (answer := self.message()).get("id") != number:
                done &= "refusals" not in _sound(answer)
            _sound(answer)
        return done

    def _frame(self) -> tuple[int, bytes]:
        first, length = self._take(2)
        if length == 126:
            (length,) = struct.unpack(">H", self._take(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self._take(8))
        return first & 15, self._take(length)

    def _take(self, count: int) -> bytes:
        while len(self._unread) < count:
            self._fill()
        taken, self._unread = self._unread[:count], self._unread[count:]
        return taken

    def _fill(self) -> None:
        self._connection.settimeout(self.wait_s)
        received = self._connection.recv(1 << 20)
        if not received:
            raise ConnectionResetError("closed")
        self._unread += received
