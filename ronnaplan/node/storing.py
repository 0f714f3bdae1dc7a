"""C-STORE requests: from the bytes of a connection to a file, and the answer to them.

pynetdicom copies each fragment five times, moves it between two threads, and parses each command with a general parser:
several times the work of this module, which reads requests to store by itself (PS3.7, 9.3.1; PS3.8, 9.3.5) and leaves
every other message to pynetdicom.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol, cast

from pynetdicom.pdu_primitives import P_DATA

from ronnaplan.node.spool import Spool

if TYPE_CHECKING:
    from pynetdicom.association import Association

PDU_HEADER: Final = struct.Struct(">BxL")
FRAGMENT_HEADER: Final = struct.Struct(">LBB")
ELEMENT_HEADER: Final = struct.Struct("<HHL")
DATA_TRANSFER: Final = 0x04
IS_COMMAND, IS_LAST = 1, 2
"""Bits of a fragment's control header."""

SOP_CLASS, COMMAND, MESSAGE, ANSWERED_MESSAGE, HAS_DATA, STATUS, SOP_INSTANCE = (
    *(0x0002, 0x0100, 0x0110, 0x0120, 0x0800, 0x0900, 0x1000),
)
"""Elements of a command, all of group 0."""

STORE, STORED, NO_DATA = 0x0001, 0x8001, 0x0101
LARGEST_COMMAND: Final = 1 << 16
LONGEST_UID: Final = 64
CLOSED, INVALID_PDU = "Evt17", "Evt19"
"""What pynetdicom's state machine is told (PS3.8, 9.2): the connection is closed, or its peer breaks the protocol."""
ESTABLISHED: Final = "Sta6"
"""Its state in which an association is ready for instances."""


@dataclass(frozen=True)
class Request:
    """A request to store an instance: what its sender says that it is."""

    context_id: int
    message_id: int
    sop_class: str
    sop_uid: str
    syntax: str


class Connection(Protocol):
    """What PDUs are read from, within bounds."""

    received: int
    """Bytes since the last whole message."""

    def peek(self, count: int) -> memoryview:
        """Return the next ``count`` bytes and leave them there; raises OSError where they do not come in time."""
        ...

    def take(self, count: int) -> memoryview:
        """Return the next ``count`` bytes, which stay there until the next call; raises OSError as `peek` does."""
        ...

    def send(self, bytestream: bytes) -> None:
        """Send what stands for a PDU."""
        ...


class Storage(Protocol):
    """Where instances go."""

    def begin(self, request: Request) -> Spool:
        """Return the file to write an instance to."""
        ...

    def end(self, association: Association, request: Request, spool: Spool) -> int:
        """Keep an instance that was received whole, or not; return the status that its sender is told."""
        ...

    def cut_off(self, association: Association) -> None:
        """Note that an instance was begun and never sent whole."""
        ...


class Storing:
    """Reads what a peer sends on one established association, in the thread that waits for it."""

    def __init__(self, association: Association, connection: Connection, storage: Storage) -> None:
        self._association, self._connection, self._storage = association, connection, storage
        self._others = association.dul._read_pdu_data
        self._command = b""
        self._request: Request | None = None
        self._spool: Spool | None = None
        association.dul._read_pdu_data = self._read  # type: ignore[method-assign]

    def close(self) -> None:
        """Remove a part of an instance that was never sent whole."""
        spool, self._request, self._spool = self._spool, None, None
        if spool is not None:
            spool.remove()
            self._storage.cut_off(self._association)

    def _read(self) -> None:
        """Read one PDU."""
        if self._association.dul.state_machine.current_state == ESTABLISHED:
            try:
                kind, length = PDU_HEADER.unpack(self._connection.peek(PDU_HEADER.size))
                if kind == DATA_TRANSFER:
                    self._connection.take(PDU_HEADER.size)
                    self._data(self._connection.take(length))
                    return
            except OSError:
                self._association.dul.event_queue.put(CLOSED)
                return
            except _InvalidError:
                self._association.dul.event_queue.put(INVALID_PDU)
                return
        self._others()

    def _data(self, content: memoryview) -> None:
        """Take the fragments of a P-DATA-TF PDU."""
        position = 0
        while position < len(content):
            if position + FRAGMENT_HEADER.size > len(content):
                raise _InvalidError
            length, context_id, control = FRAGMENT_HEADER.unpack_from(content, position)
            position, start = position + 4 + length, position + FRAGMENT_HEADER.size
            if length < 2 or position > len(content):
                raise _InvalidError
            self._fragment(context_id, control, content[start:position])

    def _fragment(self, context_id: int, control: int, content: memoryview) -> None:
        if control & IS_COMMAND:
            if self._request is not None or len(self._command) + len(content) > LARGEST_COMMAND:
                raise _InvalidError
            self._command += content
            if control & IS_LAST:
                command, self._command = self._command, b""
                self._begin(context_id, command)
        elif self._request is None or self._spool is None:
            self._leave(context_id, control, bytes(content))
        elif context_id != self._request.context_id:
            raise _InvalidError
        else:
            self._spool.write(content)
            if control & IS_LAST:
                self._end(self._request, self._spool)

    def _begin(self, context_id: int, command: bytes) -> None:
        """Begin with an instance; what is no request to store one is left to pynetdicom."""
        elements = elements_of(command)
        if number(elements, COMMAND) != STORE:
            self._leave(context_id, IS_COMMAND | IS_LAST, command)
            return
        context = self._association._accepted_cx.get(context_id)
        if context is None or number(elements, HAS_DATA) == NO_DATA:
            raise _InvalidError
        sop_class, sop_uid = (
            elements.get(tag, b"")[:LONGEST_UID].rstrip(b"\0 ").decode("ascii", "replace")
            for tag in (SOP_CLASS, SOP_INSTANCE)
        )
        if sop_class != context.abstract_syntax:
            raise _InvalidError
        syntax = str(context.transfer_syntax[0])
        self._request = Request(context_id, number(elements, MESSAGE), sop_class, sop_uid, syntax)
        self._spool = self._storage.begin(self._request)

    def _end(self, request: Request, spool: Spool) -> None:
        """Have an instance kept, and tell its sender."""
        self._association.dul._idle_timer.stop()  # the peer waits for us, not we for it
        status = self._storage.end(self._association, request, spool)
        self._request = self._spool = None
        self._connection.received = 0
        self._connection.send(answer(request, status))

    def _leave(self, context_id: int, control: int, content: bytes) -> None:
        """Give a fragment to pynetdicom."""
        primitive = P_DATA()
        primitive.presentation_data_value_list.append((context_id, bytes([control]) + content))
        self._association.dimse.receive_primitive(primitive)


class _InvalidError(Exception):
    """What the peer sends breaks the protocol."""


def elements_of(command: bytes) -> dict[int, bytes]:
    """Return the elements of a command by number, as far as it is well-formed."""
    found, position = {}, 0
    while position + ELEMENT_HEADER.size <= len(command):
        group, element, length = ELEMENT_HEADER.unpack_from(command, position)
        position += ELEMENT_HEADER.size
        if group == 0:
            found[element] = command[position : position + length]
        position += length
    return cast(dict[int, bytes], found)


def number(elements: dict[int, bytes], element: int) -> int:
    """Return a number of a command; 0 where there is none."""
    return int.from_bytes(elements.get(element, b"")[:2], "little")


def answer(request: Request, status: int) -> bytes:
    """Return the PDU that answers a request to store: C-STORE-RSP (PS3.7, 9.3.1.2)."""
    content = b"".join(
        _element(tag, value)
        for tag, value in (
            (SOP_CLASS, _even(request.sop_class)),
            (COMMAND, STORED.to_bytes(2, "little")),
            (ANSWERED_MESSAGE, request.message_id.to_bytes(2, "little")),
            (HAS_DATA, NO_DATA.to_bytes(2, "little")),
            (STATUS, status.to_bytes(2, "little")),
            (SOP_INSTANCE, _even(request.sop_uid)),
        )
    )
    content = _element(0, len(content).to_bytes(4, "little")) + content
    fragment = FRAGMENT_HEADER.pack(len(content) + 2, request.context_id, IS_COMMAND | IS_LAST) + content
    return PDU_HEADER.pack(DATA_TRANSFER, len(fragment)) + fragment


def _element(tag: int, value: bytes) -> bytes:
    return ELEMENT_HEADER.pack(0, tag, len(value)) + value


def _even(uid: str) -> bytes:
    content = uid.encode("ascii", "replace")
    return content + b"\0" * (len(content) % 2)
