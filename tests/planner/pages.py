"""The planner's page as far as its web socket goes, without a browser: sound requests and others."""

from __future__ import annotations

from typing import Any
from urllib.parse import urlsplit

import aiohttp
import msgpack

ANSWER_S = 120.0
"""How long to wait for an answer: far longer than any takes."""


def frame(content: bytes, *, offset: int = 0, size: int | None = None) -> bytes:
    """A message as wslink frames it: number, offset and size (4 bytes each), then the content."""
    claimed = len(content) if size is None else size
    return b"".join(number.to_bytes(4, "little") for number in (1, offset, claimed)) + content


def request(method: str, *arguments: Any, number: str = "rpc:1") -> bytes:
    return frame(
        msgpack.packb({"wslink": "1.0", "id": number, "method": method, "args": list(arguments), "kwargs": {}})
    )


HELLO = request("wslink.hello", {"secret": "wslink-secret"}, number="system:c0:0")


class Page:
    """One open web socket; use as ``async with``."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._address = f"ws://{parts.netloc}/ws?{parts.query}"

    async def __aenter__(self) -> Page:
        self._session = aiohttp.ClientSession()
        try:
            self.socket = await self._session.ws_connect(
                self._address, max_msg_size=0, timeout=aiohttp.ClientWSTimeout(ws_close=1.0)
            )
            await self.socket.send_bytes(HELLO)
            await self._answer("system:c0:0")
        except BaseException:
            await self._session.close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.socket.close()
        await self._session.close()

    async def ask(self, method: str, *arguments: Any) -> dict[str, Any]:
        """Return the answer to a request: a map with 'result' or 'error'."""
        await self.socket.send_bytes(request(method, *arguments))
        return await self._answer("rpc:1")

    async def trigger(self, name: str, *arguments: Any) -> dict[str, Any]:
        """Call an action of the planner."""
        return await self.ask("trame.trigger", name, list(arguments), {})

    async def state(self) -> dict[str, Any]:
        """Return all that the page is shown."""
        answer: dict[str, Any] = (await self.ask("trame.state.get"))["result"]["state"]
        return answer

    async def is_cut_off(self, sent: bytes | str) -> bool:
        """Send something; return whether the server then closes the connection."""
        await (self.socket.send_str(sent) if isinstance(sent, str) else self.socket.send_bytes(sent))
        closing = (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.ERROR)
        while (await self.socket.receive(ANSWER_S)).type not in closing:
            pass
        return True

    async def _answer(self, number: str) -> dict[str, Any]:
        content, size = b"", 1
        while True:
            part = (await self.socket.receive(ANSWER_S)).data
            assert isinstance(part, bytes), part
            size, content = int.from_bytes(part[8:12], "little"), content + part[12:]
            if len(content) < size:
                continue
            answer, content = msgpack.unpackb(content), b""
            if answer["id"] == number:
                return dict(answer)
