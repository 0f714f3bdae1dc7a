"""An archive that answers less, later or other than it was asked for is not taken at its word."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from copy import deepcopy
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlparse

import pytest
from pydicom import dcmread
from pydicom.dataset import Dataset
from pynetdicom import AE, evt

from ronnaplan.ct.system_folders import UNFINISHED
from ronnaplan.ct.uids import CT_IMAGE
from ronnaplan.errors import InputError, UsageError
from ronnaplan.node.archives import FIND, GET, MOVE, open_archive
from ronnaplan.node.channels import open_channel
from ronnaplan.node.config import Config, Limits, Peer
from ronnaplan.node.pull import Wanted, pull
from tests.ct import makers
from tests.node.dicomweb import Answer, is_list, list_of, web_archive
from tests.node.peers import free_port

PATIENT = Wanted(patient_id="P-1")
UIDS = {"STUDY": "StudyInstanceUID", "SERIES": "SeriesInstanceUID", "IMAGE": "SOPInstanceUID"}


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> list[Dataset]:
    def named(made: Any, _: int) -> None:
        made.PatientID, made.StudyDate = "P-1", "20260102"

    folder = makers.write_series(tmp_path_factory.mktemp("scan") / "ct", change=named)
    return [dcmread(path) for path in sorted(folder.iterdir())]


@dataclass
class Web:
    """What a DICOMweb archive has, sends, and how."""

    has: list[Dataset]
    sends: list[Dataset]
    page: int = 100
    knows_offset: bool = True
    end: bytes = b"\r\n--b--\r\n"
    cut: int = 0
    stored: tuple[int, Dataset | None] = (200, None)

    def search(self, path: str, query: dict[str, list[str]]) -> tuple[list[Any], bool]:
        level = "IMAGE" if "/series/" in path else "SERIES" if "/studies/" in path else "STUDY"
        found = {}
        for one in self.has:
            told = Dataset()
            for keyword in (UIDS[level], "PatientID", "StudyDate"):
                setattr(told, keyword, one.get(keyword))
            found[told[UIDS[level]].value] = told.to_json_dict()
        first = int(query.get("offset", ["0"])[0]) if self.knows_offset else 0
        last = first + self.page
        return list(found.values())[first:last], last < len(found)

    def retrieve(self) -> bytes:
        parts = []
        for one in self.sends:
            file = io.BytesIO()
            one.save_as(file, enforce_file_format=True)
            parts.append(b"\r\n--b\r\nContent-Type: application/dicom\r\n\r\n" + file.getvalue())
        return (b"".join(parts) + self.end)[: -self.cut or None]


def serving(web: Web) -> AbstractContextManager[Peer]:
    def reply(asked: BaseHTTPRequestHandler) -> Answer:
        address = urlparse(asked.path)
        if asked.command == "POST":
            status, told = web.stored
            return list_of([])._replace(status=status, content=[b"" if told is None else told.to_json().encode()])
        if is_list(address.path):
            found, more = web.search(address.path, parse_qs(address.query))
            return list_of(found, **({"Warning": '299 archive "There are additional results"'} if more else {}))
        kind = 'multipart/related; type="application/dicom"; boundary="b"'
        return Answer(200, {"Content-Type": kind}, [web.retrieve()])

    return web_archive(reply)


def test_a_list_in_pages_is_read_to_its_end(scan: list[Dataset]) -> None:
    keys = {"StudyInstanceUID": makers.STUDY, "SeriesInstanceUID": makers.SERIES, "SOPInstanceUID": ""}
    for page, knows_offset in ((3, True), (100, False)):
        with serving(Web(scan, scan, page, knows_offset)) as peer, open_archive(Config(), peer) as archive:
            assert len(archive.find("IMAGE", keys)) == len(scan)
    with (
        serving(Web(scan, scan, 3, knows_offset=False)) as peer,
        open_archive(Config(), peer) as archive,
        pytest.raises(InputError, match="more matches than it tells"),
    ):
        archive.find("IMAGE", keys)


def test_an_answer_by_dicomweb_that_lacks_anything_is_an_error(scan: list[Dataset], tmp_path: Path) -> None:
    with serving(Web(scan, scan)) as peer:
        assert pull(Config(), peer, PATIENT, tmp_path) == len(scan)
    with serving(Web(scan, scan[:-1])) as peer, pytest.raises(InputError, match="lists 4 instances and sent 3"):
        pull(Config(), peer, PATIENT, tmp_path)
    with serving(Web(scan, scan, cut=60)) as peer, pytest.raises(InputError, match="was cut short"):
        pull(Config(), peer, PATIENT, tmp_path)


def test_a_study_that_does_not_come_whole_leaves_no_part_of_it(scan: list[Dataset], tmp_path: Path) -> None:
    """What was there stays; files of one name are those that came last."""
    (tmp_path / f"{scan[0].SOPInstanceUID}.dcm").write_bytes(b"an earlier one")
    (tmp_path / makers.STUDY).mkdir()
    (tmp_path / f"{makers.STUDY}.whole").mkdir()
    (tmp_path / f"{makers.STUDY}.whole" / "1.2.3.dcm").touch()  # of a program that was killed at the end
    before = sorted(tmp_path.rglob("*"))
    with serving(Web(scan, scan[:-1])) as peer, pytest.raises(InputError, match="lists 4 instances and sent 3"):
        pull(Config(), peer, PATIENT, tmp_path)
    assert sorted(tmp_path.rglob("*")) == before
    left = tmp_path / UNFINISHED / makers.STUDY / "1.2.3.dcm"  # by a program that was killed
    left.parent.mkdir(parents=True)
    left.write_bytes(b"a part")
    with serving(Web(scan, scan)) as peer:
        assert pull(Config(), peer, PATIENT, tmp_path) == len(scan)
    (tmp_path / makers.STUDY).rmdir()  # somebody's own
    assert {path.name for path in tmp_path.iterdir()} == {f"{one.SOPInstanceUID}.dcm" for one in scan}
    assert all(dcmread(path).PatientID == "P-1" for path in tmp_path.iterdir())


class Odd(Web):
    """An archive whose lists, and instances, are none."""

    listed: Any = None
    content: bytes = b""

    def search(self, path: str, query: dict[str, list[str]]) -> tuple[Any, bool]:
        return super().search(path, query) if self.listed is None else (self.listed, False)

    def retrieve(self) -> bytes:
        return b"--b\r\n\r\n" + self.content + b"\r\n--b--\r\n"


def test_an_answer_by_dicomweb_that_is_none_is_told_in_a_sentence(scan: list[Dataset], tmp_path: Path) -> None:
    for listed in ([1, 2], {"a": 1}, [None], [{"0020000D": {"vr": "UI", "Value": [{"a": 1}]}}]):
        odd = Odd(scan, scan)
        odd.listed = listed
        with (
            serving(odd) as peer,
            pytest.raises(InputError, match=r"pacs sent what cannot be read \(.*; check its"),
        ):
            pull(Config(), peer, PATIENT, tmp_path)
    for content in (b"no DICOM", bytes(128) + b"DICM"):
        odd = Odd(scan, scan)
        odd.content = content
        with serving(odd) as peer, pytest.raises(InputError, match="pacs sent what cannot be read"):
            pull(Config(), peer, PATIENT, tmp_path)


def test_what_was_not_asked_for_is_no_answer(scan: list[Dataset], tmp_path: Path) -> None:
    with serving(Web(scan, scan)) as peer:
        for other, keyword in ((Wanted(patient_id="P-2"), "PatientID"), (Wanted(date="20260103-"), "StudyDate")):
            with pytest.raises(InputError, match=f"another {keyword}"):
                pull(Config(), peer, other, tmp_path)
        assert pull(Config(), peer, Wanted(patient_id="p-?", date="20260101-20260102"), tmp_path) == len(scan)
    foreign = deepcopy(scan[0])
    foreign.StudyInstanceUID = "1.2.3.404"
    with serving(Web(scan, [*scan, foreign])) as peer, pytest.raises(InputError, match="was not asked for"):
        pull(Config(), peer, PATIENT, tmp_path / "other")
    with pytest.raises(UsageError, match="is no date"):
        pull(Config(), peer, Wanted(date="2026-01-02"), tmp_path)


@contextmanager
def dimse(scan: list[Dataset], sent: list[Dataset], own: int) -> Iterator[tuple[Peer, list[Dataset]]]:
    """An archive that says that all is done, whatever it sends; to C-MOVE it says so before it has sent anything."""
    asked: list[Dataset] = []
    later: list[threading.Thread] = []

    def find(event: evt.Event) -> Iterator[tuple[int, Dataset | None]]:
        asked.append(event.identifier)
        uid = UIDS[event.identifier.QueryRetrieveLevel]
        for one in {str(each[uid].value): each for each in scan}.values():
            told = Dataset()
            setattr(told, uid, one[uid].value)
            yield 0xFF00, told

    def get(_: evt.Event) -> Iterator[Any]:
        yield len(sent)
        for one in sent:
            yield 0xFF00, one

    def move(_: evt.Event) -> Iterator[Any]:
        def bring() -> None:
            entity = AE("PACS")
            entity.add_requested_context(CT_IMAGE)
            association = entity.associate("127.0.0.1", own, ae_title="RONNAPLAN")
            for one in sent:
                association.send_c_store(one)
            association.release()

        later.append(threading.Thread(target=bring))
        later[-1].start()
        yield "127.0.0.1", own
        yield 0

    entity = AE("PACS")
    for uid in (FIND, GET, MOVE):
        entity.add_supported_context(uid)
    entity.add_supported_context(CT_IMAGE, scu_role=True, scp_role=True)
    handlers: list[Any] = [(evt.EVT_C_FIND, find), (evt.EVT_C_GET, get), (evt.EVT_C_MOVE, move)]
    server: Any = entity.start_server(("127.0.0.1", 0), block=False, evt_handlers=handlers)
    try:
        yield Peer(name="pacs", title="PACS", port=server.server_address[1]), asked
    finally:
        for thread in later:
            thread.join()
        server.shutdown()


def test_an_archive_that_says_done_too_early_is_waited_for_and_one_that_sends_less_is_told(
    scan: list[Dataset], tmp_path: Path
) -> None:
    config = Config(port=free_port())
    with dimse(scan, scan, config.port) as (peer, asked):
        assert pull(config, peer, Wanted(patient_id="MÜ漢1"), tmp_path, by="move") == len(scan)
        assert asked[0].PatientID == "MÜ漢1"  # not M??1, which fits others
    for way, silent_s in (("get", 30.0), ("move", 3.0)):  # so long the second waits for more
        with (
            dimse(scan, scan[1:], config.port) as (peer, _),
            pytest.raises(InputError, match="lists 4 instances and sent 3"),
        ):
            pull(config.model_copy(update={"limits": Limits(silent_s=silent_s)}), peer, PATIENT, tmp_path, by=way)


def test_an_answer_that_dicomweb_does_not_say_to_have_stored_is_not_delivered(
    scan: list[Dataset], tmp_path: Path
) -> None:
    path = tmp_path / "answer.dcm"
    scan[0].save_as(path, enforce_file_format=True)

    def told(keyword: str, uid: str, reason: int = 0) -> Dataset:
        answer, item = Dataset(), Dataset()
        item.ReferencedSOPInstanceUID = uid
        if reason:
            item.FailureReason = reason
        setattr(answer, keyword, [item])
        return answer

    own = str(scan[0].SOPInstanceUID)
    stored, failed = told("ReferencedSOPSequence", own), told("FailedSOPSequence", own, 0xA700)
    there = told("FailedSOPSequence", own, 0x0111)
    for answer in ((200, None), (200, stored), (202, stored), (202, there), (409, there)):
        with serving(Web([], [], stored=answer)) as peer, open_channel(Config(), peer, print) as channel:
            channel.send(path)
    unsure = ((202, None), (202, told("ReferencedSOPSequence", "1.2.404")))
    for answer, why in (
        (unsure[0], "does not say"),
        (unsure[1], "does not say"),
        ((202, failed), "answered A700"),
        ((409, failed), "answered A700"),
        ((409, None), "answered 409 Conflict"),
        ((409, stored), "answered 409 Conflict"),
    ):
        with (
            serving(Web([], [], stored=answer)) as peer,
            open_channel(Config(), peer, print) as channel,
            pytest.raises(InputError, match=why),
        ):
            channel.send(path)
