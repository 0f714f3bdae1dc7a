"""What a page may send through the web socket, and what is held for a page that does not listen.

wslink believes the size that a message's header claims, lets a page end the server, and lets one page that stops
reading hold up all others. Here a message is one frame of limited size, a page may ask only for what our page asks for,
and each page has a limited queue of its own.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from functools import partial
from typing import Any, Final, Protocol

import msgpack
from aiohttp import WSCloseCode, web
from wslink.backends.aiohttp import AioHttpWsHandler
from wslink.chunking import HEADER_LENGTH, generate_chunks
from wslink.protocol import MAX_MSG_SIZE

MOST_MESSAGE_BYTES: Final = 2**18
"""A page sends a few hundred bytes; the longest thing it may hold is a trajectory's notes."""

MOST_WAITING_BYTES: Final = 2**25
"""Some tens of whole redraws: a page that is so far behind has stopped reading, and is cut off."""

SLOWEST_SEND_S: Final = 60.0
"""A page that takes a chunk no faster is cut off, and has to be loaded again."""

MOST_PAGES: Final = 20
"""Pages open at the same time."""


def _is_trigger(name: Any = None, arguments: Any = None, named: Any = None) -> bool:
    sound_name = isinstance(name, str) and re.fullmatch(r"\w{1,40}", name, re.ASCII) is not None
    return sound_name and isinstance(arguments, list) and named == {}


def _is_update(changes: Any = None) -> bool:
    return isinstance(changes, list) and all(
        isinstance(change, dict) and isinstance(change.get("key"), str) for change in changes
    )


LIFE: Final = ("client_connected", "client_unmounted", "client_exited")

REQUESTS: Final[Mapping[str, Callable[..., bool]]] = {
    "trame.state.get": lambda: True,
    "trame.state.update": _is_update,
    "trame.trigger": _is_trigger,
    "trame.lifecycle.update": lambda name=None: name in LIFE,
    "trame.error.client": lambda message=None: isinstance(message, str),
    "wslink.hello": lambda known=None: isinstance(known, dict) and isinstance(known.get("secret"), str),
}
"""What our page asks for: method -> whether its arguments are of the right kind."""


def read_request(frame: bytes) -> dict[str, Any]:
    """Return the request in one frame: twelve bytes that say how long it is, then a msgpack map.

    Raises `ValueError` for anything that our page does not send.
    """
    content = frame[HEADER_LENGTH:]
    offset, size = (int.from_bytes(frame[start : start + 4], "little") for start in (4, 8))
    if len(content) > MOST_MESSAGE_BYTES or offset != 0 or size != len(content):
        raise ValueError(f"expected one whole message of {MOST_MESSAGE_BYTES} bytes at most")
    try:
        request = msgpack.unpackb(content)
    except ValueError as error:
        raise ValueError("expected msgpack") from error
    if not isinstance(request, dict) or not isinstance(request.get("id"), str):
        raise ValueError("expected a map with the text 'id'")
    arguments = request.get("args", [])
    allowed = REQUESTS.get(str(request.get("method")))
    if allowed is None or not isinstance(arguments, list) or request.get("kwargs") not in (None, {}):
        raise ValueError("expected a request that the planner's page makes")
    try:
        sound = allowed(*arguments)
    except TypeError as error:
        raise ValueError("expected another number of arguments") from error
    if not sound:
        raise ValueError("expected arguments of another kind")
    return request


class Outbox:
    """What one page is still to be sent. Whoever sends does not wait for the page."""

    def __init__(self, socket: web.WebSocketResponse, cut_off: Callable[[], None]) -> None:
        """Send to ``socket`` until it is closed; ``cut_off`` ends the connection without a word."""
        self._socket, self._cut_off = socket, cut_off
        self._chunks: asyncio.Queue[bytes] = asyncio.Queue()
        self._waiting_bytes = 0
        self._sending = asyncio.ensure_future(self._send())

    @property
    def closed(self) -> bool:
        """Whether nothing more can be sent."""
        return self._socket.closed

    async def send_bytes(self, chunk: bytes) -> None:
        """Queue ``chunk``, as wslink asks for it."""
        self.put(chunk)

    def put(self, chunk: bytes) -> None:
        """Queue ``chunk``; a page that has too much waiting is cut off."""
        if self._sending.done():
            return
        self._waiting_bytes += len(chunk)
        if self._waiting_bytes > MOST_WAITING_BYTES:
            self.end()
            self._cut_off()
        else:
            self._chunks.put_nowait(chunk)

    async def close(self, **how: Any) -> None:
        """Close the connection as ``WebSocketResponse.close`` does."""
        await self._socket.close(**how)

    def end(self) -> None:
        """Send nothing more."""
        self._sending.cancel()

    async def _send(self) -> None:
        try:
            while True:
                chunk = await self._chunks.get()
                async with asyncio.timeout(SLOWEST_SEND_S):
                    await self._socket.send_bytes(chunk)
                self._waiting_bytes -= len(chunk)
        except (TimeoutError, ConnectionError):
            self._cut_off()


class Pages(Protocol):
    """What answers the pages: each is shown values of its own."""

    def opened(self, page: str, send: Callable[[dict[str, Any]], None]) -> None:
        """Begin with a page, to which ``send`` sends values."""

    def closed(self, page: str) -> None:
        """Forget a page."""

    def whole(self, page: str) -> dict[str, Any]:
        """Return all that a page shows of its own."""

    def changed(self, page: str, changes: list[dict[str, Any]]) -> None:
        """Take over what a page set itself."""


ASKING: Final[ContextVar[str]] = ContextVar("ASKING")
"""The page whose request is being answered."""

VALUES: Final = "publish:trame.state.topic:0"
"""What trame's client takes for new values."""


class Sockets(AioHttpWsHandler):  # type: ignore[misc]
    """wslink's connections to the pages, within limits; where trame has one state for all, each has its own here."""

    def __init__(self, pages: Pages, *given: Any) -> None:
        """Answer for ``pages``; all else is wslink's own."""
        super().__init__(*given)
        self._pages = pages

    async def handleWsRequest(self, request: web.Request) -> web.StreamResponse:  # noqa: N802, D102
        if len(self.connections) >= MOST_PAGES:
            raise web.HTTPServiceUnavailable(text=f"the planner is open in {MOST_PAGES} pages already; close one")
        if not web.WebSocketResponse().can_prepare(request):
            raise web.HTTPBadRequest(text="this address is for the page's web socket")
        response: web.StreamResponse = await super().handleWsRequest(request)
        return response

    async def onConnect(self, request: web.Request, client_id: str) -> None:  # noqa: N802, D102
        transport = request.transport
        cut_off = transport.abort if transport is not None else lambda: None
        self.connections[client_id] = Outbox(self.connections[client_id], cut_off)
        ASKING.set(client_id)
        self._pages.opened(client_id, partial(self._send_values, client_id))
        await super().onConnect(request, client_id)

    def _send_values(self, client_id: str, values: dict[str, Any]) -> None:
        if self.isClientAuthenticated(client_id):
            message = msgpack.packb({"wslink": "1.0", "id": VALUES, "result": values})
            for chunk in generate_chunks(message, MAX_MSG_SIZE):
                self.connections[client_id].put(chunk)

    async def onClose(self, client_id: str) -> None:  # noqa: N802, D102
        self.connections[client_id].end()
        self._pages.closed(client_id)
        await super().onClose(client_id)

    async def onMessage(self, is_binary: bool, msg: Any, client_id: str) -> None:  # noqa: N802, D102
        try:
            request = read_request(msg.data if is_binary else b"")
        except ValueError as error:
            reason = str(error).encode()[:120]
            await self.connections[client_id].close(code=WSCloseCode.POLICY_VIOLATION, message=reason)
            return
        if request["method"] == "trame.state.update" and self.isClientAuthenticated(client_id):
            self._pages.changed(client_id, request["args"][0])
            await self.sendWrappedMessage(request["id"], None, client_id=client_id)
            return
        with self.network_monitor:
            await self.onCompleteMessage(request, client_id)

    async def sendWrappedMessage(  # noqa: N802
        self, rpcid: str, content: Any, method: str = "", client_id: str | None = None, **how: Any
    ) -> None:
        """Send an answer; all values of a page hold those of its own."""
        if method == "trame.state.get" and client_id is not None:
            content = {**content, "state": {**content["state"], **self._pages.whole(client_id)}}
        await super().sendWrappedMessage(rpcid, content, method, client_id, **how)

    def payloadWithSecretStripped(self, payload: Any) -> str:  # noqa: N802
        """Return what to log of a request: not a deep copy of it, which takes longer than to read it."""
        return str(payload.get("method"))
