"""Where received instances lie, and how they get there: on the disk and in the index before anybody is told so.

An instance is written beside, synced, renamed, its folder synced, and entered in the index in a transaction that is
synced, too. Instances that wait at one time (of several associations) share these steps: a group is acknowledged when
all of it is safe.
"""

from __future__ import annotations

import queue
import shutil
import sqlite3
import threading
import time
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

from ronnaplan.ct.limits import MIB
from ronnaplan.node.audit import Audit
from ronnaplan.node.facts import Facts
from ronnaplan.node.index import Index
from ronnaplan.node.logs import Log
from ronnaplan.node.retention import DAY_S, remove_old, trusted_time
from ronnaplan.portable import replace, sync_folder

INCOMING, INSTANCES, ASIDE = "incoming", "instances", "aside"
LARGEST_GROUP = 64
"""So many instances at most are made safe together, by one sync of each folder and one of the index."""
IDLE_S = 1.0
"""How long is waited for an arrival, or its answer, before it is looked whether there is something else to do."""
HASH_LETTERS = 16
"""Of its hash, in the name of an instance that is kept aside: others of its UID have other ones."""
RETENTION_S = 600.0
"""How often it is looked for what may go."""


class Status(IntEnum):
    """What a sender of an instance is told (PS3.4, B.2.3; PS3.7, C.5)."""

    SUCCESS = 0x0000
    DUPLICATE = 0x0111
    NO_ROOM = 0xA700
    NO_MATCH = 0xA900
    NOT_UNDERSTOOD = 0xC000


class Taken(NamedTuple):
    """What became of an instance: what its sender is told, and whether it was there already."""

    status: Status
    was_known: bool = False


@dataclass(frozen=True)
class Arrival:
    """An instance that lies at ``path``, synced, in the folder for incoming ones, and who brought it."""

    facts: Facts
    path: Path
    calling: str
    called: str
    answer: Future[Taken] = field(default_factory=Future)


class Store:
    """The instances below ``folder``. One process at a time may take arrivals."""

    def __init__(self, folder: Path, log: Log, audit: Audit, *, keep_days: float, least_free_mib: int = 0) -> None:
        self.folder, self._log, self._audit, self._least_free = folder, log, audit, least_free_mib * MIB
        self._keep_s, self._retention_due = keep_days * DAY_S, 0.0
        for name in (INCOMING, INSTANCES, ASIDE):
            (folder / name).mkdir(parents=True, exist_ok=True)
        sync_folder(folder)
        self._waiting: queue.SimpleQueue[Arrival | None] = queue.SimpleQueue()
        self._lacking: queue.SimpleQueue[Facts] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    @property
    def incoming(self) -> Path:
        """Where instances are written while they arrive."""
        return self.folder / INCOMING

    def has_room(self) -> bool:
        """Whether the disk has more than the least free space."""
        return shutil.disk_usage(self.folder).free > self._least_free

    def note_lacking(self, facts: Facts) -> None:
        """Have a series wait for an instance that there is no room for, and that its sender keeps."""
        self._lacking.put(facts)

    def start(self) -> None:
        """Clear what a killed node left, then take arrivals in a thread of their own."""
        index = Index(self.folder)  # one that cannot be opened ends the receiver, which is begun anew
        self._clear_unacknowledged(index)
        self._thread = threading.Thread(target=self._take_groups, args=(index,), name="store", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Finish what waits; what comes later is refused."""
        self._waiting.put(None)
        if self._thread is not None:
            self._thread.join()

    def take(self, arrival: Arrival) -> Taken:
        """Wait until ``arrival`` is safe, or refused."""
        self._waiting.put(arrival)
        while True:
            try:
                return arrival.answer.result(IDLE_S)
            except TimeoutError:
                if self._thread is None or not self._thread.is_alive():
                    return self._refused(arrival, "the node ends")

    def _take_groups(self, index: Index) -> None:
        with index:
            while True:
                group: list[Arrival | None] = []
                with suppress(queue.Empty):
                    group.append(self._waiting.get(timeout=IDLE_S))
                    while len(group) < LARGEST_GROUP:
                        group.append(self._waiting.get_nowait())
                arrivals = [one for one in group if one is not None]
                try:
                    told = self._take_group(index, arrivals)
                except Exception as error:
                    # a full disk, a locked or damaged index: told to every sender of the group
                    told = [self._refused(one, error) for one in arrivals]
                for arrival, taken in zip(arrivals, told, strict=True):
                    arrival.answer.set_result(taken)
                if len(arrivals) < len(group):
                    return
                self._enter_lacking(index, time.time())
                self._remove_old(index, time.time())

    def _enter_lacking(self, index: Index, now: float) -> None:
        with suppress(queue.Empty, OSError, sqlite3.Error):  # of a disk so full that not even this can be noted
            while True:
                index.note_lacking(self._lacking.get_nowait(), now)

    def _remove_old(self, index: Index, now: float) -> None:
        if not now < self._retention_due <= now + RETENTION_S:  # later than that by a clock that was ahead
            self._retention_due = now + RETENTION_S
            try:
                before = trusted_time(index, now, self._log) - self._keep_s
                remove_old(self.folder, index, before, self._log, self._audit)
            except (OSError, sqlite3.Error) as error:  # tried again
                self._log.tell("not removed", reason=str(error))

    def _take_group(self, index: Index, arrivals: list[Arrival]) -> list[Taken]:
        """Make a group safe; returns what became of each."""
        known = index.known([one.facts.sop_uid for one in arrivals])
        told, moves, entries = [], [], []
        for one in arrivals:
            sop_uid, sha256, place = one.facts.sop_uid, one.facts.sha256, self._place(one.facts)
            is_new, was_known = sop_uid not in known, False
            if is_new:
                known[sop_uid] = sha256
                entries.append((one, place))
                moves.append((one.path, place))
            elif known[sop_uid] != sha256:
                moves.append((one.path, self.folder / _aside(one.facts)))
            elif place.is_file() or any(target == place for _, target in moves):
                one.path.unlink()
                was_known = True
            else:  # somebody removed the file
                moves.append((one.path, place))
                self._log.tell("kept anew", sop_instance=sop_uid, calling=one.calling)
            status = Status.SUCCESS if is_new or known[sop_uid] == sha256 else Status.DUPLICATE
            told.append(Taken(status, was_known))
        now = time.time()
        try:
            self._move(moves)
            with index.transaction():
                for one, place in entries:
                    path = place.relative_to(self.folder).as_posix()
                    index.add(one.facts, path, one.calling, one.called, now)
                for one, taken in zip(arrivals, told, strict=True):
                    if taken.status is Status.DUPLICATE:
                        self._keep_aside(index, one, now)
        except BaseException:
            for _, place in entries:  # no row names it: it may not stay
                place.unlink(missing_ok=True)
            raise
        return told

    def _place(self, facts: Facts) -> Path:
        return self.folder / INSTANCES / facts.study_uid / facts.series_uid / f"{facts.sop_uid}.dcm"

    def _move(self, moves: list[tuple[Path, Path]]) -> None:
        """Give files their names, and sync the folders of these."""
        made: dict[Path, None] = {}
        for _, target in moves:
            folder = target.parent
            if not folder.is_dir():
                folder.mkdir(parents=True)
                made |= dict.fromkeys((folder.parent.parent, folder.parent))
            made[folder] = None
        for source, target in moves:
            replace(source, target)
        for folder in made:
            sync_folder(folder)

    def _keep_aside(self, index: Index, one: Arrival, now: float) -> None:
        name = _aside(one.facts)
        index.run(
            "INSERT INTO aside VALUES (?, ?, ?, ?) ON CONFLICT DO NOTHING",
            name,
            one.facts.sop_uid,
            one.calling,
            now,
        )
        self._log.tell(
            "kept aside",
            reason="an instance of this UID and other content is there already",
            sop_instance=one.facts.sop_uid,
            calling=one.calling,
            file=name,
        )

    def _refused(self, one: Arrival, reason: object) -> Taken:
        self.note_lacking(one.facts)
        with suppress(OSError):  # of a disk that lets nothing be changed any more; removed when the node starts
            one.path.unlink(missing_ok=True)
        self._log.tell(
            "refused", status=f"{Status.NO_ROOM:04X}", reason=f"cannot be kept: {reason}", calling=one.calling
        )
        return Taken(Status.NO_ROOM)

    def _clear_unacknowledged(self, index: Index) -> None:
        """Remove files that are not in the index: their senders were told nothing, and will send them again."""
        for path in self.incoming.iterdir():
            path.unlink(missing_ok=True)
        known = {path for (path,) in index.rows("SELECT path FROM instances UNION SELECT path FROM aside")}
        for path in [*(self.folder / INSTANCES).rglob("*.dcm"), *(self.folder / ASIDE).glob("*.dcm")]:
            if path.relative_to(self.folder).as_posix() not in known:
                path.unlink(missing_ok=True)


def _aside(facts: Facts) -> str:
    """Return the path, in the store's folder, of an instance that is there already with other content."""
    return f"{ASIDE}/{facts.sop_uid}.{facts.sha256[:HASH_LETTERS]}.dcm"
