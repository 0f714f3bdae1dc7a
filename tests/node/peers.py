"""Real peers for the node: Debian's dcmtk and Orthanc on loopback, and a receiver to talk to."""

from __future__ import annotations

import io
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pydicom import dcmread
from pydicom.dataset import Dataset, FileDataset
from pynetdicom import AE, StoragePresentationContexts, evt
from pynetdicom.association import Association

from ronnaplan.node.association import Checkpoint
from ronnaplan.node.config import Config
from ronnaplan.node.index import Index
from ronnaplan.node.logs import Log
from ronnaplan.node.receiver import Receiver
from ronnaplan.node.transport import set_up_pynetdicom
from ronnaplan.untrusted import checked
from tests.ct import makers

SENDER: dict[str, Any] = {"name": "scanner", "title": "CT1", "host": "127.0.0.1", "sends": True}
ODD_ABORT = b"\x07\0\0\0\0\x04\0\0\xff\0"
"""An A-ABORT of a source that is none (PS3.8, 9.3.8)."""
_ELSEWHERE = os.pathsep.join(
    part for part in os.environ["PATH"].split(os.pathsep) if Path(part) != Path(sys.executable).parent
)


def program(name: str) -> str | None:
    """Return the path of a program that is not pynetdicom's of the same name."""
    return shutil.which(name, path=f"{_ELSEWHERE}{os.pathsep}/usr/sbin")


def needs(*names: str) -> pytest.MarkDecorator:
    """Skip a test where one of Debian's programs is missing."""
    missing = [name for name in names if program(name) is None]
    return pytest.mark.skipif(bool(missing), reason=f"{', '.join(missing)} not installed (see .ci/run)")


def configuration(home: Path, **given: Any) -> Config:
    """Return a checked configuration with one scanner that may send."""
    content = {"port": 0, "page_port": None, "peer": [SENDER], "limits": {"least_free_mib": 1}, **given}
    return checked(content, Config).model_copy(update={"home": home})


def write_toml(home: Path, port: int, rest: str = "", *, quiet_s: float = 0.5, silent_s: float = 30.0) -> Path:
    """Write node.toml with one scanner that may send, and ``rest``; return its path."""
    path = home / "node.toml"
    limits = f"limits = {{ least_free_mib = 1, silent_s = {silent_s} }}"
    scanner = '[[peer]]\nname = "scanner"\ntitle = "CT1"\nsends = true'
    path.write_text(f"port = {port}\npage_port = 0\nquiet_s = {quiet_s}\n{limits}\n{scanner}\n{rest}")
    return path


def associate(entity: AE, port: int, **more: Any) -> Association:
    """Ask the node at ``port`` of this machine for an association, on which no answer is lost."""
    association = entity.associate("127.0.0.1", port, ae_title="RONNAPLAN", **more)
    Checkpoint(association).guard()
    return association


class Archive:
    """Takes answers as ``title`` and notes them by what each is `of`; one that is delivered again counts once."""

    def __init__(self, title: str, of: Callable[[Dataset], str], host: str = "127.0.0.1", port: int = 0) -> None:
        set_up_pynetdicom()
        self.port, self._of = port or free_port(), of
        self.got: dict[str, dict[str, Dataset]] = {}
        entity = AE(title)
        entity.supported_contexts = StoragePresentationContexts
        self._server = entity.start_server(
            (host, self.port), block=False, evt_handlers=[(evt.EVT_C_STORE, self._take)]
        )

    def _take(self, event: evt.Event) -> int:
        made = event.dataset
        self.got.setdefault(self._of(made), {})[str(made.SOPInstanceUID)] = made
        return 0

    def count(self) -> int:
        """How many answers there are."""
        return sum(map(len, self.got.values()))

    def wait_for(self, count: int, each: int, most_s: float) -> None:
        """Wait until so many have ``each`` answers, or no answer came for so long."""
        known, last = 0, time.monotonic()
        while sum(len(one) >= each for one in self.got.values()) < count and time.monotonic() < last + most_s:
            if self.count() > known:
                known, last = self.count(), time.monotonic()
            time.sleep(0.1)

    def stop(self) -> None:
        """Take no more."""
        if self._server is not None:
            self._server.shutdown()


class Listening:
    """A receiver that serves, and what it said."""

    def __init__(self, config: Config) -> None:
        self.said = io.StringIO()
        self.log = Log(self.said)
        self.receiver = Receiver(config, self.log)
        self.receiver.start()
        self.folder, self.port = config.data, self.receiver.port
        self._thread = threading.Thread(target=self.receiver.serve)
        self._thread.start()

    def stop(self) -> None:
        self.receiver.stop()
        self._thread.join()

    def events(self, kind: str) -> list[dict[str, Any]]:
        lines = [json.loads(line) for line in self.said.getvalue().splitlines()]
        return [line for line in lines if line["event"] == kind]

    def rows(self, sql: str) -> list[tuple[Any, ...]]:
        with Index(self.folder) as index:
            return index.rows(sql)

    def files(self, folder: str = "instances") -> list[Path]:
        return sorted((self.folder / folder).rglob("*.dcm"))


@contextmanager
def listening(home: Path, **given: Any) -> Iterator[Listening]:
    node = Listening(configuration(home, **given))
    try:
        yield node
    finally:
        node.stop()


def send(
    port: int, *paths: Path, calling: str = "CT1", called: str = "RONNAPLAN", options: Sequence[str] = ()
) -> str:
    """Send files with dcmtk's storescu; returns what it says."""
    command = [str(program("storescu")), "-v", "-aet", calling, "-aec", called, *options]
    done = subprocess.run(
        [*command, "127.0.0.1", str(port), *map(str, paths)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return done.stdout + done.stderr


def save(made: FileDataset, path: Path) -> Path:
    made.save_as(path, enforce_file_format=True)
    return path


def instance(folder: Path, k: int = 0, **changes: Any) -> Path:
    """Write slice ``k`` of a scan to be sent, changed."""
    made = makers.dataset(k)
    for keyword, value in changes.items():
        setattr(made, keyword, value)
    made.file_meta.MediaStorageSOPInstanceUID = made.SOPInstanceUID
    return save(made, folder / f"{k}.dcm")


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait for a condition; fails the test where it does not come true."""
    last = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < last, "it did not happen in time"
        time.sleep(0.02)


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def association_request(calling: str = "CT1", called: str = "RONNAPLAN") -> bytes:
    """Return an A-ASSOCIATE-RQ for verification, written from PS3.8, 9.3.2 and PS3.7, annex D."""

    def item(kind: int, content: bytes) -> bytes:
        return struct.pack(">BBH", kind, 0, len(content)) + content

    context = (
        struct.pack(">BBBB", 1, 0, 0, 0) + item(0x30, b"1.2.840.10008.1.1") + item(0x40, b"1.2.840.10008.1.2")
    )
    user = item(0x51, struct.pack(">L", 16384)) + item(0x52, b"1.2.3.4")
    variable = item(0x10, b"1.2.840.10008.3.1.1.1") + item(0x20, context) + item(0x50, user)
    titles = called.encode().ljust(16) + calling.encode().ljust(16)
    content = struct.pack(">HH", 1, 0) + titles + bytes(32) + variable
    return struct.pack(">BBL", 1, 0, len(content)) + content


class Orthanc:
    """An archive that takes objects from the node ``title`` and shows them by REST and DICOMweb."""

    def __init__(self, folder: Path, modalities: dict[str, list[Any]]) -> None:
        self.port, self.http = free_port(), free_port()
        folder.mkdir()
        content = {
            **{"Name": "test", "StorageDirectory": str(folder), "IndexDirectory": str(folder)},
            **{"HttpPort": self.http, "RemoteAccessAllowed": False, "AuthenticationEnabled": False},
            **{"DicomPort": self.port, "DicomAet": "ORTHANC", "DicomModalities": modalities},
            **{"DicomAlwaysAllowEcho": False, "DicomAlwaysAllowStore": False, "DicomCheckModalityHost": True},
            **{"Plugins": ["/usr/share/orthanc/plugins/libOrthancDicomWeb.so"], "DicomWeb": {"Enable": True}},
        }
        (folder / "orthanc.json").write_text(json.dumps(content))
        self._process = subprocess.Popen(
            [str(program("Orthanc")), str(folder / "orthanc.json")],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        until(lambda: self._answers())

    @property
    def peer(self) -> dict[str, Any]:
        return {"name": "pacs", "title": "ORTHANC", "port": self.port}

    def get(self, path: str) -> Any:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.http}{path}", timeout=60) as answer:
            content = answer.read()
        return content if path.endswith("/file") else json.loads(content)

    def post(self, path: str, content: bytes) -> Any:
        request = urllib.request.Request(f"http://127.0.0.1:{self.http}{path}", content, method="POST")
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.loads(answer.read())

    def tell(self, method: str, path: str, content: dict[str, Any]) -> Any:
        address, body = f"http://127.0.0.1:{self.http}{path}", json.dumps(content).encode()
        with urllib.request.urlopen(urllib.request.Request(address, body, method=method), timeout=60) as answer:
            return json.loads(answer.read() or b"null")

    def know(self, name: str, title: str, port: int) -> None:
        """Have it know a node at a port, to which it may send, and which may send to it."""
        self.tell("PUT", f"/modalities/{name}", {"AET": title, "Host": "127.0.0.1", "Port": port})

    def instances(self) -> list[FileDataset]:
        files = [self.get(f"/instances/{one}/file") for one in self.get("/instances")]
        return [dcmread(io.BytesIO(content)) for content in files]

    def stop(self) -> None:
        self._process.terminate()
        self._process.wait(120)

    def _answers(self) -> bool:
        try:
            return bool(self.get("/system"))
        except OSError:
            return False
