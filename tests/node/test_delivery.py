"""Answers reach a real receiver, encrypted too, however long it was away; a real archive's tools and the node agree."""

from __future__ import annotations

import io
import shutil
import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import repeat
from pathlib import Path
from typing import Any

import pytest
from pydicom import dcmread
from pynetdicom import AE, StoragePresentationContexts, evt

from ronnaplan.documents.dicom_spatial import dicom_bytes, spatial_fiducials
from ronnaplan.documents.fiducials import Source
from ronnaplan.node import sender as sender_module
from ronnaplan.node.config import Config
from ronnaplan.node.index import Index
from ronnaplan.node.logs import Log
from ronnaplan.node.pull import Wanted, pull
from ronnaplan.node.sender import Sender
from ronnaplan.node.transport import set_up_pynetdicom
from tests import cases
from tests.ct import makers
from tests.node.peers import Orthanc, configuration, free_port, listening, needs, program, save, until
from tests.node.test_series import add
from tests.node.test_tls import certificate


def waiting_answer(config: Config, index: Index) -> None:
    """Enter an answer that is to be delivered to the archive."""
    source = Source(study_instance_uid="1.2.3", series_instance_uid="1.2.4", frame_of_reference_uid="1.2.5")
    made = spatial_fiducials(cases.fiducials().model_copy(update={"source": source}))
    (config.data / "answer.dcm").write_bytes(dicom_bytes(made))
    add(index, 1, 0.0)
    index.run("INSERT INTO jobs (series, revision, rule, state, due, completed) VALUES (1, 1, 'r', 'done', 0, 0)")
    uids = (made.SOPInstanceUID, made.SOPClassUID)
    index.run("INSERT INTO answers VALUES (?, 1, 'fiducials', ?, 'answer.dcm', 0)", *uids)
    index.run("INSERT INTO deliveries (answer, receiver, state, due) VALUES (?, 'archive', 'waiting', 0)", uids[0])


def delivered(config: Config, index: Index, now: float) -> str:
    """Have what is due delivered by a sender that knows the index only; return the state and the reason."""
    Sender(config, config.peer[0], Log(io.StringIO())).deliver(index, now)
    ((state, reason),) = index.rows("SELECT state, reason FROM deliveries")
    return f"{state} {reason}".strip()


@contextmanager
def storescp(folder: Path, port: int, *options: str) -> Iterator[None]:
    folder.mkdir()
    process = subprocess.Popen([str(program("storescp")), *options, "-od", str(folder), str(port)])
    try:
        yield
    finally:
        process.terminate()
        process.wait(120)


@needs("storescp")
@pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning"
)  # pynetdicom leaves sockets unclosed
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed to make certificates")
def test_an_answer_waits_for_its_receiver_and_goes_encrypted_to_the_right_one_only(tmp_path: Path) -> None:
    for name in ("node", "archive", "stranger"):
        certificate(tmp_path, name)
    certificate(tmp_path, "elsewhere", "192.0.2.1")
    known = [(tmp_path / f"{name}.pem").read_text() for name in ("archive", "elsewhere")]
    (tmp_path / "known.pem").write_text("".join(known))
    port = free_port()
    config = configuration(
        tmp_path,
        tls={"certificate": "node.pem", "key": "node.key", "authorities": "known.pem"},
        peer=[{"name": "archive", "port": port, "tls": True}],
        jobs={"retry_s": 10.0},
    )
    config.data.mkdir()
    with Index(config.data) as index:
        waiting_answer(config, index)
        assert "cannot be reached" in delivered(config, index, 1.0)
    for name, told, why in (
        ("stranger", "waiting", "does not agree on TLS: self-signed certificate"),
        (
            "elsewhere",
            "waiting",
            "does not agree on TLS: IP address mismatch, certificate is not valid for '127.0.0.1'",
        ),
        ("archive", "sent", ""),
    ):
        own = [
            "+tls",
            str(tmp_path / f"{name}.key"),
            str(tmp_path / f"{name}.pem"),
            "+cf",
            str(tmp_path / "node.pem"),
        ]
        got = tmp_path / f"got by {name}"
        with storescp(got, port, *own), Index(config.data) as index:

            def state(index: Index = index) -> str:
                index.run("UPDATE deliveries SET due = 0")
                return delivered(config, index, 2.0)

            until(lambda told=told, why=why: state().startswith(told) and why in state())  # type: ignore[misc]
            assert told == "sent" or all(state().startswith(told) for _ in range(3))
            assert len(list(got.iterdir())) == (told == "sent")


def test_a_sender_outlives_an_index_that_cannot_be_opened_when_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing was delivered to its receiver until the node began anew."""
    opened: list[Path] = []

    def open_index(folder: Path) -> Index:
        opened.append(folder)
        if len(opened) == 1:
            raise sqlite3.OperationalError("database is locked")
        return Index(folder)

    monkeypatch.setattr(sender_module, "Index", open_index)
    monkeypatch.setattr(sender_module, "RESTART_S", 0.1)
    config, told = configuration(tmp_path, peer=[{"name": "archive", "port": 104}]), io.StringIO()
    config.data.mkdir()
    sender = Sender(config, config.peer[0], Log(told))
    sender.start()
    try:
        until(lambda: len(opened) == 2)
    finally:
        sender.stop()
    assert "database is locked" in told.getvalue()


@contextmanager
def archive(port: int, statuses: Iterator[int]) -> Iterator[list[str]]:
    """Answer each instance with the next status; give the instances that came."""
    set_up_pynetdicom()
    entity = AE("ARCHIVE")
    entity.supported_contexts = StoragePresentationContexts
    came: list[str] = []

    def store(event: Any) -> int:
        came.append(str(event.request.AffectedSOPInstanceUID))
        return next(statuses)

    server = entity.start_server(("127.0.0.1", port), block=False, evt_handlers=[(evt.EVT_C_STORE, store)])
    assert server is not None
    try:
        yield came
    finally:
        server.shutdown()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_answer_that_its_receiver_warns_of_or_has_already_is_not_sent_again(tmp_path: Path) -> None:
    port, statuses = free_port(), [0xA700, 0xC001, 0x0117, 0xB123, 0x0107, 0x0111]
    config = configuration(tmp_path, peer=[{"name": "archive", "port": port}])
    config.data.mkdir()
    with archive(port, iter(statuses)), Index(config.data) as index:
        waiting_answer(config, index)
        found = []
        for _ in statuses:
            index.run("UPDATE deliveries SET state = 'waiting', due = 0")
            found.append(delivered(config, index, 2.0))
    assert found == [f"waiting archive answered {one:04X}; expected 0000" for one in statuses[:3]] + ["sent"] * 3


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_nothing_is_sent_that_could_not_be_noted(tmp_path: Path) -> None:
    """On a full disk an answer went to its receiver every second, until there was room."""
    port = free_port()
    config = configuration(tmp_path, peer=[{"name": "archive", "port": port}])
    config.data.mkdir()
    with archive(port, repeat(0)) as came, Index(config.data) as index:
        waiting_answer(config, index)
        index.run("PRAGMA query_only = ON")
        with pytest.raises(sqlite3.Error):
            delivered(config, index, 2.0)
        assert came == []
        index.run("PRAGMA query_only = OFF")
        assert delivered(config, index, 2.0) == "sent"
        assert len(came) == 1


@needs("storescp")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(("options", "is_implicit"), [((), False), (("+xi",), True)])
def test_a_receiver_gets_the_encoding_that_it_takes(
    tmp_path: Path, options: tuple[str, ...], is_implicit: bool
) -> None:
    port = free_port()
    config = configuration(tmp_path, peer=[{"name": "archive", "port": port}], jobs={"retry_s": 10.0})
    config.data.mkdir()
    with storescp(tmp_path / "got", port, *options), Index(config.data) as index:
        waiting_answer(config, index)

        def state() -> str:
            index.run("UPDATE deliveries SET due = 0")
            return delivered(config, index, 2.0)

        until(lambda: state() == "sent")
    (path,) = (tmp_path / "got").iterdir()
    got, made = dcmread(path), dcmread(config.data / "answer.dcm")
    assert got.file_meta.TransferSyntaxUID.is_implicit_VR == is_implicit
    assert got == made


@needs("findscu", "getscu", "movescu")
def test_an_archive_s_own_tools_find_and_bring_the_same(orthanc: Orthanc, tmp_path: Path) -> None:
    study = "1.2.3.700"
    for k in range(3):
        made = makers.dataset(k)
        made.StudyInstanceUID, made.SeriesInstanceUID, made.SOPInstanceUID = study, f"{study}.1", f"{study}.1.{k}"
        made.file_meta.MediaStorageSOPInstanceUID = made.SOPInstanceUID
        orthanc.post("/instances", save(made, tmp_path / f"{k}.dcm").read_bytes())
    key = ["-k", "QueryRetrieveLevel=STUDY", "-k", f"StudyInstanceUID={study}"]

    def tool(name: str, *options: str) -> str:
        there = ["-S", "-aet", "RONNAPLAN", "-aec", "ORTHANC", "127.0.0.1", str(orthanc.port)]
        command = [str(program(name)), "-v", *there, *key, *options]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        return done.stdout + done.stderr

    assert study in tool("findscu", "-k", "PatientID")
    peer = configuration(tmp_path, peer=[{**orthanc.peer, "sends": True}]).peer[0]
    assert pull(Config(home=tmp_path), peer, Wanted(study_uid=study), tmp_path / "pulled") == 3
    (tmp_path / "got").mkdir()
    tool("getscu", "-od", str(tmp_path / "got"))
    with listening(tmp_path, peer=[{**orthanc.peer, "sends": True}]) as node:
        orthanc.know("node", "RONNAPLAN", node.port)
        tool("movescu", "-aem", "RONNAPLAN")
        until(lambda: len(node.files()) == 3)
        folders = [node.files(), *((tmp_path / name).iterdir() for name in ("pulled", "got"))]
        one, other, third = (
            {str(made.SOPInstanceUID): made.PixelData for made in map(dcmread, each)} for each in folders
        )
    assert one == other == third
    assert len(one) == 3
