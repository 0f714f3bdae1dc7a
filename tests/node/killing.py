"""Kills a node's processes at random moments amid traffic and counts what was lost (Linux).

    python -m tests.node.killing [--kills 500] [--seed 1]

A scanner sends small series one instance at a time and notes what was acknowledged; workers are the tests' own and
answer every series with one object, to an archive that notes what it got. The node, its receiver or a worker is killed
(SIGKILL), the node is started again, and in the end every acknowledged instance must be there, whole, and every series
answered exactly once. Every second series says how many instances it has, and is complete when it has them: for these
there is no other way. The others are complete after a quiet time, and a machine that stands still amid a series makes
one of its own: such a one that was found complete early, after a quiet time of a node that listened, is opened by its
late slices and answered once more, as it should; these are counted apart (``opened_again``).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from pydicom import dcmread
from pydicom.uid import UID, CTImageStorage
from pynetdicom import AE

from ronnaplan.node.index import Index
from ronnaplan.node.logs import LISTENING
from tests.ct import makers
from tests.node.peers import Archive, associate, free_port, write_toml

REST = """
[jobs]
retry_s = 0.2
attempts = 100
[[peer]]
name = "archive"
title = "ARCHIVE"
port = {archive}
[[rule]]
name = "all"
answers = ["fiducials"]
receivers = ["archive"]
"""
SLICES = 3
WAIT_S = 120.0
"""For the next answer."""
MOST_TRIES = 1200
"""A tenth of a second each."""
DUPLICATE = 0x0111


class Trial:
    """A node under fire."""

    def __init__(self, home: Path, seed: int, more: str = "", quiet_s: float = 1.0) -> None:
        self.random, self.home = random.Random(seed), home
        self.archive = Archive("ARCHIVE", lambda made: str(made.ContentDescription))
        self.port = free_port()
        rest = REST.format(archive=self.archive.port)
        self.quiet_s = quiet_s
        self.config = write_toml(home, self.port, rest, quiet_s=quiet_s, silent_s=5.0)
        self.config.write_text(more + self.config.read_text())
        self.acknowledged: dict[str, str] = {}
        self.killed: Counter[str] = Counter()
        self.opened_again = 0
        self.node = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "tests.node.killed_node", str(self.config)]
        with (self.home / "log").open("ab") as log:
            return subprocess.Popen(command, stderr=log)

    def send_series(self, number: int, *, other: bool = False) -> None:
        """Send a series until all of it is acknowledged, over as many associations as it takes.

        ``other`` sends another content under its UIDs, which is acknowledged as such.
        """
        entity = AE("CT1")
        entity.add_requested_context(CTImageStorage)
        waiting = [self._instance(number, k) for k in range(SLICES)]
        for made in waiting if other else []:
            made.SeriesDescription = f"other {time.time()}"
        for made in send_all(entity, self.port, waiting, DUPLICATE if other else 0):
            self.acknowledged[str(made.SOPInstanceUID)] = hashlib.sha256(made.PixelData).hexdigest()

    def _instance(self, number: int, k: int) -> Any:
        made = makers.dataset(k)
        made.SeriesInstanceUID = f"1.2.7.{number}"
        if is_announced(made.SeriesInstanceUID):
            made.NumberOfSeriesRelatedInstances = SLICES
        made.SOPInstanceUID = made.file_meta.MediaStorageSOPInstanceUID = UID(f"1.2.7.{number}.{k + 1}")
        return made

    def kill(self) -> None:
        """Kill one of the node's processes; start the node again where it was the node."""
        which = self.random.choice(["node", "receiver", "worker"])
        found = self.node.pid if which == "node" else self._child(which)
        if found is None:
            return
        with suppress(ProcessLookupError):
            os.kill(found, signal.SIGKILL)
            self.killed[which] += 1
        if which == "node":
            self.node.wait()
            self.node = self._start()

    def end(self) -> None:
        """Stop node and archive."""
        self.node.terminate()
        self.node.wait()
        self.archive.stop()

    def _child(self, which: str) -> int | None:
        module = {"receiver": b"ronnaplan.node.listening", "worker": b"tests.node.killed_work"}[which]
        for process in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                parent = (process / "stat").read_text().rpartition(")")[2].split()[1]
                if int(parent) == self.node.pid and module in (process / "cmdline").read_bytes():
                    return int(process.name)
        return None

    def faults(self, series: int) -> list[str]:
        """Wait until all is answered; return what is wrong in the end."""
        self.archive.wait_for(series, 1, WAIT_S)
        time.sleep(1.0)  # for a second answer, which there must not be
        self.end()
        wrong = []
        if len(self.archive.got) != series:
            wrong.append(f"{len(self.archive.got)} of {series} series were answered")
        with Index(self.home / "node-data") as index:
            for uid, got in self.archive.got.items():
                early = [] if is_announced(uid) else self._completed_early(index, uid)
                self.opened_again += bool(early)
                if len(got) != 1 + len(early):
                    wrong.append(f"series {uid} has {len(got)} answers")
                wrong += [f"series {uid} was complete at {at}, which was no quiet time" for at in early if at < 0]
            paths = dict(index.rows("SELECT sop_uid, path FROM instances"))
        for uid, sha256 in self.acknowledged.items():
            path = self.home / "node-data" / paths.get(uid, "gone")
            if not path.is_file() or hashlib.sha256(dcmread(path).PixelData).hexdigest() != sha256:
                wrong.append(f"acknowledged instance {uid} is not there")
        return wrong

    def _completed_early(self, index: Index, uid: str) -> list[float]:
        """Return when a series was answered before it was complete; negative where that was not after a quiet time."""
        jobs = index.rows(
            "SELECT completed FROM jobs JOIN series ON series = series.id"
            " WHERE series_uid = ? AND jobs.revision < series.revision"
            " AND jobs.id IN (SELECT job FROM answers)",
            uid,
        )
        received = [
            at
            for (at,) in index.rows(
                "SELECT instances.received FROM instances JOIN series ON series = series.id WHERE series_uid = ?",
                uid,
            )
        ]
        lines = [json.loads(line) for line in (self.home / "log").read_text().splitlines() if line.startswith("{")]
        began = [datetime.fromisoformat(one["time"]).timestamp() for one in lines if one["event"] == LISTENING]
        found = []
        for (completed,) in jobs:
            last = max(at for at in received + began if at <= completed)
            found.append(completed if completed - last >= self.quiet_s else -completed)
        return found


def send_all(entity: AE, port: int, waiting: list[Any], status: int = 0) -> Iterator[Any]:
    """Send until all is acknowledged by ``status``, over as many associations as it takes; yields what was."""
    entity.connection_timeout = entity.dimse_timeout = entity.acse_timeout = 5
    tries = 0
    while waiting:
        tries += 1  # counted, not timed: a machine may stand still
        if tries > MOST_TRIES:
            raise TimeoutError("the node takes nothing any more")
        association = associate(entity, port)
        with suppress(RuntimeError, ValueError, OSError):
            while waiting and association.is_established:
                if association.send_c_store(waiting[0]).get("Status") != status:
                    break
                yield waiting.pop(0)
        if association.is_established:
            association.release()
        if waiting:
            time.sleep(0.1)


def is_announced(series_uid: str) -> bool:
    """Whether the instances of a series say how many it has."""
    return int(series_uid.rpartition(".")[2]) % 2 == 1


def trial(kills: int, seed: int) -> dict[str, Any]:
    """Kill so often; return what was killed, sent, lost."""
    with tempfile.TemporaryDirectory() as folder:
        under_fire = Trial(Path(folder), seed)
        number = 0
        try:
            while under_fire.killed.total() < kills:
                _between(under_fire, number)
                number += 1
            wrong = under_fire.faults(number)
        finally:
            under_fire.node.kill()
        return {
            "killed": dict(under_fire.killed),
            "acknowledged": len(under_fire.acknowledged),
            "series": number,
            "opened_again": under_fire.opened_again,
            "wrong": wrong,
        }


def _between(under_fire: Trial, number: int) -> None:
    """Send a series and kill meanwhile, at a random moment."""
    delay_s = under_fire.random.uniform(0.0, 2.0)
    killer = threading.Timer(delay_s, under_fire.kill)
    killer.start()
    under_fire.send_series(number)
    killer.join()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    found = trial(given.kills, given.seed)
    print(json.dumps(found))
    return 1 if found["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
