"""What the node takes is safe before it says so; what it does not take, it says by its status."""

from __future__ import annotations

import io
import json
import shlex
import subprocess
import zlib
from pathlib import Path

import pytest
from pydicom import dcmread
from pydicom.filebase import DicomBytesIO
from pydicom.filewriter import write_dataset, write_file_meta_info
from pydicom.uid import (
    UID,
    CTImageStorage,
    DeflatedExplicitVRLittleEndian,
    ExplicitVRLittleEndian,
    RLELossless,
    SecondaryCaptureImageStorage,
)
from pynetdicom import AE, _config

from ronnaplan.ct import encapsulated
from ronnaplan.errors import InputError
from ronnaplan.node.classes import CLASSES, COMPANIONS, RARER_COMPANIONS
from ronnaplan.node.facts import read_facts
from ronnaplan.node.logs import Log
from ronnaplan.node.receiver import Receiver
from tests.ct import makers
from tests.node.audit_schema import conforming
from tests.node.peers import (
    Listening,
    associate,
    configuration,
    instance,
    listening,
    needs,
    program,
    save,
    send,
    until,
)

pytestmark = needs("storescu", "echoscu")
ITEM = b"\xfe\xff\0\xe0\0\0\0\0"


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


def test_the_command_of_the_docs_sends_the_synthetic_scan(node: Listening) -> None:
    """In the compression of its files, which storescu does not propose by itself."""
    (line,) = [
        one for one in Path("docs/node.md").read_text("utf-8").splitlines() if "  /usr/bin/storescu " in one
    ]
    command = shlex.split(line.replace(" 11112 ", f" {node.port} "))
    done = subprocess.run([str(program("storescu")), *command[1:]], capture_output=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    sent = sorted(Path("data/synthetic_ct").glob("*.dcm"))
    assert sorted(dcmread(path).SOPInstanceUID for path in node.files()) == sorted(
        dcmread(path).SOPInstanceUID for path in sent
    )


def test_every_class_that_a_study_of_a_head_may_hold_is_kept(node: Listening) -> None:
    """Of a study whose dose report was refused senders gave up the scan, too."""
    entity, classes = AE("CT1"), (*CLASSES, *COMPANIONS, *RARER_COMPANIONS)
    for sop_class in classes:
        entity.add_requested_context(sop_class)
    association = associate(entity, node.port)
    for k, sop_class in enumerate(classes):
        made = makers.dataset(k)
        made.SOPClassUID = made.file_meta.MediaStorageSOPClassUID = UID(sop_class)
        made.SeriesInstanceUID = f"{makers.SERIES}.{k}"
        assert association.send_c_store(made).Status == 0, sop_class
    association.release()
    assert sorted(dcmread(path).SOPClassUID for path in node.files()) == sorted(classes)
    assert set(classes) >= {
        *("1.2.840.10008.5.1.4.1.1.7", "1.2.840.10008.5.1.4.1.1.88.67"),  # secondary capture, dose report
        *("1.2.840.10008.5.1.4.1.1.88.73", "1.2.840.10008.5.1.4.1.1.104.3"),  # a patient's dose, STL
        "1.2.840.10008.5.1.4.1.1.2",  # CT
        "1.2.840.10008.5.1.4.1.1.2.1",  # enhanced
        "1.2.840.10008.5.1.4.1.1.2.2",  # legacy converted
        "1.2.840.10008.5.1.4.1.1.66.1",  # registration
        "1.2.840.10008.5.1.4.1.1.66.4",  # segmentation
        "1.2.840.10008.5.1.4.1.1.481.3",  # RT structure set
    }


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


@pytest.mark.parametrize("syntax", [ExplicitVRLittleEndian, RLELossless])
def test_half_an_instance_is_refused_and_keeps_the_whole_one_not_out(
    syntax: UID, node: Listening, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sender that sent the first half of a file was told success, and the whole one was put aside."""
    stored = makers.pattern(0, 64, 64)
    made = makers.dataset(0, stored=stored)
    whole = save(
        made if syntax == ExplicitVRLittleEndian else makers.compress(made, syntax, tmp_path), tmp_path / "x"
    )
    half = tmp_path / "half.dcm"
    half.write_bytes(whole.read_bytes()[:-500])
    assert send_as_is(node.port, half, syntax, monkeypatch) == 0xC000
    assert "pixels" in node.events("refused")[0]["reason"]
    assert send_as_is(node.port, whole, syntax, monkeypatch) == 0
    assert dcmread(node.files()[0]).PixelData == dcmread(whole).PixelData


@pytest.mark.parametrize(
    "items",
    [
        pytest.param(ITEM, id="no fragment"),
        pytest.param(ITEM + ITEM[:4] + b"\3\0\0\0odd\0", id="an odd fragment that is padded"),
        pytest.param(ITEM + (ITEM[:4] + b"\2\0\0\0..") * 9, id="countless fragments"),
    ],
)
def test_a_picture_that_is_whole_is_taken_though_nobody_here_could_read_it(
    items: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Senders give up the scan for what lies beside it; and countless fragments were said to end too early."""
    monkeypatch.setattr(encapsulated, "MOST_FRAGMENTS", 5)
    made = makers.dataset(0)
    made.SOPClassUID, made.file_meta.TransferSyntaxUID = SecondaryCaptureImageStorage, RLELossless
    made.PixelData = items
    made["PixelData"].is_undefined_length = True
    path = save(made, tmp_path / "x.dcm")
    assert read_facts(path, "", only_whole=True).sop_class == SecondaryCaptureImageStorage
    path.write_bytes(path.read_bytes()[:-13] if len(items) > 8 else path.read_bytes()[:-12])
    with pytest.raises(InputError, match="ends within its compressed pixels"):
        read_facts(path, "", only_whole=True)


def test_a_slice_that_ends_between_the_elements_of_its_header_is_refused(tmp_path: Path) -> None:
    path = save(makers.dataset(0), tmp_path / "x.dcm")
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"\x28\0\x10\0US")])
    assert read_facts(path, "").modality == "CT"
    with pytest.raises(InputError, match="ends before its pixels"):
        read_facts(path, "", only_whole=True)


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
    for calling in ("\x1b[31mX", 'X", "event": "Y'):  # the first one is no title at all
        send(node.port, instance(tmp_path), calling=calling)
    until(lambda: node.events("cut off") and node.events("refused association"))
    lines = node.said.getvalue().splitlines()
    assert all(line.isprintable() for line in lines)
    assert sorted(json.loads(line)["event"] for line in lines) == ["cut off", "listening", "refused association"]
    assert 'X", "event": "Y is no peer' in node.events("refused association")[0]["reason"]


def test_a_place_where_this_machine_cannot_listen_is_told(tmp_path: Path) -> None:
    receiver = Receiver(configuration(tmp_path, host="192.0.2.1"), Log(io.StringIO()))
    try:
        with pytest.raises(InputError, match=r"192\.0\.2\.1:0 \(.+\); correct 'host' or 'port'"):
            receiver.start()
    finally:
        receiver.stop()


def test_a_class_that_is_not_taken_is_not_agreed_on(node: Listening, tmp_path: Path) -> None:
    path = instance(tmp_path, SOPClassUID="1.2.840.10008.5.1.4.1.1.4")  # MR
    made = dcmread(path)
    made.file_meta.MediaStorageSOPClassUID = UID("1.2.840.10008.5.1.4.1.1.4")
    send(node.port, save(made, path))
    assert node.files() == []
