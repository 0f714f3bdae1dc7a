"""Jobs that break, hang or take too much are tried again, then given up, and keep no other one waiting."""

from __future__ import annotations

import errno
import io
import json
import os
import queue
import signal
import sqlite3
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from pydicom.dataset import FileDataset

from ronnaplan.documents import dicom_spatial, files
from ronnaplan.errors import InputError, RefusedError, UnwrittenError
from ronnaplan.jobs.serving import _serve
from ronnaplan.node import work
from ronnaplan.node.config import Rule
from ronnaplan.node.index import LONGEST_WAIT_S, Index
from ronnaplan.node.jobs import Foreman, retry, wait_s
from ronnaplan.node.logs import Log
from ronnaplan.node.work import Order
from tests.cohort.scans import phantom
from tests.long import few_or_all
from tests.node.peers import configuration, until
from tests.node.test_series import facts

SCANS = {"1.4.0": "good", "1.4.1": "hangs", "1.4.2": "dies", "1.4.3": "greedy", "1.4.4": "refused"}


@pytest.fixture
def index(tmp_path: Path) -> Iterator[Index]:
    (tmp_path / "node-data").mkdir()
    with Index(tmp_path / "node-data") as found:
        yield found


def job(index: Index, series_uid: str) -> None:
    number = int(series_uid[-1])
    with index.transaction():
        index.add(facts(number, series_uid=series_uid), f"{number}.dcm", "CT1", "RONNAPLAN", 0.0)
        index.run(
            "INSERT INTO jobs (series, revision, rule, state, due, completed)"
            " SELECT id, 1, 'all', 'waiting', 0, 0 FROM series WHERE series_uid = ?",
            series_uid,
        )


def states(index: Index) -> dict[str, tuple[str, int]]:
    rows = index.rows("SELECT series_uid, state, attempts FROM jobs JOIN series ON series = series.id")
    return {SCANS[uid]: (state, attempts) for uid, state, attempts in rows}


def work_off(foreman: Foreman, index: Index, seconds: float) -> None:
    """Have all jobs done, or given up, and the workers ended."""

    def over() -> bool:
        with suppress(sqlite3.OperationalError):  # as the hub does
            foreman.tick(time.time())
        return all(state not in ("waiting", "running") for state, _ in states(index).values())

    try:
        until(over, seconds)
    finally:
        foreman.close()


def test_files_that_are_no_answers_are_removed_at_the_start_and_with_their_job(
    index: Index, tmp_path: Path
) -> None:
    config = configuration(tmp_path, rule=[{"name": "all"}])
    answers = config.data / "answers"
    (answers / "9").mkdir(parents=True)
    (answers / "9" / "y.dcm").write_bytes(b"of a node that was killed")
    (answers / "9" / "ronnaplan-1" / "profile").mkdir(parents=True)
    (answers / "9" / "ronnaplan-1" / "report.html").write_text("as it was printed")
    (answers / "9" / "ronnaplan-1" / "profile" / "SingletonLock").symlink_to("a browser that is gone")
    job(index, "1.4.0")
    foreman = Foreman(config, index, Log(io.StringIO()), "tests.node.fake_work")
    assert not list(answers.rglob("*"))
    work_off(foreman, index, 60.0)
    assert states(index)["good"][0] == "done"
    assert [path.name for path in answers.rglob("*.*")] == ["x.dcm"]


def test_no_job_keeps_another_one_waiting_and_each_ends_as_it_should(index: Index, tmp_path: Path) -> None:
    for uid in ("1.4.1", "1.4.2", "1.4.3", "1.4.4", "1.4.0"):
        job(index, uid)
    index.note_lacking(facts(7, series_uid="1.4.0"), 0.0)
    said = io.StringIO()
    limits = {"attempts": 2, "retry_s": 0.1, "seconds": 2.0, "workers": 1, "memory_mib": 256}
    rule = {"name": "all", "receivers": ["pacs"]}
    peers = [{"name": "pacs", "port": 1}]
    config = configuration(tmp_path, jobs=limits, rule=[rule], peer=peers)
    foreman = Foreman(config, index, Log(said), "tests.node.fake_work")

    work_off(foreman, index, 120.0)
    expected = {"good": ("done", 1), "hangs": ("failed", 2), "dies": ("failed", 2), "refused": ("refused", 1)}
    if sys.platform != "win32":
        expected["greedy"] = ("failed", 2)
    found = states(index)
    assert {name: found[name] for name in expected} == expected
    reasons = dict(index.rows("SELECT series_uid, reason FROM jobs JOIN series ON series = series.id"))
    assert "took longer than 2 s" in reasons["1.4.1"]
    assert "ended with status 7" in reasons["1.4.2"]
    assert reasons["1.4.4"] == "no marker"
    lacks = "1 instance of it did not come again, for which there was no room"
    assert reasons["1.4.0"] == f"6 markers; no pdf: no browser; {lacks}"
    assert index.rows("SELECT kind, receiver, state FROM answers JOIN deliveries ON answer = sop_uid") == [
        ("sr", "pacs", "waiting")
    ]
    lines = [json.loads(line) for line in said.getvalue().splitlines()]
    assert [line["reason"] for line in lines if line["event"] == "left empty"] == ["no birth date"]
    ended = [line["state"] for line in lines if line["event"] == "job ended"]
    assert sorted(ended) == ["done", "failed", "failed", "failed", "refused"]
    (refused,) = (number for (number,) in index.rows("SELECT id FROM jobs WHERE state = 'refused'"))
    assert retry(index, refused)
    assert not retry(index, refused)
    assert states(index)["refused"] == ("waiting", 0)


def test_a_clock_that_is_set_back_keeps_no_worker_from_being_hired_or_ended(index: Index, tmp_path: Path) -> None:
    job(index, "1.4.1")
    limits = {"seconds": 2.0, "workers": 1}
    config = configuration(tmp_path, jobs=limits, rule=[{"name": "all"}])
    foreman = Foreman(config, index, Log(io.StringIO()), "tests.node.no_such_worker")

    def ended(now: float) -> bool:
        foreman.tick(now)
        return not foreman.pids

    try:
        foreman.tick(90_000.0)
        until(lambda: ended(90_000.0))
        foreman.set_clock_back(1000.0)
        foreman.tick(1002.0)
        assert foreman.pids
        (worker,) = foreman._workers.values()
        worker.last = 90_002.0
        foreman.set_clock_back(1003.0)
        assert worker.last == 1005.0
    finally:
        foreman.close()


class FullDisk(Index):
    """An index that does not take what `statement` begins with, the first time."""

    statement = ""

    def run(self, sql: str, *values: Any) -> int:
        if self.statement and sql.startswith(self.statement):
            self.statement = ""
            raise sqlite3.OperationalError("database or disk is full")
        return super().run(sql, *values)


@pytest.mark.parametrize("statement", ["INSERT INTO answers", "UPDATE jobs SET state = ?, reason = ?"])
def test_what_a_full_disk_keeps_from_being_noted_is_noted_later(tmp_path: Path, statement: str) -> None:
    config = configuration(tmp_path, rule=[{"name": "all"}])
    config.data.mkdir()
    with FullDisk(config.data) as index:
        job(index, "1.4.0")
        index.statement = statement
        work_off(Foreman(config, index, Log(io.StringIO()), "tests.node.fake_work"), index, 60.0)
        assert states(index)["good"][0] == "done"
        assert not index.statement
        assert index.rows("SELECT kind FROM answers") == [("sr",)]


def test_a_job_waits_for_room_longer_than_its_attempts(index: Index, tmp_path: Path) -> None:
    job(index, "1.4.0")
    (tmp_path / "full").touch()
    config = configuration(tmp_path, jobs={"attempts": 1, "retry_s": 0.1}, rule=[{"name": "all"}])
    foreman = Foreman(config, index, Log(io.StringIO()), "tests.node.fake_work")

    def reached(state: str, attempts: int) -> bool:
        foreman.tick(time.time())
        return states(index)["good"] == (state, attempts)

    try:
        until(lambda: reached("waiting", 2), 60.0)
        (tmp_path / "full").unlink()
        until(lambda: reached("done", 3), 60.0)
    finally:
        foreman.close()


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (UnwrittenError("no room"), ["ready", "broken", "passes"]),
        (OSError(errno.ENOSPC, "no room"), ["ready", "broken", "passes"]),
        (OSError(errno.EBADF, "a fault of ours"), ["ready", "broken"]),
    ],
)
def test_an_answer_that_cannot_be_written_now_is_made_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, expected: list[str]
) -> None:
    class OverError(Exception):
        pass

    told: list[str] = []

    def tell(event: str, **facts: Any) -> None:
        told.append(facts.get("state", event))
        told.extend(["passes"] if facts.get("passes") else [])
        if event == "ended":
            raise OverError

    def refuse(*_: object) -> None:
        raise error

    made = FileDataset("made.dcm", {})
    made.SOPInstanceUID = made.SOPClassUID = "1.2"
    monkeypatch.setattr(files, "write_atomically", refuse)
    monkeypatch.setattr(dicom_spatial, "dicom_bytes", lambda _: b"")
    given = Order(1, tmp_path, 0, tmp_path, tmp_path / "answers", Rule(name="r"), ())
    orders: queue.SimpleQueue[str] = queue.SimpleQueue()
    orders.put(given.text)
    with pytest.raises(OverError):
        _serve(orders, tell, lambda: None, lambda _, tell: work._answer(given, "sr", lambda: made, tell), None)
    assert told == expected


@pytest.mark.parametrize("goes", ["before", "while it is read"])
def test_a_job_whose_files_are_gone_is_refused_and_waits_where_all_of_the_node_s_folder_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, goes: str
) -> None:
    kept = tmp_path / "instances"
    folder = phantom(kept / "1.3" / "1.4.0")
    given = Order(1, folder, len(list(folder.iterdir())), tmp_path, tmp_path / "answers", Rule(name="r"), ())

    def go(*_: object) -> None:
        if kept.exists():
            kept.rename(tmp_path / "moved")
        raise InputError("a file cannot be read")

    if goes == "before":
        kept.rename(tmp_path / "moved")
    monkeypatch.setattr(work, "_find", go)
    with pytest.raises(UnwrittenError, match="instances is not there; see to its disk"):
        work.begin(given, lambda *_, **__: None)
    (tmp_path / "moved").rename(kept)
    (folder / sorted(folder.iterdir())[0]).unlink()
    with pytest.raises(RefusedError, match=r"1 of its .* files are gone from the node's folder; send it again"):
        work.begin(given, lambda *_, **__: None)


def test_a_job_of_a_series_that_has_grown_is_not_begun(index: Index, tmp_path: Path) -> None:
    job(index, "1.4.0")
    index.run("UPDATE series SET revision = 2")
    foreman = Foreman(
        configuration(tmp_path, rule=[{"name": "all"}]), index, Log(io.StringIO()), "tests.node.fake_work"
    )

    def over() -> bool:
        foreman.tick(1.0)
        return states(index) == {"good": ("outdated", 0)}

    try:
        until(over)
    finally:
        foreman.close()


def test_a_worker_is_there_for_what_comes_in_or_waits_and_gone_afterwards(index: Index, tmp_path: Path) -> None:
    config = configuration(tmp_path, jobs={"workers": 3}, rule=[{"name": "all", "calling": "CT1"}])
    foreman = Foreman(config, index, Log(io.StringIO()), "tests.node.fake_work")

    def workers(now: float) -> int:
        foreman.tick(now)
        return len(foreman.pids)

    try:
        assert workers(1.0) == 0
        index.add(facts(5, series_uid="1.4.5"), "5.dcm", "OTHER", "RONNAPLAN", 0.0)
        assert workers(2.0) == 0, "no rule is for it"
        index.add(facts(6, series_uid="1.4.6"), "6.dcm", "CT1", "RONNAPLAN", 0.0)
        assert workers(3.0) == 1
        index.run("UPDATE series SET complete = revision")
        job(index, "1.4.0")
        until(lambda: workers(4.0) == 2 or states(index)["good"][0] == "done")
        index.run("UPDATE series SET complete = revision")
        until(lambda: workers(5.0) == 0 and states(index)["good"][0] == "done")
    finally:
        foreman.close()


def test_what_a_killed_node_was_working_on_is_done_again(index: Index, tmp_path: Path) -> None:
    job(index, "1.4.0")
    index.run("UPDATE jobs SET state = 'running'")
    Foreman(configuration(tmp_path), index, Log(io.StringIO()), "tests.node.fake_work").close()
    assert states(index) == {"good": ("waiting", 0)}


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="processes are killed in another way")
@few_or_all("kills", 1, 2)
def test_a_worker_that_is_killed_amid_its_answers_makes_the_others_and_none_twice(
    index: Index, tmp_path: Path, kills: int
) -> None:
    job(index, "1.4.0")
    rule = {"name": "all", "diameters": [11.5], "answers": ["fiducials", "sr", "sheet"]}
    config = configuration(tmp_path, rule=[rule], jobs={"retry_s": 0.1})
    phantom(config.data / "instances" / "1.3" / "1.4.0")
    said = io.StringIO()
    foreman = Foreman(config, index, Log(said), work.MODULE)
    killed: list[int] = []

    def over() -> bool:
        foreman.tick(time.time())
        made = index.value("SELECT count(*) FROM answers")
        if len(killed) < min(made, kills):  # at first by what found the markers, then by what made an answer
            killed.extend(foreman.pids)
            os.kill(foreman.pids[0], signal.SIGKILL)
        return states(index)["good"][0] == "done"

    try:
        until(over, 600.0)  # several programs are loaded one after the other, on a crowded machine slowly
    finally:
        foreman.close()
    assert states(index) == {"good": ("done", 1 + kills)}
    told = [line["kind"] for line in map(json.loads, said.getvalue().splitlines()) if line["event"] == "answer"]
    assert told == ["fiducials", "sr", "sheet"]
    assert len(list((config.data / "answers").rglob("*.dcm"))) == 3


def test_waits_double_up_to_an_hour() -> None:
    assert [wait_s(n, 30.0) for n in (1, 2, 3)] == [30.0, 60.0, 120.0]
    assert wait_s(50, 30.0) == LONGEST_WAIT_S
