"""The audit trail is of the standard's form, says who sent what and what became of it, and goes to syslog, too."""

from __future__ import annotations

import hashlib
import io
import json
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from ronnaplan.errors import InputError
from ronnaplan.node import sender
from ronnaplan.node.audit import Audit, Instances
from ronnaplan.node.hub import run_node
from ronnaplan.node.index import Index
from ronnaplan.node.jobs import Foreman
from ronnaplan.node.logs import Log
from ronnaplan.node.sender import Sender
from tests.node.audit_schema import conforming
from tests.node.peers import configuration
from tests.node.test_jobs import job, work_off


def test_a_message_to_syslog_is_one_of_rfc_5424_with_the_hashes(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(60)
        audit = Audit(tmp_path, f"syslog://127.0.0.1:{server.getsockname()[1]}", "RONNAPLAN", Log(io.StringIO()))
        moved = Instances("1.2.3")
        moved.add("1.2.840.10008.5.1.4.1.1.2", "ab" * 32)
        audit.transferred(moved, source="CT1", destination="RONNAPLAN", peer_address="192.0.2.7")
        packet = server.recv(65_536).decode()
    head = re.match(r"<\d+>1 \S+ \S+ ronnaplan \d+ IHE\+RFC-3881 - \ufeff", packet)
    assert head is not None
    told = conforming(packet[head.end() :])
    assert (told.event, told.action, told.outcome, told.participants) == ("110104", "C", "0", ["CT1", "RONNAPLAN"])
    assert (told.study, told.count) == ("1.2.3", 1)
    assert told.details == {"sha256": hashlib.sha256(b"ab" * 32).hexdigest()}
    assert 'NetworkAccessPointID="192.0.2.7"' in packet
    assert not list(tmp_path.iterdir())


def test_the_trail_says_what_was_done_with_each_scan_and_how_it_ended(
    index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for uid in ("1.4.0", "1.4.2", "1.4.4"):
        job(index, uid)
    config = configuration(
        tmp_path,
        folder=".",
        jobs={"attempts": 2, "retry_s": 0.1},
        rule=[{"name": "all", "receivers": ["pacs"]}],
        peer=[{"name": "pacs", "title": "PACS", "port": 1}],
    )
    foreman = Foreman(config, index, Log(io.StringIO()), "tests.node.fake_work")

    work_off(foreman, index, 60.0)
    (peer,) = config.peer

    @contextmanager
    def closed(*_: object) -> Iterator[None]:
        raise InputError("pacs cannot be reached")
        yield

    monkeypatch.setattr(sender, "open_channel", closed)
    Sender(config, peer, Log(io.StringIO())).deliver(index, time.time())
    lines = (tmp_path / "audit.log").read_text().splitlines()
    told = [conforming(line) for line in lines]
    trail = [
        [
            (one.details["event"], one.action, one.outcome, one.reason, one.count)
            for one in told
            if one.details.get("job") == job
        ]
        for job in "123"
    ]
    good, dies, refused = trail
    assert good == [("started", "R", "0", "", 1), ("done", "C", "0", "", 1)]
    assert [one[:3] for one in dies] == [
        ("started", "R", "0"),
        ("broken", "R", "4"),
        ("started", "R", "0"),
        ("failed", "R", "8"),
    ]
    assert "ended with status 7" in dies[-1][3]
    assert [one[:4] for one in refused] == [("started", "R", "0", ""), ("refused", "R", "4", "no marker")]
    sent = told[-1]
    assert (sent.event, sent.outcome, sent.participants, sent.count) == ("110104", "4", ["RONNAPLAN", "PACS"], 1)
    assert "cannot be reached" in sent.reason
    assert (
        sent.details["sha256"] == next(one for one in told if one.details.get("event") == "done").details["sha256"]
    )


@pytest.mark.parametrize(
    ("address", "kind"), [("192.0.2.7", 2), ("pacs.example", 1), ("https://pacs.example/dicom-web", 5)]
)
def test_what_kind_of_place_a_peer_has_is_told(address: str, kind: int, tmp_path: Path) -> None:
    audit = Audit(tmp_path, "audit.log", "RONNAPLAN", Log(io.StringIO()))
    audit.transferred(Instances("1.2.3"), source="CT1", destination="RONNAPLAN", peer_address=address)
    line = (tmp_path / "audit.log").read_text()
    conforming(line)
    assert f'NetworkAccessPointID="{address}" NetworkAccessPointTypeCode="{kind}"' in line


def test_a_file_counts_by_its_content_and_one_that_is_gone_by_that_of_nothing(tmp_path: Path) -> None:
    (tmp_path / "answer.dcm").write_bytes(b"answer")
    moved = Instances("1.2.3")
    moved.add_file("1.2.840.10008.5.1.4.1.1.66.2", tmp_path / "answer.dcm")
    moved.add_file("1.2.840.10008.5.1.4.1.1.66.2", tmp_path / "gone.dcm")
    assert moved.hashes == [hashlib.sha256(content).hexdigest() for content in (b"answer", b"")]


@pytest.mark.parametrize("target", ["syslog://", "syslog://audit.example:x", "syslog://[1::2", "syslog://a:99999"])
def test_an_address_that_is_none_is_refused(target: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="syslog://HOST:PORT"):
        Audit(tmp_path, target, "RONNAPLAN", Log(io.StringIO()))


def unknown_host(*_: object, **__: object) -> None:
    raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")


@pytest.mark.parametrize(
    ("target", "says"), [("nowhere/audit.log", "No such file"), ("syslog://audit.invalid:514", "not known")]
)
def test_a_node_does_not_start_whose_trail_cannot_be_written(
    target: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", unknown_host)
    path = tmp_path / "node.toml"
    path.write_text(f'folder = "data"\naudit = "{target}"\n')
    says = f"audit trail cannot be written to {re.escape(target)} .*{says}.*correct 'audit'"
    with pytest.raises(InputError, match=says):
        run_node(path, threading.Event(), Log(io.StringIO()))


def test_a_message_that_the_trail_cannot_take_stands_whole_in_the_log_and_the_node_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = io.StringIO()
    audit = Audit(tmp_path, "syslog://audit.invalid:514", "RONNAPLAN", Log(told))
    monkeypatch.setattr(socket, "getaddrinfo", unknown_host)
    audit.transferred(Instances("1.2.3"), source="CT1", destination="RONNAPLAN", peer_address="192.0.2.7")
    audit.stopped()
    moved, stopped = map(json.loads, told.getvalue().splitlines())
    assert moved["event"] == stopped["event"] == "not audited"
    assert "not known" in moved["reason"]
    assert conforming(moved["message"]).study == "1.2.3"
    assert conforming(stopped["message"]).event == "110100"
