"""The node itself: keeps its receiver running, notices complete series, has them worked on."""

from __future__ import annotations

import math
import sqlite3
import threading
import time
from contextlib import ExitStack
from pathlib import Path

from ronnaplan.documents.files import make_folder
from ronnaplan.errors import InputError
from ronnaplan.jobs.processes import Child
from ronnaplan.jobs.rules import never_reached
from ronnaplan.node import work
from ronnaplan.node.audit import Audit
from ronnaplan.node.config import Config, read_config
from ronnaplan.node.index import FILE, Index
from ronnaplan.node.jobs import Foreman
from ronnaplan.node.logs import LISTENING, Log
from ronnaplan.node.page import Page
from ronnaplan.node.papers import PapersWatch
from ronnaplan.node.series import SeriesWatch
from ronnaplan.node.store import INSTANCES
from ronnaplan.portable import GIVING_BACK

LOCK = "node.lock"
LISTENER, WORKER = "ronnaplan.node.listening", work.MODULE
"""Modules that speak with peers and that work on scans, in processes of their own."""
TICK_S = 0.2
UNDAMAGED = "ok"
"""What SQLite says of a database of which no page is damaged."""
RESTART_S = 1.0
"""Wait before a receiver that ended is started again."""
LEAP_S = 1.0
"""By more than this between two passes the clock does not gain on one that counts steadily, unless it is set."""


def run_node(config_path: Path, stop: threading.Event, log: Log, worker: str = WORKER) -> None:
    """Run the node until ``stop`` is set; raises `InputError` where another one has its folder.

    ``worker`` is the module that works on scans, in processes of its own.
    """
    from filelock import FileLock, Timeout

    config = read_config(config_path)
    make_folder(config.data)
    with ExitStack() as stack:
        try:
            stack.enter_context(FileLock(config.data / LOCK, timeout=0))
        except Timeout as error:
            raise InputError(
                f"another node keeps its data in {config.data}; end it, or name another folder"
            ) from error
        index = stack.enter_context(_index_of(config.data))
        audit = Audit(config.data, config.audit, config.titles[0], log)
        audit.started()
        stack.callback(audit.stopped)
        if config.page_port is not None:
            page = Page(config, log)
            page.start()
            stack.callback(page.stop)
        hub = Hub(config_path, config, index, log, worker)
        stack.callback(hub.close)
        log.tell("started", titles=list(config.titles), folder=str(config.data))
        for hidden, rule in never_reached(config.rule):
            log.tell("rule never reached", rule=hidden.name, behind=rule.name)
        for rule in config.rule:
            if rule.template is not None and not (config.home / rule.template).is_file():
                log.tell("no template", rule=rule.name, file=str(config.home / rule.template))
        while not stop.wait(TICK_S):
            try:
                hub.tick(time.time(), time.perf_counter())
            except (OSError, sqlite3.Error) as error:  # a full disk, an index that another one holds: tried again
                log.tell("cannot go on", reason=str(error))
                stop.wait(RESTART_S)
    log.tell("stopped")


def _index_of(data: Path) -> Index:
    """Open the index; raises `InputError` where it is damaged, or gone while there are scans, which it alone names.

    Files that no row names are removed when the receiver starts: they were not acknowledged.
    """
    path, scans = data / FILE, data / INSTANCES
    remedy = "put it back, or name another folder, to which all scans are sent again"
    is_there = path.exists() and path.stat().st_size > 0  # SQLite takes an empty file for a new database
    if not is_there and any(scans.rglob("*.dcm")):
        raise InputError(f"the index {path} is gone or empty, but scans lie in {scans}; {remedy}")
    try:
        with ExitStack() as stack:
            index = stack.enter_context(Index(data))
            if index.value("PRAGMA quick_check(1)") != UNDAMAGED:
                raise sqlite3.DatabaseError("pages of it are damaged")
            stack.pop_all()
            return index
    except sqlite3.Error as error:  # a full disk, too
        raise InputError(f"the index {path} cannot be used ({error}); see to its disk, {remedy}") from error


class Hub:
    """What one pass of the node does; time comes from outside, so that hours can be played in seconds."""

    def __init__(self, config_path: Path, config: Config, index: Index, log: Log, worker: str = WORKER) -> None:
        self._path, self._data, self._index, self._log = config_path, config.data, index, log
        self._series = SeriesWatch(config, index, log)
        self._papers = PapersWatch(config, index, log)
        self._foreman = Foreman(config, index, log, worker)
        self._receiver: Child | None = None
        self._receiver_due = 0.0
        self._listens = threading.Event()
        self._listening_since: float | None = None
        self._last = self._steady = math.inf

    def tick(self, now: float, steady: float) -> None:
        """Do what is due at ``now`` (seconds since 1970), ``steady`` by a clock that nobody sets (s)."""
        if now - self._last > steady - self._steady + LEAP_S:  # a time that never was
            self._foreman.set_clock_ahead((now - self._last) - (steady - self._steady))
            if self._listening_since is not None:
                self._listening_since = now  # nobody could send in it
        if now < self._last:  # the clock was set back, maybe before the node started
            self._index.set_clock_back(now)
            self._foreman.set_clock_back(now)
            self._receiver_due = min(self._receiver_due, now + RESTART_S)
            if self._listening_since is not None:
                self._listening_since = min(self._listening_since, now)
        self._last, self._steady = now, steady
        self._keep_receiver(now)
        if self._listening_since is not None:
            self._series.tick(now, self._listening_since)
        self._papers.tick(now)
        self._foreman.tick(now)

    def close(self) -> None:
        """End what runs."""
        self._foreman.close()
        if self._receiver is not None:
            self._receiver.end()

    def _keep_receiver(self, now: float) -> None:
        if self._receiver is not None and self._receiver.status is not None:
            self._log.tell("receiver ended", status=self._receiver.status)
            self._receiver.end()
            self._receiver, self._receiver_due, self._listening_since = None, now + RESTART_S, None
            self._listens.clear()
        if self._receiver is None and now >= self._receiver_due:
            self._receiver = Child(LISTENER, [str(self._path)], self._hear, GIVING_BACK)
            (self._data / "receiver.pid").write_text(f"{self._receiver.pid}\n")
        if self._listening_since is None and self._listens.is_set():
            self._listening_since = now

    def _hear(self, line: str) -> None:
        """Note, in the thread that reads what the receiver says, that it listens."""
        if self._log.relay(line) == LISTENING:
            self._listens.set()
