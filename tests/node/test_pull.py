"""What an archive has comes whole, by DIMSE and by DICOMweb."""

from __future__ import annotations

import io
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pydicom import dcmread
from pydicom.dataset import Dataset
from pydicom.uid import (
    Comprehensive3DSRStorage,
    RLELossless,
    SecondaryCaptureImageStorage,
    XRayRadiationDoseSRStorage,
)

from ronnaplan.cli import main
from ronnaplan.cli import pull as pull_verb
from ronnaplan.ct import read_ct
from ronnaplan.errors import InputError, UnwrittenError, UsageError
from ronnaplan.node import arrivals
from ronnaplan.node.archives import GET, MOVE, _Dimse
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.destination import destination
from ronnaplan.node.pull import Wanted, peer_at, pull
from tests.ct import makers
from tests.node.peers import Orthanc, free_port, needs, program, send, until

STUDY = "1.2.3.500"
BESIDE = (XRayRadiationDoseSRStorage, SecondaryCaptureImageStorage, Comprehensive3DSRStorage)
"""What a real study holds beside its scans."""


@pytest.fixture
def archive(orthanc: Orthanc, tmp_path: Path) -> Orthanc:
    def named(made: object, _: int) -> None:
        made.StudyInstanceUID, made.PatientID = STUDY, "PULLED"  # type: ignore[attr-defined]

    for path in makers.write_series(tmp_path / "sent", change=named).iterdir():
        orthanc.post("/instances", path.read_bytes())
    for number, sop_class in enumerate(BESIDE, start=100):
        made, stream = makers.dataset(number), io.BytesIO()
        named(made, number)
        made.SOPClassUID, made.SeriesInstanceUID = sop_class, f"1.2.3.{number}"
        makers.save(made, stream)
        orthanc.post("/instances", stream.getvalue())
    return orthanc


@pytest.mark.parametrize("way", ["get, as nothing is said", "move", "web"])
def test_a_study_is_fetched_whole(way: str, archive: Orthanc, tmp_path: Path) -> None:
    port = free_port()
    archive.know("node", "RONNAPLAN", port)
    address = ["--from", f"http://127.0.0.1:{archive.http}/dicom-web"]
    if way != "web":
        address = ["--from", f"ORTHANC@127.0.0.1:{archive.port}", "--port", str(port)]
        address += ["--by", way] if way == "move" else []
    out = tmp_path / "out"
    assert main(["pull", *address, "--patient", "PULLED", "-o", str(out)]) == 0
    assert len(list(out.iterdir())) == len(list((tmp_path / "sent").iterdir())) + len(BESIDE)
    assert read_ct(out).voxel_sha256 == read_ct(tmp_path / "sent").voxel_sha256
    assert main(["pull", *address, "--study", "1.2.3.404", "-o", str(out)]) == 1


@needs("dcmqrscp", "storescu")
@pytest.mark.parametrize("way", ["get", "move"])
def test_a_study_comes_from_dcmtk_s_archive_straight_into_localize(way: str, tmp_path: Path) -> None:
    port, own, home = free_port(), free_port(), tmp_path / "archive"
    home.mkdir()
    sent = makers.write_series(tmp_path / "sent")
    tables = (
        f"me = (RONNAPLAN, 127.0.0.1, {own})\nHostTable END\nVendorTable BEGIN\nVendorTable END\nAETable BEGIN"
    )
    config = f"NetworkTCPPort = {port}\nMaxPDUSize = 16384\nMaxAssociations = 4\nHostTable BEGIN\n{tables}\n"
    (tmp_path / "qr.cfg").write_text(f"{config}ARCHIVE {home} RW (9, 1024mb) ANY\nAETable END\n")
    command = [str(program("dcmqrscp")), "-c", str(tmp_path / "qr.cfg")]
    archive = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until(lambda: send(port, *sorted(sent.iterdir()), called="ARCHIVE").count("(Success)") == 4)
        found, expected = tmp_path / "found.json", tmp_path / "expected.json"
        options = ["--by", way, "--port", str(own), "--study", makers.STUDY]
        wanted = ["--diameter", "3", "-o"]
        status = main(["localize", str(sent), *wanted, str(expected)])
        pulled = ["pull", "--from", f"ARCHIVE@127.0.0.1:{port}", *options]
        assert main([*pulled, "--localize", *wanted, str(found)]) == status
        assert found.exists() == expected.exists()
        if expected.exists():
            assert found.read_bytes() == expected.read_bytes()
        assert main([*pulled, "--localize", "--diameter", "0,5", "-o", str(found)]) == 2
    finally:
        archive.terminate()
        archive.wait(60)


def test_a_port_that_is_taken_is_told() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        config = Config(port=taken.getsockname()[1])
        with pytest.raises(InputError, match="choose another port"), destination(config, Peer(name="a"), []):
            pass


def test_what_is_to_become_of_a_scan_must_be_said() -> None:
    assert main(["pull", "--from", "A@127.0.0.1:1", "--study", "1.2"]) == 2
    assert main(["pull", "--from", "A@127.0.0.1:1", "--study", "1.2", "--localize", "--expected", "x"]) == 2


def test_what_says_too_little_is_wrong_usage(tmp_path: Path) -> None:
    for text in ("pacs", "A@b", "A@b:0", "A@b:70000"):
        with pytest.raises(UsageError, match="is no peer"):
            peer_at(text, Config())
    with pytest.raises(UsageError, match="nothing says which study"):
        pull(Config(), peer_at("A@127.0.0.1:1", Config()), Wanted(), tmp_path)


def test_a_study_s_uid_that_is_none_is_wrong_usage_and_nobody_is_asked(tmp_path: Path) -> None:
    for uid in ("abc", "1.2*", "1.2\\1.3"):
        with pytest.raises(UsageError, match="is no study's UID; expected up to 64 digits and points"):
            pull(Config(), peer_at("A@127.0.0.1:1", Config()), Wanted(study_uid=uid), tmp_path)


@pytest.mark.parametrize("way", [GET, MOVE])
def test_what_this_side_could_not_keep_is_told_in_place_of_what_the_archive_makes_of_it(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise UnwrittenError("cannot write it: No space left on device; make room")

    monkeypatch.setattr(arrivals, "write_atomically", full)
    kept = arrivals.Arrivals()

    def sends_one(*_: object) -> list[tuple[Dataset, None]]:
        request = SimpleNamespace(AffectedSOPInstanceUID="1.2.3")
        assert kept.take(SimpleNamespace(request=request, encoded_dataset=lambda: b"")) == 0xA700
        end = Dataset()
        end.Status = 0xB000
        return [(end, None)]

    association: Any = SimpleNamespace(send_c_get=sends_one, send_c_move=sends_one)
    archive = _Dimse(Config(), Peer(name="pacs"), association, way, kept)
    with pytest.raises(InputError, match=r"pacs sent what is not kept: .*No space left"):
        archive.fetch(["1.2"], tmp_path)


def test_an_archive_that_is_not_there_is_told(tmp_path: Path) -> None:
    # in a process of its own: pynetdicom leaves the socket open that could not be connected
    command = [sys.executable, "-m", "ronnaplan", "pull", "--from", f"A@127.0.0.1:{free_port()}", "--study", "1.2"]
    done = subprocess.run([*command, "-o", str(tmp_path / "x")], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "cannot be reached" in done.stderr


@pytest.mark.parametrize("host", ["nohost", "a..b"])
def test_an_archive_whose_host_is_not_known_is_told(
    host: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(name: str, *_: object, **__: object) -> None:
        name.encode("idna")
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(InputError, match=rf"\(A at {host}:104\) cannot be reached: no host of this name"):
        pull(Config(), peer_at(f"A@{host}:104", Config()), Wanted("1.2"), tmp_path / "out")


def test_a_dicomweb_archive_that_is_not_there_is_told_at_once_and_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port, waited = free_port(), list[float]()
    monkeypatch.setattr(time, "sleep", waited.append)  # as before another attempt
    with pytest.raises(InputError) as told:
        pull(Config(), peer_at(f"http://127.0.0.1:{port}/dicomweb", Config()), Wanted("1.2"), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []  # no empty folder that looks like a scan
    assert str(told.value) == "the archive cannot be reached by DICOMweb: connection refused; check its address"
    assert not waited


@pytest.mark.parametrize(
    ("busy", "says"), [(1, "has no such study"), (9, "answered 503 Service Unavailable by DICOMweb")]
)
def test_a_dicomweb_archive_that_is_busy_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, busy: int, says: str
) -> None:
    asked, waited = list[str](), list[float]()
    monkeypatch.setattr(time, "sleep", waited.append)

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_response(503 if len(asked) <= busy else 204)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        peer = peer_at(f"http://127.0.0.1:{server.server_port}", Config())
        with pytest.raises(InputError, match=says):
            pull(Config(), peer, Wanted("1.2"), tmp_path)
        server.shutdown()
    assert len(asked) == min(busy + 1, 5)
    assert waited == ([2.0, 4.0, 8.0] if busy > 1 else [])


@pytest.mark.parametrize("knows_any_syntax", [True, False])
def test_a_dicomweb_archive_is_asked_for_instances_as_it_stores_them(
    tmp_path: Path, knows_any_syntax: bool
) -> None:
    (stored,) = makers.write_series(tmp_path / "sent", count=1, change=_squeeze).iterdir()
    sop_uid = str(makers.dataset(0).SOPInstanceUID)
    asked = list[str]()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if "?" in self.path:  # a list, of which there is one page
                told = {"0020000D": STUDY, "0020000E": makers.SERIES, "00080018": sop_uid}
                entry = {tag: {"vr": "UI", "Value": [uid]} for tag, uid in told.items()}
                self._answer(
                    200, "application/dicom+json", b"[]" if "offset" in self.path else json.dumps([entry]).encode()
                )
                return
            asked.append(self.headers["Accept"])
            if not knows_any_syntax and "transfer-syntax=*" in asked[-1]:
                self._answer(406, "text/plain", b"")
                return
            part = b"--X\r\nContent-Type: application/dicom\r\n\r\n" + stored.read_bytes() + b"\r\n--X--\r\n"
            self._answer(200, 'multipart/related; type="application/dicom"; boundary=X', part)

        def _answer(self, status: int, kind: str, body: bytes) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        peer = peer_at(f"http://127.0.0.1:{server.server_port}", Config())
        assert pull(Config(), peer, Wanted(STUDY), tmp_path / "out") == 1
        server.shutdown()
    assert "transfer-syntax=*" in asked[0]
    assert len(asked) == 2 - knows_any_syntax
    (kept,) = (tmp_path / "out").iterdir()
    assert dcmread(kept).file_meta.TransferSyntaxUID == RLELossless


def _squeeze(made: Any, _: int) -> None:
    made.StudyInstanceUID = STUDY
    made.compress(RLELossless, generate_instance_uid=False)


@pytest.mark.parametrize("date", ["20260231", "00000000", "20261301-", "20260201-20260131", "2026-01-01"])
def test_a_date_that_is_none_and_days_that_run_backwards_are_wrong_usage(date: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="expected YYYYMMDD, or two with a - between, the earlier first"):
        pull(Config(), peer_at("A@127.0.0.1:1", Config()), Wanted(date=date), tmp_path)
    assert Wanted(date="20240229-20240301").keys == {"StudyDate": "20240229-20240301"}


@pytest.mark.skipif(sys.platform == "win32", reason="a process is sent no signals there")
def test_one_that_is_ended_leaves_no_scan_among_the_temporary_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fetch(_: object, folder: str) -> int:
        Path(folder, "0.dcm").touch()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(60)
        return 1

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(f"{pull_verb.__name__}._fetch", fetch)
    given = ["pull", "--from", "PACS@127.0.0.1:104", "--study", "1.2", "--localize", "--diameter", "5"]
    assert main(given) == 130
    assert not list(tmp_path.iterdir())
