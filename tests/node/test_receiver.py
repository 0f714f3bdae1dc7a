"""What the node takes is safe before it says so; what it does not take, it says by its status."""

from __future__ import annotations

import errno
import json
import os
import socket
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydicom import dcmread
from pydicom.filebase import DicomBytesIO
from pydicom.filewriter import write_dataset, write_file_meta_info
from pydicom.uid import UID, CTImageStorage, DeflatedExplicitVRLittleEndian, ExplicitVRLittleEndian
from pynetdicom import AE, _config

from ronnaplan import portable
from ronnaplan.errors import InputError
from ronnaplan.node import spool as spool_module
from ronnaplan.node import store as store_module
from ronnaplan.node.facts import read_facts
from ronnaplan.node.index import Index
from ronnaplan.node.receiver import CLASSES
from ronnaplan.node.spool import Spool
from tests.ct import makers
from tests.node.audit_schema import conforming
from tests.node.peers import Listening, associate, association_request, listening, needs, save, send, until

pytestmark = needs("storescu", "echoscu")


@pytest.fixture
def node(tmp_path: Path) -> Iterator[Listening]:
    with listening(tmp_path / "home") as found:
        yield found


def instance(folder: Path, k: int = 0, **changes: Any) -> Path:
    made = makers.dataset(k)
    for keyword, value in changes.items():
        setattr(made, keyword, value)
    made.file_meta.MediaStorageSOPInstanceUID = made.SOPInstanceUID
    return save(made, folder / f"{k}.dcm")


def test_a_scan_that_a_scanner_sends_is_kept_as_it_is(node: Listening, tmp_path: Path) -> None:
    sent = [instance(tmp_path, k) for k in range(3)]
    said = send(node.port, *sent)
    assert said.count("(Success)") == 3
    kept = node.files()
    assert len(kept) == 3
    for path, original in zip(
        sorted(kept), sorted(sent, key=lambda one: dcmread(one).SOPInstanceUID), strict=True
    ):
        assert dcmread(path) == dcmread(original)
    assert node.rows("SELECT instances, expected, calling, called, modality FROM series") == [
        (3, None, "CT1", "RONNAPLAN", "CT")
    ]
    assert not list((node.folder / "incoming").iterdir())


def test_every_class_that_a_scan_or_an_answer_may_be_of_is_kept(node: Listening, tmp_path: Path) -> None:
    entity = AE("CT1")
    for sop_class in CLASSES:
        entity.add_requested_context(sop_class)
    association = associate(entity, node.port)
    for k, sop_class in enumerate(CLASSES):
        made = makers.dataset(k)
        made.SOPClassUID = made.file_meta.MediaStorageSOPClassUID = UID(sop_class)
        made.SeriesInstanceUID = f"{makers.SERIES}.{k}"
        assert association.send_c_store(made).Status == 0, sop_class
    association.release()
    assert sorted(dcmread(path).SOPClassUID for path in node.files()) == sorted(CLASSES)
    assert set(CLASSES) >= {
        "1.2.840.10008.5.1.4.1.1.2",  # CT
        "1.2.840.10008.5.1.4.1.1.2.1",  # enhanced
        "1.2.840.10008.5.1.4.1.1.2.2",  # legacy converted
        "1.2.840.10008.5.1.4.1.1.66.1",  # registration
        "1.2.840.10008.5.1.4.1.1.66.4",  # segmentation
        "1.2.840.10008.5.1.4.1.1.481.3",  # RT structure set
    }


def test_an_acknowledged_instance_is_synced_named_and_in_the_index(
    node: Listening, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    def noted(name: str, what: Any) -> Any:
        def call(*arguments: Any) -> Any:
            result = what(*arguments)
            done.append(name)
            return result

        return call

    monkeypatch.setattr(Spool, "sync", noted("content synced", Spool.sync))
    monkeypatch.setattr(store_module, "replace", noted("named", portable.replace))
    monkeypatch.setattr(store_module, "sync_folder", noted("name synced", portable.sync_folder))
    monkeypatch.setattr(Index, "add", noted("in the index", Index.add))
    send(node.port, instance(tmp_path))
    assert list(dict.fromkeys(done)) == ["content synced", "named", "name synced", "in the index"]


def test_the_same_instance_twice_is_kept_once_in_whatever_meta_part(node: Listening, tmp_path: Path) -> None:
    path = instance(tmp_path)
    assert (send(node.port, path) + send(node.port, path)).count("(Success)") == 2
    assert node.rows("SELECT instances, revision FROM series") == [(1, 1)]
    assert len(node.events("known already")) == 1


def test_an_instance_whose_file_was_removed_is_kept_anew_when_it_comes_again(
    node: Listening, tmp_path: Path
) -> None:
    path = instance(tmp_path)
    send(node.port, path)
    (kept,) = (node.folder / "instances").rglob("*.dcm")
    content = kept.read_bytes()
    kept.unlink()
    assert "(Success)" in send(node.port, path)
    assert kept.read_bytes() == content
    assert node.rows("SELECT instances, revision FROM series") == [(1, 1)]
    assert len(node.events("kept anew")) == 1
    assert len(node.files()) == 1


def test_other_content_under_a_known_uid_is_kept_aside_and_told(node: Listening, tmp_path: Path) -> None:
    send(node.port, instance(tmp_path))
    first = node.files()[0].read_bytes()
    said = send(node.port, instance(tmp_path, SeriesDescription="another"))
    assert "0x111" in said
    assert node.files()[0].read_bytes() == first
    (aside,) = node.files("aside")
    assert dcmread(aside).SeriesDescription == "another"
    (told,) = node.events("kept aside")
    assert told["sop_instance"] == str(makers.dataset(0).SOPInstanceUID)
    assert node.rows("SELECT revision FROM series") == [(1,)]


def send_as_is(port: int, path: Path, syntax: str, monkeypatch: pytest.MonkeyPatch) -> int:
    """Send what follows a file's meta part under the UIDs of that part; returns the status."""
    monkeypatch.setattr(_config, "STORE_SEND_CHUNKED_DATASET", True)
    entity = AE("CT1")
    entity.add_requested_context(CTImageStorage, syntax)
    association = associate(entity, port)
    status = association.send_c_store(path)
    association.release()
    return int(status.Status)


def test_an_instance_that_is_not_what_the_request_says_is_refused(
    node: Listening, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = makers.dataset(0)
    path = save(made, tmp_path / "x.dcm")
    path.write_bytes(
        path.read_bytes().replace(
            made.SOPInstanceUID.encode(), b"1.2.3.9".ljust(len(made.SOPInstanceUID), b"9"), 1
        )
    )
    assert send_as_is(node.port, path, ExplicitVRLittleEndian, monkeypatch) == 0xA900
    assert node.files() == []
    assert made.SOPInstanceUID in node.events("refused")[0]["reason"]


@pytest.mark.parametrize("uid", [b"../../x", b"1..2", b"", b"1.2.3/4", b"1" * 66])
def test_a_uid_that_is_no_file_name_is_refused(uid: bytes, tmp_path: Path) -> None:
    made = makers.dataset(0)
    made.SeriesInstanceUID = "1.2.3." + "4" * 55
    path = save(made, tmp_path / "x.dcm")
    written = made.SeriesInstanceUID.encode() + b"\0"
    length = len(written).to_bytes(2, "little")
    padded = uid + b"\0" * (len(uid) % 2)
    path.write_bytes(path.read_bytes().replace(length + written, len(padded).to_bytes(2, "little") + padded))
    with pytest.raises(InputError, match="series UID is"):
        read_facts(path, "")


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


def test_with_too_little_room_on_the_disk_the_sender_keeps_its_instance(tmp_path: Path) -> None:
    with listening(tmp_path, limits={"least_free_mib": 100_000_000}) as node:
        said = send(node.port, instance(tmp_path))
        assert "OutOfResources" in said
        assert node.files() == []
        assert not list((node.folder / "incoming").iterdir())
        assert node.events("refused")[0]["status"] == "A700"


FULL = OSError(errno.ENOSPC, "No space left on device")


def full(*_: Any, **__: Any) -> None:
    raise FULL


def full_after_300_kb(handle: int, content: memoryview) -> int:
    if os.fstat(handle).st_size > 300_000:
        raise FULL
    return os.write(handle, content)


@pytest.mark.parametrize(
    ("where", "step", "fails"),
    [
        (tempfile, "mkstemp", full),
        (spool_module, "write", full),
        (spool_module, "write", full_after_300_kb),
        (Spool, "sync", full),
        (store_module, "replace", full),
        (store_module, "sync_folder", full),
        (Index, "add", full),
    ],
)
def test_a_disk_that_fills_at_any_step_is_told_and_the_node_lives_on(
    where: Any, step: str, fails: Any, node: Listening, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    large = makers.dataset(0, stored=np.zeros((512, 512), np.int16))
    path = save(large, tmp_path / "0.dcm")
    with monkeypatch.context() as patch:
        patch.setattr(where, step, fails)
        assert "OutOfResources" in send(node.port, path)
    (told,) = node.events("refused")
    assert told["status"] == "A700"
    assert "No space left on device" in told["reason"]
    assert node.rows("SELECT count(*) FROM instances") == [(0,)]
    assert node.files() == []
    assert not list((node.folder / "incoming").iterdir())
    assert "Success" in send(node.port, path)
    assert len(node.files()) == 1


def test_what_comes_when_the_node_ends_is_left_to_its_sender(node: Listening, tmp_path: Path) -> None:
    node.receiver._store.stop()
    assert "OutOfResources" in send(node.port, instance(tmp_path))
    assert "the node ends" in node.events("refused")[0]["reason"]
    assert not list((node.folder / "incoming").iterdir())


def test_files_that_were_never_acknowledged_are_removed_when_the_node_starts(tmp_path: Path) -> None:
    with listening(tmp_path) as node:
        send(node.port, instance(tmp_path))
        kept = node.files()
    left = [kept[0].with_name("1.2.3.dcm"), node.folder / "incoming" / "tmpabc.dcm"]
    for path in left:
        path.write_bytes(b"half")
    with listening(tmp_path) as node:
        assert node.files() == kept
        assert not any(path.exists() for path in left)


def test_a_deflated_bomb_is_refused_without_being_unpacked(
    node: Listening, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = makers.dataset(0, syntax=DeflatedExplicitVRLittleEndian)
    body = DicomBytesIO()
    body.is_little_endian, body.is_implicit_VR = True, False
    write_dataset(body, made[:0x00204000])
    comments = b"\x20\x00\x00\x40UT\0\0" + (1 << 26).to_bytes(4, "little") + bytes(1 << 26)  # 64 MiB
    packer = zlib.compressobj(9, wbits=-zlib.MAX_WBITS)
    packed = packer.compress(body.getvalue() + comments) + packer.flush()
    meta = DicomBytesIO()
    write_file_meta_info(meta, made.file_meta)
    path = tmp_path / "bomb.dcm"
    path.write_bytes(bytes(128) + b"DICM" + meta.getvalue() + packed)
    assert path.stat().st_size < 1 << 20
    assert send_as_is(node.port, path, DeflatedExplicitVRLittleEndian, monkeypatch) == 0xC000
    assert "longer than what is left" in node.events("refused")[0]["reason"]
    assert node.files() == []


@pytest.mark.parametrize(
    "begun",
    [b"", association_request()[:40], b"\x04\x00\x00\x00\x10\x00" + bytes(100)],
    ids=["silent", "half", "data"],
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


def test_logs_and_audit_name_no_patient_unless_asked_to(tmp_path: Path) -> None:
    for asked in (False, True):
        home = tmp_path / str(asked)
        with listening(home, names_in_logs=asked) as node:
            send(node.port, instance(tmp_path), instance(tmp_path, 1))
            until(lambda node=node: node.events("received"))  # type: ignore[misc]
            until(lambda node=node: (node.folder / "audit.log").exists())  # type: ignore[misc]
        audit = (node.folder / "audit.log").read_text()
        assert ("Doe" in node.said.getvalue()) is asked
        assert "Doe" not in audit
    told = conforming(audit.splitlines()[-1])
    assert (told.event, told.action, told.outcome) == ("110104", "C", "0")
    assert (told.participants, told.study, told.count) == (["CT1", "RONNAPLAN"], makers.STUDY, 2)


def test_what_a_peer_calls_itself_cannot_steer_a_log(node: Listening, tmp_path: Path) -> None:
    send(node.port, instance(tmp_path), calling="\x1b[31mX")
    for line in node.said.getvalue().splitlines():
        assert line.isprintable()
        json.loads(line)


def test_a_class_that_is_not_taken_is_not_agreed_on(node: Listening, tmp_path: Path) -> None:
    path = instance(tmp_path, SOPClassUID="1.2.840.10008.5.1.4.1.1.4")  # MR
    made = dcmread(path)
    made.file_meta.MediaStorageSOPClassUID = UID("1.2.840.10008.5.1.4.1.1.4")
    send(node.port, save(made, path))
    assert node.files() == []
