"""pynetdicom's server, made to last: bounded connections and messages, and no peer that others must wait for."""

from __future__ import annotations

import gc
import logging
import socket
import ssl
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from socketserver import BaseServer
from types import SimpleNamespace
from typing import Any

from pynetdicom import _config, evt, timer
from pynetdicom.ae import ApplicationEntity
from pynetdicom.association import Association
from pynetdicom.events import EventHandlerType
from pynetdicom.fsm import AA_4
from pynetdicom.presentation import PresentationContext
from pynetdicom.transport import AssociationSocket, RequestHandler, ThreadedAssociationServer

from ronnaplan.ct.limits import MIB
from ronnaplan.node.storing import CLOSED, Storage, Storing
from ronnaplan.node.waking import LONGEST_SLEEP_S, Bell, let_sleep

LARGEST_PDU = 128 << 10
"""Bytes of a P-DATA PDU, as offered to peers; dcmtk's largest."""
LARGEST_REQUEST = MIB
"""Bytes of any other PDU: 128 presentation contexts take some tens of kilobytes."""
PENDING_PER_ASSOCIATION = 2
"""Connections open at one time for each association that may be: those above the limit are told so."""
COLLECT_S = 60.0
PART_S, LOOK_S = 5.0, 0.02
"""So long a server that ends waits at most for its threads, and so often it looks for them."""
_BEYOND = 4096
"""Room for the next PDU's beginning behind a whole one."""


def give_up_waiting(association: Association) -> None:
    """Have who waits for what a peer asks or answers beside messages wait no more, as where its connection is gone."""
    requests: Any = association.dul.to_user_queue  # typed for requests only
    requests.put(None)  # what a wait that ended in vain returns


def titles(association: Association) -> tuple[str, str]:
    """Return the calling and the called title of an association; nothing for what never became one."""
    request = association.requestor.primitive
    if request is None:
        return "", ""
    return str(request.calling_ae_title).strip(), str(request.called_ae_title).strip()


@cache
def set_up_pynetdicom() -> None:
    """Keep pynetdicom from messages of its own, which hold what peers send, and from loading whole what it sends.

    And have it tell how long a peer is silent by a clock that nobody sets.
    """
    timer.time = SimpleNamespace(time=time.monotonic)  # type: ignore[attr-defined, assignment]
    _config.LOG_HANDLER_LEVEL = "none"
    _config.STORE_SEND_CHUNKED_DATASET = True
    logger = logging.getLogger("pynetdicom")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False


def end_at_fault(association: Association) -> None:
    """Have an association end where its peer breaks the protocol in a way that pynetdicom does not know.

    The thread that speaks with the peer would end with a traceback, and nobody hear that the connection is gone.
    """
    provider = association.dul
    act = provider.state_machine.do_action

    def act_or_end(event: str) -> None:
        try:
            act(event)
        except Exception:  # an order of messages, or a value in one, that the standard does not have
            if provider.socket is not None:
                provider.socket.close()
            AA_4(provider)  # tells whoever waits for the peer's next message that it is gone

    provider.state_machine.do_action = act_or_end  # type: ignore[method-assign]


class BoundedSocket(AssociationSocket):
    """Reads whole PDUs, of a bounded size, within a bounded time; as much at once as there is."""

    silent_s: float
    most_bytes: int
    bell: Bell
    received: int = 0
    """Bytes since the last whole message."""

    def __init__(self, association: Association, client_socket: socket.socket) -> None:
        super().__init__(association, client_socket=client_socket)
        self._buffer = bytearray(LARGEST_PDU + _BEYOND)
        self._begin = self._end = 0  # of what was read and not taken yet

    @property
    def ready(self) -> bool:
        """Whether there is something to read; where there is nothing to do at all, after some waiting."""
        connection = self.socket
        if connection is None or not self._is_connected:
            return False
        if self._begin < self._end or (isinstance(connection, ssl.SSLSocket) and connection.pending()):
            return True
        try:
            return self.bell.wait(connection, LONGEST_SLEEP_S if self.event_queue.empty() else 0.0)
        except (OSError, ValueError):  # closed
            self.event_queue.put(CLOSED)
            return False

    def peek(self, count: int) -> memoryview:
        """See `Connection`."""
        if self._fill(count) < count:
            raise ConnectionError("the peer ended amid a PDU")
        return memoryview(self._buffer)[self._begin : self._begin + count]

    def take(self, count: int) -> memoryview:
        """See `Connection`."""
        self.received += count
        if count > LARGEST_REQUEST or self.received > self.most_bytes:
            raise OSError("the peer sends more than it may")
        found = self.peek(count)
        self._begin += count
        return found

    def recv(self, nr_bytes: int) -> bytearray:
        """Read ``nr_bytes`` for pynetdicom, fewer where the peer ends; raises OSError for too many or too slow ones."""
        with suppress(ConnectionError):
            return bytearray(self.take(nr_bytes))
        return bytearray()

    def _fill(self, count: int) -> int:
        """Wait for ``count`` bytes; return how many there are."""
        if self._begin + count > len(self._buffer) or self._begin == self._end:
            left = bytes(memoryview(self._buffer)[self._begin : self._end])
            if count > len(self._buffer):
                self._buffer = bytearray(count)
            self._buffer[: len(left)] = left
            self._begin, self._end = 0, len(left)
        last = time.monotonic() + self.silent_s
        while self._end - self._begin < count and self.socket is not None:
            self.socket.settimeout(max(last - time.monotonic(), 0.01))
            read = self.socket.recv_into(memoryview(self._buffer)[self._end :])
            if read == 0:
                break
            self._end += read
        return self._end - self._begin


class Handler(RequestHandler):
    """Gives every association a `BoundedSocket`."""

    server: Server

    def _create_association(self) -> Association:
        association = super()._create_association()
        association.dul.event_queue.get_nowait()  # the first socket's "connected", which the second one tells, too
        bounded = BoundedSocket(association, self.request)
        bounded.silent_s, bounded.most_bytes = self.server.silent_s, self.server.most_bytes
        bounded.bell = bell = Bell()
        let_sleep(association, bell)
        association.dul.socket = bounded
        end_at_fault(association)
        if self.server.storage is not None:
            storing = Storing(association, bounded, self.server.storage)
            association.bind(evt.EVT_CONN_CLOSE, lambda _: storing.close())
        association.bind(evt.EVT_CONN_CLOSE, lambda _: bell.close())
        weakref.finalize(bounded, bell.close)  # where nothing tells that the connection was closed
        return association


class Server(ThreadedAssociationServer):
    """Takes connections from allowed addresses, so many at a time; none is waited for.

    ``refuse`` is told the address and the reason of each that is turned away. Instances go to ``storage`` where there
    is one; pynetdicom's handlers get them otherwise.
    """

    daemon_threads = True
    request_queue_size = 128

    def __init__(
        self,
        entity: ApplicationEntity,
        address: tuple[str, int],
        title: str,
        contexts: list[PresentationContext],
        encrypted: ssl.SSLContext | None = None,
        evt_handlers: list[EventHandlerType] | None = None,
        *,
        allowed: Callable[[str], bool],
        refuse: Callable[[str, str], None],
        most_connections: int,
        silent_s: float,
        most_bytes: int,
        storage: Storage | None = None,
    ) -> None:
        self._allowed, self._refuse, self._most = allowed, refuse, most_connections
        self.silent_s, self.most_bytes, self.storage = silent_s, most_bytes, storage
        self._collect_due = 0.0
        self._begun: set[socket.socket] = set()  # connections that are no association yet
        super().__init__(entity, address, title, contexts, encrypted, evt_handlers, request_handler=Handler)

    def get_request(self) -> tuple[socket.socket, tuple[str, int]]:
        """Accept a connection; TLS is spoken later, in a thread of its own."""
        if self.socket is None:
            raise OSError("the server is closed")
        connection, address = self.socket.accept()
        connection.settimeout(self.silent_s)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection, address

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Whether a connection is taken."""
        reason = ""
        if not self._allowed(client_address[0]):
            reason = "no peer that may send has this address"
        elif len(self._begun) + len(self.active_associations) >= self._most:
            reason = f"{self._most} connections are open"
        if reason:
            self._refuse(client_address[0], reason)
        else:
            self._begun.add(request)
        return not reason

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection."""
        accepted = request
        if self.ssl_context is not None:
            try:
                request = self.ssl_context.wrap_socket(request, server_side=True)
            except (OSError, ssl.SSLError) as error:
                self._refuse(client_address[0], f"TLS could not be agreed on: {error}")
                self.shutdown_request(request)
                self._begun.discard(accepted)
                return
        super().process_request_thread(request, client_address)
        self._begun.discard(accepted)

    def service_actions(self) -> None:
        """Collect what ended associations left, a minute after the last time; pynetdicom does so every few seconds."""
        if time.monotonic() >= self._collect_due:
            gc.collect()
            self._collect_due = time.monotonic() + COLLECT_S

    def shutdown(self) -> None:
        """Stop, and let go of the port."""
        BaseServer.shutdown(self)  # pynetdicom's own expects a server that it started itself
        self.server_close()

    def part(self) -> None:
        """Close what connections there are, and wait until their threads have ended: the process would wait for them.

        Peers take what they are not told of for not kept.
        """
        last = time.monotonic() + PART_S
        while (left := self.active_associations) and time.monotonic() < last:
            for association in left:
                connection = association.dul.socket
                if connection is not None and connection.socket is not None:
                    with suppress(OSError):  # closed meanwhile; TLS' own would take its state from who reads now
                        socket.socket.shutdown(connection.socket, socket.SHUT_RDWR)
            time.sleep(LOOK_S)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say what went wrong with one connection in one line."""
        self._refuse(client_address[0], "it could not be served")
