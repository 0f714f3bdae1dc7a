"""Associations that the node asks for end whatever the other side does, and in whatever moment."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from pydicom.dataset import Dataset
from pydicom.uid import CTImageStorage
from pynetdicom import AE, evt

from ronnaplan.errors import InputError
from ronnaplan.node.archives import FIND, GET, open_archive
from ronnaplan.node.association import associated
from ronnaplan.node.config import Config, Limits, Peer
from tests.ct import makers
from tests.node.peers import ODD_ABORT, Listening, associate, until

pytestmark = pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning"
)  # pynetdicom leaves sockets unclosed where the other side was quicker


def test_who_pauses_an_association_is_told_so_whatever_is_said_meanwhile(node: Listening) -> None:
    """pynetdicom serves a report in a third thread, which said that the association runs: all waited for ever."""
    entity = AE("CT1")
    entity.add_requested_context(CTImageStorage)
    association = associate(entity, node.port)
    held = association._reactor_checkpoint
    for paused in (True, False, True):
        if paused:
            held.clear()
        else:
            held.set()
        until(lambda paused=paused: association._is_paused == paused)  # type: ignore[misc]
        association._is_paused = not paused
        until(lambda paused=paused: association._is_paused == paused)  # type: ignore[misc]
    held.set()
    association.release()
    assert association.is_released


def test_no_answer_is_awaited_on_an_association_that_has_just_ended(node: Listening) -> None:
    """Who had looked a moment before whether it was there waited for `silent_s`."""
    entity = AE("CT1")
    entity.add_requested_context(CTImageStorage)
    association = associate(entity, node.port)
    node.receiver._server.part()  # type: ignore[union-attr]
    until(lambda: not association.is_alive())
    begun = time.monotonic()
    association.is_established = True
    assert "Status" not in association.send_c_store(makers.dataset(0))
    association.is_established = True
    association.release()
    assert time.monotonic() - begun < entity.acse_timeout / 2  # type: ignore[operator]


@pytest.mark.parametrize(
    ("answered", "passed_on"), [(0, 9999), (1, 9999), (9999, 1)], ids=["accepting", "answering", "reading"]
)
def test_a_receiver_that_falls_silent_amid_a_message_is_not_waited_for(answered: int, passed_on: int) -> None:
    """Nothing more was delivered to it until the node began anew."""
    entity, over = AE("PACS"), Event()
    entity.add_supported_context(CTImageStorage)
    archive = entity.start_server(("127.0.0.1", 0), block=False, evt_handlers=[(evt.EVT_C_STORE, lambda _: 0)])
    assert archive is not None

    def pass_on(messages: int, by: socket.socket, to: socket.socket) -> None:
        with suppress(OSError, struct.error):
            for _ in range(messages):
                head = by.recv(6, socket.MSG_WAITALL)
                (length,) = struct.unpack(">2xL", head)
                to.sendall(head + by.recv(length, socket.MSG_WAITALL))
            to.sendall(by.recv(3))
        over.wait()

    def stand_between() -> None:
        with server.accept()[0] as near, socket.create_connection(archive.server_address[:2]) as far:
            back = Thread(target=pass_on, args=(answered, far, near))
            back.start()
            pass_on(passed_on, near, far)
            far.shutdown(socket.SHUT_RDWR)
            back.join()

    with socket.create_server(("127.0.0.1", 0)) as server:
        between = Thread(target=stand_between)
        between.start()
        peer = Peer(name="pacs", title="PACS", port=server.getsockname()[1])
        made = makers.dataset(0, stored=np.zeros((3000, 3000), np.int16))
        with (
            suppress(InputError),  # where it never says that it accepts
            associated(Config(limits=Limits(silent_s=1.0)), peer, [CTImageStorage]) as association,
        ):
            assert "Status" not in association.send_c_store(made)
        over.set()
        between.join()
        archive.shutdown()


def test_an_archive_that_breaks_the_protocol_in_an_odd_way_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with server.accept()[0] as peer:
                peer.recv(1 << 16)
                peer.sendall(ODD_ABORT)

        thread = Thread(target=answer)
        thread.start()
        archive = Peer(name="pacs", port=server.getsockname()[1])
        with (
            pytest.raises(InputError, match=r"pacs .* cannot be reached, or speaks no DICOM; check its address"),
            associated(Config(), archive, [CTImageStorage]),
        ):
            pass
        thread.join()


def test_an_archive_that_breaks_the_protocol_while_it_answers_is_not_waited_for() -> None:
    def breaks(event: evt.Event) -> Iterator[tuple[int, None]]:
        event.assoc.dul.socket.send(ODD_ABORT)  # type: ignore[union-attr]
        done.wait()
        yield 0, None

    done, entity = Event(), AE("PACS")
    for uid in (FIND, GET):
        entity.add_supported_context(uid)
    server = entity.start_server(("127.0.0.1", 0), block=False, evt_handlers=[(evt.EVT_C_FIND, breaks)])
    assert server is not None
    archive = Peer(name="pacs", title="PACS", port=server.server_address[1])
    begun = time.monotonic()
    try:
        with (
            pytest.raises(InputError, match="pacs answered nothing more"),
            open_archive(Config(), archive) as opened,
        ):
            opened.find("STUDY", {"StudyInstanceUID": "", "PatientID": "P-1"})
    finally:
        done.set()
        server.shutdown()
    assert time.monotonic() - begun < Limits().silent_s / 2


def test_who_is_interrupted_does_not_wait_for_an_archive_that_is_busy() -> None:
    def be_busy(_: evt.Event) -> Iterator[tuple[int, None]]:
        asked.set()
        done.wait()
        yield 0, None

    asked, done, entity = Event(), Event(), AE("PACS")
    entity.add_supported_context(FIND)
    server = entity.start_server(("127.0.0.1", 0), block=False, evt_handlers=[(evt.EVT_C_FIND, be_busy)])
    assert server is not None
    archive = Peer(name="pacs", title="PACS", port=server.server_address[1])
    wanted, begun = Dataset(), time.monotonic()
    wanted.QueryRetrieveLevel, wanted.PatientID = "STUDY", "P-1"
    try:
        with suppress(KeyboardInterrupt), associated(Config(), archive, [FIND]) as association:
            association.send_c_find(wanted, FIND)
            assert asked.wait(60)
            raise KeyboardInterrupt
    finally:
        done.set()
        server.shutdown()
    assert time.monotonic() - begun < Limits().silent_s / 2


@pytest.mark.parametrize(
    ("asked", "ask", "bound", "says"),
    [
        (
            evt.EVT_C_FIND,
            lambda archive, _: archive.find("STUDY", {"StudyInstanceUID": ""}),
            "archives.MOST_INSTANCES",
            "has more matches than it tells, or tells no end of them",
        ),
        (
            evt.EVT_C_GET,
            lambda archive, folder: archive.fetch([makers.STUDY], folder),
            "arrivals.MOST_COPIES",
            "sent what is not kept: instances come without end",
        ),
    ],
    ids=["C-FIND", "C-GET"],
)
def test_an_archive_that_tells_matches_or_sends_instances_without_end_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: Any, ask: Any, bound: str, says: str
) -> None:
    match = Dataset()
    match.StudyInstanceUID = makers.STUDY

    def endless(event: evt.Event) -> Iterator[Any]:
        if asked is evt.EVT_C_GET:
            yield 100
        while event.assoc.is_established:
            yield 0xFF00, makers.dataset(0) if asked is evt.EVT_C_GET else match

    entity = AE("PACS")
    for uid in (FIND, GET, CTImageStorage):
        entity.add_supported_context(uid, scu_role=True, scp_role=True)
    server = entity.start_server(("127.0.0.1", 0), block=False, evt_handlers=[(asked, endless)])
    assert server is not None
    archive = Peer(name="pacs", title="PACS", port=server.server_address[1])
    monkeypatch.setattr(f"ronnaplan.node.{bound}", 3)
    begun = time.monotonic()
    try:
        with pytest.raises(InputError, match=f"pacs {says}"), open_archive(Config(), archive) as opened:
            ask(opened, tmp_path)
    finally:
        server.shutdown()
    assert time.monotonic() - begun < Limits().silent_s / 2
