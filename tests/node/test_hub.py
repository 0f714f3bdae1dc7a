"""The node as a program: receives, survives its receiver's death, and nothing outlives it."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ronnaplan.cli import main
from ronnaplan.errors import InputError
from ronnaplan.node import hub as hub_module
from ronnaplan.node.hub import Hub, run_node
from ronnaplan.node.index import FILE, Index
from ronnaplan.node.jobs import JobRow, Worker
from ronnaplan.node.logs import Log
from tests.ct import makers
from tests.long import few_and_others
from tests.node.peers import configuration, free_port, needs, save, send, until, write_toml
from tests.node.test_series import add


@needs("storescu")
def test_a_node_receives_through_its_receiver_s_death_and_ends_whole(tmp_path: Path) -> None:
    port = free_port()
    config = write_toml(tmp_path, port)
    log = tmp_path / "log"
    with log.open("w") as stream:
        node = subprocess.Popen(
            [sys.executable, "-m", "ronnaplan", "node", "--config", str(config)], stderr=stream
        )

    def events(kind: str) -> list[dict[str, object]]:
        return [one for one in map(json.loads, log.read_text().splitlines()) if one["event"] == kind]

    try:
        until(lambda: events("listening"))
        assert main(["node", "--config", str(config)]) == 1  # another one has the folder
        assert "(Success)" in send(port, save(makers.dataset(0), tmp_path / "0.dcm"))
        until(lambda: events("complete"))
        (receiver,) = (tmp_path / "node-data").glob("receiver.pid")
        os.kill(int(receiver.read_text()), signal.SIGTERM)
        until(lambda: len(events("listening")) == 2)
        assert "(Success)" in send(port, save(makers.dataset(1), tmp_path / "1.dcm"))
        until(lambda: len(events("complete")) == 2)
    finally:
        node.terminate()
        assert node.wait(120) == 0
    assert events("stopped")
    with Index(tmp_path / "node-data") as index:
        assert index.rows("SELECT instances, revision, complete FROM series") == [(2, 2, 2)]


@pytest.mark.skipif(sys.platform == "win32", reason="a process is sent no signals there")
@few_and_others("how", [signal.SIGINT], [signal.SIGTERM])  # by which the test before ends its node
def test_a_node_is_stopped_by_ctrl_c_as_by_a_signal_and_says_so(tmp_path: Path, how: int) -> None:
    config = write_toml(tmp_path, free_port())
    with subprocess.Popen(
        [sys.executable, "-m", "ronnaplan", "node", "--config", str(config)], stderr=subprocess.PIPE, text=True
    ) as node:
        assert node.stderr is not None
        until(lambda: "listening" in node.stderr.readline())  # type: ignore[union-attr]
        node.send_signal(how)
        said = node.stderr.read()
    assert [json.loads(line)["event"] for line in said.splitlines()] == ["stopped"]
    assert node.returncode == 0


def test_a_template_that_is_not_there_and_a_rule_never_reached_are_told_at_the_start(tmp_path: Path) -> None:
    path = tmp_path / "node.toml"
    path.write_text(
        "[[rule]]\nname = 'frame'\ntemplate = 'frame.json'\n[[rule]]\nname = 'here'\ntemplate = 'node.toml'\n"
    )
    stop, told = threading.Event(), io.StringIO()
    stop.set()
    run_node(path, stop, Log(told))
    lines = [json.loads(line) for line in told.getvalue().splitlines()]
    missing = [(one["rule"], one["file"]) for one in lines if one["event"] == "no template"]
    assert missing == [("frame", str(tmp_path / "frame.json"))]
    hidden = [(one["rule"], one["behind"]) for one in lines if one["event"] == "rule never reached"]
    assert hidden == [("here", "frame")]


def test_an_index_that_is_gone_or_damaged_is_told_and_costs_no_scan(tmp_path: Path) -> None:
    path, stop = tmp_path / "node.toml", threading.Event()
    path.write_text("page_port = 0\n")
    stop.set()
    scan = tmp_path / "node-data" / "instances" / "1.2" / "1.3" / "1.4.dcm"
    scan.parent.mkdir(parents=True)
    scan.write_bytes(b"acknowledged")
    for _ in ("gone", "empty"):
        with pytest.raises(InputError, match=r"index\.sqlite is gone or empty, but scans lie in .*; put it back"):
            run_node(path, stop, Log(io.StringIO()))
        (tmp_path / "node-data" / FILE).touch()
    (tmp_path / "node-data" / FILE).write_bytes(b"no database" * 100)
    with pytest.raises(
        InputError, match=r"cannot be used \(file is not a database\); see to its disk, put it back"
    ):
        run_node(path, stop, Log(io.StringIO()))
    (tmp_path / "node-data" / FILE).unlink()
    with Index(tmp_path / "node-data") as index:
        page = index.value("SELECT rootpage FROM sqlite_master WHERE name = 'answers'")
        size = index.value("PRAGMA page_size")
    with (tmp_path / "node-data" / FILE).open("r+b") as stream:
        stream.seek((page - 1) * size)
        stream.write(bytes(size))
    with pytest.raises(
        InputError, match=r"cannot be used \(pages of it are damaged\); see to its disk, put it back"
    ):
        run_node(path, stop, Log(io.StringIO()))
    assert scan.read_bytes() == b"acknowledged"


class Silent:
    """A child process that only says that it listens."""

    pid, status = 1, None

    def __init__(self, module: str, arguments: list[str], line: Callable[[str], None], *_: object) -> None:
        line(json.dumps({"event": "listening"}))

    def end(self) -> None:
        """There is nothing to end."""


@contextmanager
def hub_of_one(folder: Path, monkeypatch: pytest.MonkeyPatch, received: float) -> Iterator[tuple[Hub, Index]]:
    """Yield a hub whose receiver only says that it listens, and the index with the instance that it has."""
    monkeypatch.setattr(hub_module, "Child", Silent)
    config = configuration(folder, quiet_s=10.0)
    config.data.mkdir()
    with Index(config.data) as index:
        add(index, 0, received)
        yield Hub(folder / "node.toml", config, index, Log(io.StringIO())), index


def test_a_clock_that_was_ahead_keeps_nothing_waiting_once_it_is_set_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with hub_of_one(tmp_path, monkeypatch, 50_000.0) as (hub, index):
        index.run(
            "INSERT INTO jobs (series, revision, rule, state, due, completed) VALUES (1, 0, 'r', '', 60000, 0)"
        )
        index.run(
            "INSERT INTO jobs (series, revision, rule, state, due, completed) VALUES (1, 9, 'r', '', 3000, 0)"
        )
        for now in (50_001.0, 50_009.0, 1000.0, 1009.0):
            if now == 1000.0:
                hub._foreman._hire_due = 60_000.0
            hub.tick(now, now)
            assert index.rows("SELECT complete FROM series") == [(0,)]
        assert hub._foreman._hire_due == 1001.0
        hub.tick(1010.1, 1010.1)
        assert index.rows("SELECT complete FROM series") == [(1,)]
        assert index.rows("SELECT due FROM jobs ORDER BY due") == [(1000.0,), (3000.0,)]


def test_a_clock_that_leaps_ahead_makes_no_time_a_quiet_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A series was complete amid its slices, and answered from a part of them first."""
    with hub_of_one(tmp_path, monkeypatch, 1000.0) as (hub, index):
        complete = []
        for now, steady in ((1000.0, 50.0), (1003.0, 53.0), (4600.0, 53.2), (4609.0, 62.2), (4610.1, 63.3)):
            hub.tick(now, steady)
            complete.append(index.value("SELECT complete FROM series"))
        assert complete == [0, 0, 0, 0, 1]


def test_a_clock_that_leaps_ahead_ends_no_job_that_has_time_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with hub_of_one(tmp_path, monkeypatch, 1000.0) as (hub, _):
        killed, times = list[float](), list[float]()
        child: Any = SimpleNamespace(status=None, kill=lambda: killed.append(times[-1]), end=lambda: None)
        hub._foreman._workers[0] = Worker(child, job=JobRow(1, 1, 1, "r", "running", 1, 0.0, ""), last=1010.0)
        for now, steady in ((1000.0, 50.0), (1003.0, 53.0), (4600.0, 53.2), (4606.0, 59.2), (4607.0, 60.2)):
            times.append(now)
            hub.tick(now, steady)
        assert killed == [4607.0]
