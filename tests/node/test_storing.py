"""However a sender cuts its requests to store into fragments and PDUs, each instance arrives as it was sent."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pydicom import dcmread
from pydicom.uid import CTImageStorage
from pynetdicom import AE
from pynetdicom.association import Association
from pynetdicom.dsutils import encode

from tests.ct import makers
from tests.long import few_and_others
from tests.node.peers import Listening, associate, needs, save, send, until

VERIFICATION = "1.2.840.10008.1.1"
COMMAND, LAST = 1, 2


@contextmanager
def associated(node: Listening) -> Iterator[Association]:
    entity = AE("CT1")
    entity.add_requested_context(CTImageStorage, "1.2.840.10008.1.2.1")
    entity.add_requested_context(VERIFICATION)
    association = associate(entity, node.port)
    yield association
    association.abort()


def uid(text: str) -> bytes:
    return text.encode() + b"\0" * (len(text) % 2)


def command(sop_uid: str, sop_class: str = CTImageStorage, has_data: int = 0) -> bytes:
    """Return the command of a C-STORE-RQ, written from PS3.7, 9.3.1.1."""
    content = b""
    for number, value in (
        (0x0002, uid(sop_class)),
        (0x0100, b"\1\0"),
        (0x0110, b"\7\0"),
        (0x0700, b"\0\0"),
        (0x0800, struct.pack("<H", has_data)),
        (0x1000, uid(sop_uid)),
    ):
        content += struct.pack("<HHL", 0, number, len(value)) + value
    return struct.pack("<HHLL", 0, 0, 4, len(content)) + content


def cut(content: bytes, control: int, size: int, context_id: int = 1) -> list[bytes]:
    """Return the fragments of a command or a data set, each of so many bytes."""
    parts = [content[start : start + size] for start in range(0, len(content), size)]
    ends = [0] * (len(parts) - 1) + [LAST]
    return [
        struct.pack(">LBB", len(part) + 2, context_id, control | end) + part
        for part, end in zip(parts, ends, strict=True)
    ]


def pdu(*fragments: bytes) -> bytes:
    content = b"".join(fragments)
    return struct.pack(">BxL", 4, len(content)) + content


def status_of(association: Association, *pdus: bytes) -> tuple[int, int]:
    """Send PDUs as they are; return the message that is answered, and the status."""
    connection: Any = association.dul.socket
    association._reactor_checkpoint.clear()  # the answer is for this thread
    until(lambda: association._is_paused)
    for one in pdus:
        connection.send(one)
    answer: Any = association.dimse.get_msg(block=True)[1]
    association._reactor_checkpoint.set()
    return answer.MessageIDBeingRespondedTo, answer.Status


@few_and_others("size", [20], [1000, 1 << 16])
@pytest.mark.parametrize("is_one_pdu", [False, True])
def test_an_instance_in_any_fragments_is_kept_as_it_is(node: Listening, size: int, is_one_pdu: bool) -> None:
    made = makers.dataset(0)
    content = encode(made, is_implicit_vr=False, is_little_endian=True)
    assert content is not None
    fragments = cut(command(made.SOPInstanceUID), COMMAND, size) + cut(content, 0, size)
    with associated(node) as association:
        pdus = [pdu(*fragments)] if is_one_pdu else [pdu(one) for one in fragments]
        assert status_of(association, *pdus) == (7, 0)
        assert association.send_c_echo().Status == 0
        assert status_of(association, *pdus) == (7, 0)  # the same again
    (kept,) = node.files()
    found = dcmread(kept)
    assert found == made
    assert found.file_meta.MediaStorageSOPInstanceUID == made.SOPInstanceUID
    assert found.file_meta.TransferSyntaxUID == "1.2.840.10008.1.2.1"


@needs("storescu")
def test_a_sender_of_small_pdus_is_served(node: Listening, tmp_path: Path) -> None:
    path = save(makers.dataset(0), tmp_path / "0.dcm")
    assert "(Success)" in send(node.port, path, options=["--max-send-pdu", "4096"])


SOP_UID = "1.2.3"
BROKEN = {
    "data in another context": [*cut(command(SOP_UID), COMMAND, 1 << 16), *cut(b"x" * 10, 0, 5, context_id=3)],
    "a command amid data": [*cut(command(SOP_UID), COMMAND, 1 << 16), *cut(command(SOP_UID), COMMAND, 1 << 16)],
    "no data set": cut(command(SOP_UID, has_data=0x0101), COMMAND, 1 << 16),
    "an unknown context": cut(command(SOP_UID), COMMAND, 1 << 16, context_id=99),
    "another class than agreed on": cut(command(SOP_UID, VERIFICATION), COMMAND, 1 << 16),
    "a command without end": cut(b"x" * (1 << 17), COMMAND, 1 << 15)[:-1],
    "a fragment longer than its PDU": [struct.pack(">LBB", 1000, 1, 3) + b"x"],
    "half a fragment's head": [b"\0\0"],
    "nothing in a fragment": [struct.pack(">L", 0)],
}


@pytest.mark.parametrize("what", BROKEN)
def test_what_breaks_the_protocol_ends_the_association_and_leaves_nothing(what: str, node: Listening) -> None:
    with associated(node) as association:
        connection: Any = association.dul.socket
        for one in BROKEN[what]:
            connection.send(pdu(one))
        until(lambda: association.is_aborted)
    until(lambda: not list((node.folder / "incoming").iterdir()))
    assert node.files() == []
    with associated(node) as association:
        assert association.send_c_echo().Status == 0


def test_a_message_that_is_no_command_at_all_ends_its_association_only(node: Listening) -> None:
    with associated(node) as association:
        connection: Any = association.dul.socket
        connection.send(pdu(*cut(b"\xff" * 50, COMMAND, 100)))
        until(lambda: association.is_aborted)
    with associated(node) as association:
        assert association.send_c_echo().Status == 0
