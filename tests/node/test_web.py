"""What is told of a DICOMweb archive that answers oddly, or without end; nobody waits for it for ever."""

from __future__ import annotations

import shutil
import socket
import ssl
import struct
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from http.server import BaseHTTPRequestHandler
from io import BytesIO
from itertools import repeat
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest
from pydicom.dataset import Dataset

from ronnaplan.errors import InputError
from ronnaplan.node import archives, arrivals, web_answers
from ronnaplan.node.archives import open_archive
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.pull import Wanted, pull
from tests.ct import makers
from tests.node.dicomweb import Answer, Reply, is_list, list_of, web_archive
from tests.node.test_tls import certificate

MULTIPART = 'multipart/related; type="application/dicom"; boundary=X'
HEAD = b"Content-Type: application/dicom\r\n\r\n"


def _file() -> bytes:
    stream = BytesIO()
    makers.save(makers.dataset(0), stream)
    return stream.getvalue()


FILE = _file()
PART = b"--X\r\n" + HEAD + FILE + b"\r\n--X--"


def offset(asked: BaseHTTPRequestHandler) -> int:
    return int(parse_qs(urlsplit(asked.path).query).get("offset", ["0"])[0])


def of_one_study(instances: Callable[[str], Answer]) -> Reply:
    """Answer as an archive of one study of one instance; ``instances`` is given which types are accepted."""

    def reply(asked: BaseHTTPRequestHandler) -> Answer:
        if not is_list(urlsplit(asked.path).path):
            return instances(asked.headers["Accept"])
        told = Dataset()
        told.StudyInstanceUID, told.SeriesInstanceUID = makers.STUDY, makers.SERIES
        told.SOPInstanceUID = makers.dataset(0).SOPInstanceUID
        return list_of([] if offset(asked) else [told.to_json_dict()])

    return reply


def parts(content: Iterable[bytes]) -> Answer:
    return Answer(200, {"Content-Type": MULTIPART}, content)


def of_studies(*uids: str) -> Answer:
    return list_of({"0020000D": {"vr": "UI", "Value": [uid]}} for uid in uids)


def pulled(answer: Answer, folder: Path, **limits: int) -> int:
    """Fetch a study of one instance, which is answered so."""
    config = Config.model_validate({"limits": limits})
    with web_archive(of_one_study(lambda _: answer)) as peer:
        return pull(config, peer, Wanted(study_uid=makers.STUDY), folder)


def found(reply: Reply) -> list[str]:
    with web_archive(reply) as peer:
        return ask(peer)


def ask(peer: Peer) -> list[str]:
    with open_archive(Config(), peer) as archive:
        told = archive.find("STUDY", {"StudyInstanceUID": "", "PatientID": "P-1"})
    return [one.StudyInstanceUID for one in told]


@pytest.mark.parametrize(
    "content",
    [
        [PART],
        [b"This is DICOM in several parts.\r\n\r\nIt has a preamble.\r\n", PART, b"\r\nand an epilogue"],
        [b"\r\n", PART, b"\r\n"],
        [bytes([one]) for one in b"a preamble\r\n" + PART],
    ],
    ids=["plain", "preamble", "empty line", "byte for byte"],
)
def test_an_answer_of_parts_is_read_whatever_stands_before_and_after_them(
    content: list[bytes], tmp_path: Path
) -> None:
    assert pulled(parts(content), tmp_path / "out") == 1


@pytest.mark.parametrize(
    ("status", "kind", "content", "says"),
    [
        (204, "", [], "pacs answered 204 No Content in place of the instances that were asked for; see whether"),
        (
            200,
            MULTIPART,
            [PART.replace(b"\r\n", b"\n")],
            "pacs sent lines that end in LF alone by DICOMweb; expected",
        ),
        (200, MULTIPART, [b"--X--"], "pacs sent no part by DICOMweb"),
        (200, MULTIPART, [FILE * 40], "pacs sent parts by DICOMweb without the boundary that it states"),
        (200, MULTIPART, [b"nothing"], "pacs sent an answer by DICOMweb that was cut short; fetch it again"),
        (200, MULTIPART, [PART[:-2]], "pacs sent an answer by DICOMweb that was cut short; fetch it again"),
    ],
    ids=["no content", "bare LF", "no part", "no boundary", "nothing", "cut short"],
)
def test_an_answer_without_instances_is_told(
    status: int, kind: str, content: list[bytes], says: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=says):
        pulled(Answer(status, {"Content-Type": kind} if kind else {}, content), tmp_path)


def _trickle(slowly: bool) -> Iterator[bytes]:
    yield b"--X\r\n" + HEAD
    while True:
        time.sleep(0.02 * slowly)
        yield b"0" if slowly else bytes(1 << 20)


@pytest.mark.parametrize(
    ("slowly", "says"), [(True, "sent .* bytes by DICOMweb in 0 s"), (False, "sent more than 3 MiB")]
)
@pytest.mark.parametrize("kind", [MULTIPART, "application/dicom"])
def test_an_instance_that_never_ends_is_not_waited_for(
    kind: str, slowly: bool, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_answers, "PATIENCE_S", 0.2)
    with pytest.raises(InputError, match=f"pacs {says}"):
        pulled(Answer(200, {"Content-Type": kind}, _trickle(slowly)), tmp_path, largest_instance_mib=3)
    assert not list(tmp_path.iterdir())


def test_a_list_that_never_ends_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_answers, "LONGEST_LIST", 1 << 20)
    blanks: Iterable[bytes] = repeat(b" " * 4096)
    with pytest.raises(InputError, match="pacs sent more than 1 MiB in one piece"):
        found(lambda _: list_of([])._replace(content=blanks))


@pytest.mark.parametrize("bound", ["MOST_PAGES", "MOST_INSTANCES"])
def test_an_archive_that_has_new_matches_on_every_page_is_not_asked_for_ever(
    bound: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[int]()

    def reply(request: BaseHTTPRequestHandler) -> Answer:
        asked.append(offset(request))
        return of_studies(f"1.2.{asked[-1]}")

    monkeypatch.setattr(archives, bound, 3)
    with pytest.raises(InputError, match="pacs has more matches than it tells, or tells no end of them"):
        found(reply)
    assert len(asked) in (3, 4)


def test_an_archive_that_sends_an_instance_again_and_again_is_not_heard_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrivals, "MOST_COPIES", 3)
    with pytest.raises(InputError, match="instances come without end; fetch less, or see to the archive"):
        pulled(parts(repeat(PART[:-2] + b"\r\n")), tmp_path)


def test_matches_of_several_pages_come_each_once_and_in_their_order() -> None:
    pages = {0: ["1.5", "1.3"], 2: ["1.3", "1.4"], 3: []}
    assert found(lambda asked: of_studies(*pages[offset(asked)])) == ["1.5", "1.3", "1.4"]


def test_who_does_not_know_that_instances_are_wanted_as_stored_is_asked_so_once(tmp_path: Path) -> None:
    accepted = list[str]()

    def instances(accept: str) -> Answer:
        accepted.append(accept)
        return Answer(406, {}, [b"no"]) if "transfer-syntax=*" in accept else parts([PART])

    with web_archive(of_one_study(instances)) as peer, open_archive(Config(), peer) as archive:
        for _ in range(3):
            assert len(archive.fetch([makers.STUDY], tmp_path)) == 1
    assert ["transfer-syntax=*" in one for one in accepted] == [True, False, False, False]


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed to make certificates")
def test_a_certificate_that_nobody_trusts_is_told_and_can_be_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    certificate(tmp_path, "archive")
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    tls.load_cert_chain(tmp_path / "archive.pem", tmp_path / "archive.key")
    with web_archive(lambda asked: of_studies(*(() if offset(asked) else ("1.2",))), tls) as peer:
        with pytest.raises(
            InputError, match=r"pacs shows a certificate that is not trusted \(self-signed certificate"
        ):
            ask(peer)
        monkeypatch.setenv("REQUESTS_CA_BUNDLE", str(tmp_path / "archive.pem"))
        assert ask(peer) == ["1.2"]


def test_a_connection_that_is_reset_is_told_in_the_system_s_words() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def reset() -> None:
            peer = server.accept()[0]
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            peer.close()

        threading.Thread(target=reset).start()
        peer = Peer(name="pacs", url=f"http://127.0.0.1:{server.getsockname()[1]}")
        with pytest.raises(
            InputError, match="pacs cannot be reached by DICOMweb: connection reset by peer; check its"
        ):
            ask(peer)
