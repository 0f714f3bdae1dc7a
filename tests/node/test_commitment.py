"""Promises to keep, given to senders and by receivers; and scanners that say that they are done."""

from __future__ import annotations

import io
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import nullcontext
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from pydicom.config import IGNORE
from pydicom.dataelem import DataElement
from pydicom.dataset import Dataset
from pydicom.uid import CTImageStorage
from pynetdicom import AE, build_role, evt
from pynetdicom.association import Association
from pynetdicom.dimse import DIMSEServiceProvider
from pynetdicom.dimse_primitives import N_EVENT_REPORT

from ronnaplan.errors import InputError
from ronnaplan.node import channels
from ronnaplan.node.association import Checkpoint
from ronnaplan.node.channels import CLASSES
from ronnaplan.node.commitment import (
    ALL_KEPT,
    COMMITMENT,
    NOT_ALL_KEPT,
    WELL_KNOWN,
    begin_asking,
    note_report,
)
from ronnaplan.node.hub import LISTENER
from ronnaplan.node.index import Index
from ronnaplan.node.logs import LISTENING, Log
from ronnaplan.node.sender import Sender
from ronnaplan.node.series import SeriesWatch
from ronnaplan.node.steps import PROCEDURE_STEP
from tests.ct import makers
from tests.node.peers import (
    SENDER,
    Listening,
    Orthanc,
    associate,
    configuration,
    free_port,
    listening,
    needs,
    save,
    send,
    until,
    write_toml,
)
from tests.node.test_delivery import delivered, waiting_answer
from tests.node.test_series import RULE, add, facts, watch


@pytest.fixture
def node(tmp_path: Path) -> Iterator[Listening]:
    with listening(tmp_path / "home", peer=[{**SENDER, "port": 1, "commits_when_done": True}]) as found:
        yield found


@needs("storescu")
def test_an_archive_that_sends_is_told_what_is_kept(orthanc: Orthanc, tmp_path: Path) -> None:
    peer = {**orthanc.peer, "sends": True, "commits_when_done": True}
    with listening(tmp_path, peer=[peer]) as node:
        orthanc.know("node", "RONNAPLAN", node.port)
        paths = [save(makers.dataset(k), tmp_path / f"{k}.dcm") for k in range(2)]
        assert send(node.port, *paths, calling="ORTHANC").count("(Success)") == 2
        for named, status in ((2, "Success"), (3, "Failure")):
            uids = [str(makers.dataset(k).SOPInstanceUID) for k in range(named)]
            wanted = [{"SOPClassUID": str(CTImageStorage), "SOPInstanceUID": uid} for uid in uids]
            asked = orthanc.tell("POST", "/modalities/node/storage-commitment", {"DicomInstances": wanted})
            until(lambda: node.rows("SELECT 1 FROM commitments"))
            with Index(node.folder) as index:
                sender = Sender(node.receiver.config, node.receiver.config.peer[0], node.log)
                sender.report(index, time.time())
                assert index.rows("SELECT 1 FROM commitments") == []
            told = orthanc.get(asked["Path"])
            assert told["Status"] == status
            assert [one["SOPInstanceUID"] for one in told["Success"]] == uids[:2]
            assert [one["SOPInstanceUID"] for one in told["Failures"]] == uids[2:]
        assert node.rows("SELECT instances, expected FROM series") == [(2, 2)]  # complete, as it said so


def test_what_a_receiver_does_not_keep_is_delivered_again(index: Index) -> None:
    add(index, 1, 0.0)
    index.run("INSERT INTO jobs (series, revision, rule, state, due, completed) VALUES (1, 1, 'r', 'done', 0, 0)")
    named = [("1.2", "1.7"), ("1.2", "1.8"), ("1.2", "1.9")]
    for _, uid in named:
        index.run("INSERT INTO answers VALUES (?, 1, 'sr', '1.2', 'x', 0)", uid)
        index.run("INSERT INTO deliveries (answer, receiver, state, due) VALUES (?, 'pacs', 'sent', 0)", uid)
    transaction, request = begin_asking(index, "pacs", named)
    report = Dataset()
    report.TransactionUID = transaction
    # of the first one it says nothing
    report.ReferencedSOPSequence, report.FailedSOPSequence = [[item] for item in request.ReferencedSOPSequence[1:]]
    with pytest.raises(InputError, match="nothing was asked for"):
        note_report(index, "another", report, 10.0, 30.0)
    assert note_report(index, "pacs", report, 10.0, 30.0) == (1, 2)
    states = index.rows("SELECT answer, state FROM deliveries ORDER BY answer")
    assert states == [("1.7", "waiting"), ("1.8", "kept"), ("1.9", "waiting")]
    with pytest.raises(InputError, match="nothing was asked for"):
        note_report(index, "pacs", report, 10.0, 30.0)


@pytest.mark.parametrize("keeps", [True, False])
def test_a_receiver_may_report_on_the_association_on_which_it_was_asked(
    tmp_path: Path, keeps: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its report was refused, and what it does not keep was not delivered again; or it got no answer, or both hung."""
    answered: list[int] = []
    send_msg = DIMSEServiceProvider.send_msg

    def answer_slowly(provider: DIMSEServiceProvider, message: Any, context_id: int) -> None:
        if isinstance(message, N_EVENT_REPORT) and message.is_valid_response:
            time.sleep(0.1)
        send_msg(provider, message, context_id)

    monkeypatch.setattr(DIMSEServiceProvider, "send_msg", answer_slowly)
    monkeypatch.setattr(channels, "REPORT_S", 60.0)  # as long as a crowded machine takes

    def report(association: Association, asked: Dataset) -> None:
        told = Dataset()
        told.TransactionUID = asked.TransactionUID
        setattr(told, "ReferencedSOPSequence" if keeps else "FailedSOPSequence", asked.ReferencedSOPSequence)
        kind = ALL_KEPT if keeps else NOT_ALL_KEPT
        Checkpoint(association).guard()
        answered.append(association.send_n_event_report(told, kind, COMMITMENT, WELL_KNOWN)[0].Status)

    def promise(event: evt.Event) -> tuple[int, None]:
        # once the request is answered
        threading.Timer(0.2, report, (event.assoc, event.action_information)).start()
        return 0, None

    entity = AE("ARCHIVE")
    for sop_class in (*CLASSES, COMMITMENT):
        entity.add_supported_context(sop_class)
    handlers: list[Any] = [(evt.EVT_C_STORE, lambda _: 0), (evt.EVT_N_ACTION, promise)]
    server: Any = entity.start_server(("127.0.0.1", 0), block=False, evt_handlers=handlers)
    try:
        peer = {"name": "archive", "title": "ARCHIVE", "port": server.socket.getsockname()[1]}
        config = configuration(tmp_path, peer=[peer])
        config.data.mkdir()
        with Index(config.data) as index:
            waiting_answer(config, index)
            state = delivered(config, index, 100.0)
        until(lambda: answered)
    finally:
        server.shutdown()
    assert answered == [0]
    assert state == ("kept" if keeps else "waiting it was taken but is not kept")


def test_only_who_is_no_stranger_reports_and_who_sends_no_scans_stores_none(tmp_path: Path) -> None:
    archive = {"name": "pacs", "title": "PACS", "port": 1}
    with listening(tmp_path, peer=[SENDER, archive]) as node:
        entity = AE("PACS")
        entity.add_requested_context(CTImageStorage)
        entity.add_requested_context(COMMITMENT)
        roles: list[Any] = [build_role(COMMITMENT, scp_role=True)]
        association = associate(entity, node.port, ext_neg=roles)
        assert [one.abstract_syntax for one in association.accepted_contexts] == [COMMITMENT]
        report = Dataset()
        report.TransactionUID = "1.2.3"
        status, _ = association.send_n_event_report(report, ALL_KEPT, COMMITMENT, WELL_KNOWN)
        assert status.Status == 0x0110
        association.release()
    assert "nothing was asked for" in node.events("refused")[0]["reason"]


def test_a_scanner_that_says_it_is_done_completes_its_series(node: Listening, tmp_path: Path) -> None:
    entity = AE("CT1")
    entity.add_requested_context(PROCEDURE_STEP)
    association = associate(entity, node.port)
    begun, done, item = Dataset(), Dataset(), Dataset()
    begun.PerformedProcedureStepStatus = "IN PROGRESS"
    done.PerformedProcedureStepStatus = "COMPLETED"
    item.SeriesInstanceUID, item.ReferencedImageSequence = makers.SERIES, [Dataset(), Dataset()]
    done.PerformedSeriesSequence = [item]

    def statuses() -> tuple[int, int]:
        created, _ = association.send_n_create(begun, PROCEDURE_STEP, "1.2.9")
        changed, _ = association.send_n_set(done, PROCEDURE_STEP, "1.2.9")
        return created.Status, changed.Status

    assert association.send_n_set(done, PROCEDURE_STEP, "1.2.9")[0].Status == 0x0112
    assert statuses() == (0, 0)
    assert statuses() == (0x0111, 0x0110)
    association.release()
    with Index(node.folder) as index:
        watched = watch(index, tmp_path)
        for k, complete in ((0, []), (1, [(2, 2)])):
            with index.transaction():
                given = facts(k, series_uid=makers.SERIES)
                index.add(given, f"{k}.dcm", "CT1", "RONNAPLAN", 100.0)
            watched.tick(100.0 + 11.0)  # quiet, but not all there
            assert index.rows("SELECT instances, complete FROM series WHERE complete > 0") == complete


@pytest.mark.filterwarnings("ignore:Invalid value for VR UI:UserWarning")  # here, where it is made
def test_a_step_that_is_told_in_values_that_are_none_leaves_no_warning_among_the_log(tmp_path: Path) -> None:
    port, begun, item = free_port(), Dataset(), Dataset()
    begun.PerformedProcedureStepStatus = "IN PROGRESS"
    done = deepcopy(begun)
    done.PerformedProcedureStepStatus = "COMPLETED"
    item.add(DataElement("SeriesInstanceUID", "UI", "none", validation_mode=IGNORE))
    item.ReferencedImageSequence, done.PerformedSeriesSequence = [Dataset()], [item]
    receiver = subprocess.Popen(
        [sys.executable, "-m", LISTENER, str(write_toml(tmp_path, port))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert receiver.stdout is not None
    assert LISTENING in receiver.stdout.readline()
    entity = AE("CT1")
    entity.add_requested_context(PROCEDURE_STEP)
    association = associate(entity, port)
    assert association.send_n_create(begun, PROCEDURE_STEP, "1.2.9")[0].Status == 0
    assert association.send_n_set(done, PROCEDURE_STEP, "1.2.9")[0].Status == 0
    association.release()
    assert receiver.communicate(timeout=60)[1] == ""


def test_a_series_that_misses_instances_for_too_long_is_worked_on_all_the_same(
    index: Index, tmp_path: Path
) -> None:
    index.announce("1.4", 3, 90.0)
    add(index, 1, 100.0)
    watched: SeriesWatch = watch(index, tmp_path)
    watched.tick(219.0)
    assert index.rows("SELECT 1 FROM jobs") == []
    watched.tick(221.0)
    assert index.rows("SELECT revision FROM jobs") == [(1,)]
    assert configuration(tmp_path, rule=[RULE]).missing_s == 120.0


class Going:
    """A way to a receiver that takes what is sent, and goes when it is asked to keep it."""

    commits = True

    def send(self, path: Path) -> None:
        pass

    def ask(self, request: Dataset) -> None:
        raise ConnectionError("it is gone")


def test_a_receiver_that_goes_before_it_promises_anything_gets_the_answer_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ronnaplan.node.sender.open_channel", lambda *_: nullcontext(Going()))
    config = configuration(tmp_path, peer=[{"name": "archive", "port": 1}])
    config.data.mkdir()
    with Index(config.data) as index:
        waiting_answer(config, index)
        assert delivered(config, index, 1.0) == "waiting it was taken but is not kept"
        assert index.rows("SELECT 1 FROM asked") == []


def test_a_receiver_that_goes_whenever_it_is_asked_does_not_get_the_answer_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Orthanc does, which offers storage commitment to all and grants it to those alone whom it lists."""
    monkeypatch.setattr("ronnaplan.node.sender.open_channel", lambda *_: nullcontext(Going()))
    config = configuration(tmp_path, peer=[{"name": "archive", "port": 1}])
    config.data.mkdir()
    with Index(config.data) as index:
        waiting_answer(config, index)
        sender = Sender(config, config.peer[0], Log(io.StringIO()))
        for number in range(config.jobs.attempts):
            sender.deliver(index, 1e5 * (number + 1))
            assert index.rows("SELECT state FROM deliveries") == [("waiting",)]
        sender.deliver(index, 1e6)
        assert index.rows("SELECT state FROM deliveries") == [("sent",)]
        assert index.rows("SELECT 1 FROM asked") == []


class Wavering(Going):
    """A way to a receiver that goes as often as it may, is then there, and goes again."""

    def __init__(self, *answers: bool) -> None:
        self.answers = iter(answers)

    def ask(self, request: Dataset) -> None:
        if not next(self.answers):
            super().ask(request)


def test_a_receiver_that_was_asked_in_between_goes_for_the_first_time_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = configuration(tmp_path, peer=[{"name": "archive", "port": 1}])
    config.data.mkdir()
    often = config.jobs.attempts
    receiver = Wavering(*often * [False], True, *often * [False])
    monkeypatch.setattr("ronnaplan.node.sender.open_channel", lambda *_: nullcontext(receiver))
    with Index(config.data) as index:
        waiting_answer(config, index)
        sender = Sender(config, config.peer[0], Log(io.StringIO()))
        for number in range(2 * often + 1):
            index.run("UPDATE deliveries SET state = 'waiting', due = 0")
            sender.deliver(index, 1e5 * (number + 1))
            taken = number == often
            assert index.rows("SELECT state FROM deliveries") == [("sent" if taken else "waiting",)]
