"""Who may send is let in; who hangs, floods or sends too much is cut off, and keeps no other waiting."""

from __future__ import annotations

import socket
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pytest
from pydicom.uid import CTImageStorage
from pynetdicom import AE

from ronnaplan.node.waking import LONGEST_SLEEP_S
from tests.ct import makers
from tests.long import few_and_others
from tests.node.peers import (
    ODD_ABORT,
    Listening,
    associate,
    association_request,
    instance,
    listening,
    needs,
    save,
    send,
    until,
)

pytestmark = needs("storescu", "echoscu")


def test_only_known_senders_get_in_and_only_by_the_node_s_name(node: Listening, tmp_path: Path) -> None:
    path = instance(tmp_path)
    assert "Calling AE Title Not Recognized" in send(node.port, path, calling="NOBODY")
    assert "Called AE Title Not Recognized" in send(node.port, path, called="OTHER")
    assert node.files() == []
    assert [one["reason"] for one in node.events("refused association")] == [
        "NOBODY is no peer that may send from there",
        "no AE title here is OTHER",
    ]


def test_an_address_that_no_sender_has_gets_no_answer(tmp_path: Path) -> None:
    elsewhere = {"name": "scanner", "title": "CT1", "host": "192.0.2.1", "sends": True}
    with listening(tmp_path, peer=[elsewhere]) as node, socket.create_connection(("127.0.0.1", node.port)) as peer:
        peer.settimeout(60)
        peer.sendall(association_request())
        assert _answer(peer) == b""
        assert "address" in node.events("refused association")[0]["reason"]


def _answer(peer: socket.socket) -> bytes:
    try:
        return peer.recv(100)
    except ConnectionResetError:
        return b""


@few_and_others(
    "begun",
    [association_request()[:40]],
    [b"", b"\x04\x00\x00\x00\x10\x00" + bytes(100)],
    ids=["half", "silent", "data"],
)
def test_a_peer_that_hangs_is_cut_off_and_others_are_served(begun: bytes, tmp_path: Path) -> None:
    with listening(tmp_path, limits={"silent_s": 2.0, "least_free_mib": 1}) as node:
        with socket.create_connection(("127.0.0.1", node.port)) as peer:
            peer.sendall(begun)
            assert "Success" in send(node.port, instance(tmp_path)) or node.files()
            peer.settimeout(60)
            while _answer(peer):
                pass
        until(lambda: not node.receiver._server.active_associations)  # type: ignore[union-attr]
        until(lambda: [one for one in node.events("cut off") if one["reason"] == "no association was asked for"])


def test_a_peer_that_falls_silent_is_cut_off(tmp_path: Path) -> None:
    with listening(tmp_path, limits={"silent_s": 2.0, "least_free_mib": 1}) as node:
        entity = AE("CT1")
        entity.add_requested_context(CTImageStorage)
        association = associate(entity, node.port)
        until(lambda: node.events("cut off"))
        assert node.events("cut off")[0]["reason"] == "nothing came for 2 s"
        assert node.events("cut off")[0]["calling"] == "CT1"
        until(lambda: association.is_aborted)


def test_a_message_begun_and_never_ended_leaves_nothing(tmp_path: Path) -> None:
    with listening(tmp_path, limits={"silent_s": 2.0, "least_free_mib": 1}) as node:
        entity = AE("CT1")
        entity.add_requested_context(CTImageStorage)
        association = associate(entity, node.port)
        sent: list[bytes] = []
        connection = association.dul.socket
        assert connection is not None
        whole = connection.send

        def half(content: bytes) -> None:
            if len(sent) < 2:
                sent.append(content)
                whole(content if len(sent) == 1 else content[: len(content) // 2])

        setattr(connection, "send", half)  # noqa: B010
        association.dimse_timeout = 3
        association.send_c_store(makers.dataset(0))
        association.abort()
        until(lambda: node.events("cut off"))
        assert not list((node.folder / "incoming").iterdir())
        assert node.files() == []


def test_a_peer_that_breaks_the_protocol_in_an_odd_way_leaves_nothing_open_and_what_it_sent_is_told(
    tmp_path: Path,
) -> None:
    with listening(tmp_path) as node:
        entity = AE("CT1")
        entity.add_requested_context(CTImageStorage)
        association = associate(entity, node.port)
        assert association.send_c_store(makers.dataset(0)).Status == 0
        connection = association.dul.socket
        assert connection is not None
        connection.send(ODD_ABORT)
        until(lambda: node.events("received"))
        until(lambda: not node.receiver._server.active_associations)  # type: ignore[union-attr]
        assert not node.receiver._moved
        until(lambda: association.is_aborted)


def test_a_message_larger_than_agreed_is_cut_off(tmp_path: Path) -> None:
    with listening(tmp_path, limits={"largest_instance_mib": 1, "least_free_mib": 1}) as node:
        made = makers.dataset(0, stored=np.zeros((1024, 1024), np.int16))
        said = send(node.port, save(made, tmp_path / "large.dcm"))
        assert "Success" not in said
        until(lambda: not list((node.folder / "incoming").iterdir()))
        until(lambda: node.events("cut off"))
        assert node.files() == []
        assert "Success" in send(node.port, instance(tmp_path))
        assert len(node.files()) == 1


def test_a_flood_of_a_thousand_associations_is_outlived(tmp_path: Path) -> None:
    with listening(tmp_path, limits={"associations": 5, "silent_s": 30.0, "least_free_mib": 1}) as node:
        for _ in range(2):
            with ExitStack() as held:
                for _ in range(500):
                    one = held.enter_context(socket.socket())
                    one.setblocking(False)
                    one.connect_ex(("127.0.0.1", node.port))
                    with suppress(OSError):  # the node does not let it in yet
                        one.sendall(association_request())
                until(lambda: node.events("refused association"))
                assert len(node.receiver._server.active_associations) <= 10  # type: ignore[union-attr]
        until(lambda: "Success" in send(node.port, instance(tmp_path)))
        assert node.events("refused association")[0]["reason"] == "10 connections are open"


def test_more_associations_than_allowed_are_told_to_come_again(tmp_path: Path) -> None:
    with listening(tmp_path, limits={"associations": 1, "least_free_mib": 1}) as node:
        entity = AE("CT1")
        entity.add_requested_context(CTImageStorage)
        held = associate(entity, node.port)
        said = send(node.port, instance(tmp_path))
        assert "Local Limit Exceeded" in said
        held.release()
        until(lambda: "Success" in send(node.port, instance(tmp_path)))


def test_who_is_connected_when_the_node_ends_is_parted_from_and_what_came_is_told(tmp_path: Path) -> None:
    """The node's process waited ten seconds for each scanner that held on, and was killed then."""
    with listening(tmp_path) as node:
        entity = AE("CT1")
        entity.add_requested_context(CTImageStorage)
        association = associate(entity, node.port)
        assert association.send_c_store(makers.dataset(0)).Status == 0
    assert not node.receiver._server.active_associations  # type: ignore[union-attr]
    assert [one["instances"] for one in node.events("received")] == [1]
    until(lambda: association.is_aborted)


def test_a_clock_that_is_set_ahead_cuts_off_nobody(node: Listening, monkeypatch: pytest.MonkeyPatch) -> None:
    """All that were connected had been silent for too long then."""
    entity = AE("CT1")
    entity.add_requested_context(CTImageStorage)
    association, clock = associate(entity, node.port), time.time
    assert association.send_c_store(makers.dataset(0)).Status == 0
    monkeypatch.setattr(time, "time", lambda: clock() + 3600.0)
    time.sleep(2 * LONGEST_SLEEP_S)  # whoever looks has looked
    assert association.send_c_store(makers.dataset(1)).Status == 0
    assert not node.events("cut off")
    association.release()
