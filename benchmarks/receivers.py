"""The node and dcmtk's receiver as processes: started, waited for, and measured while they run (Linux; needs dcmtk)."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

QUIET_S = 2.0
CONFIGURATION = """
port = {port}
page_port = 0
quiet_s = {quiet_s}
[limits]
least_free_mib = 1
[[peer]]
name = "scanner"
title = "CT1"
sends = true
[[peer]]
name = "archive"
port = {archive}
[[rule]]
name = "markers"
calling = "{calling}"
diameters = [{diameter}]
answers = ["fiducials", "sr", "pdf", "sheet"]
receivers = ["archive"]
"""
KINDS = {"private": r"Private_\w+", "proportional": "Pss", "resident": "Rss"}
"""Ways to count a process's memory, and the fields that Linux tells them in."""

TICKS = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


@dataclass
class Running:
    """A receiver that runs, and all its processes."""

    process: subprocess.Popen[bytes]
    port: int
    log: Path

    def events(self, kind: str) -> list[dict[str, Any]]:
        """Return what it told."""
        lines = [json.loads(line) for line in self.log.read_text().splitlines() if line.startswith("{")]
        return [line for line in lines if line["event"] == kind]

    def busy_s(self, module: str) -> float:
        """Return the processor's time of its processes that run ``module``, ended children included."""
        total = 0.0
        for pid in self.processes():
            with suppress(OSError):
                if module in Path(f"/proc/{pid}/cmdline").read_text():
                    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
                    total += sum(map(int, fields[11:15])) / TICKS
        return total

    def memory(self) -> dict[str, int]:
        """Return the bytes that its processes hold, of each kind, but for other programs that they run."""
        total = dict.fromkeys(KINDS, 0)
        for pid in self.processes():
            with suppress(OSError):
                if "-m\0ronnaplan" not in Path(f"/proc/{pid}/cmdline").read_text():
                    continue
                text = Path(f"/proc/{pid}/smaps_rollup").read_text()
                for kind, field in KINDS.items():
                    total[kind] += 1024 * sum(map(int, re.findall(rf"^{field}:\s+(\d+)", text, re.MULTILINE)))
        return total

    def processes(self) -> list[int]:
        """Return the process and all that it started."""
        parents = {}
        for path in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                parents[int(path.name)] = int((path / "stat").read_text().rpartition(")")[2].split()[1])
        found = [self.process.pid]
        for pid in found:
            found += [child for child, parent in parents.items() if parent == pid]
        return found


@contextmanager
def node(home: Path, archive: int = 0, *, calling: str = "*", diameter: float = 11.5) -> Iterator[Running]:
    """Run a node; only what the title ``calling`` sends is worked on, and answered to the port ``archive``."""
    home.mkdir()
    port = free_port()
    config = home / "node.toml"
    given = {"port": port, "archive": archive, "quiet_s": QUIET_S, "calling": calling, "diameter": diameter}
    config.write_text(CONFIGURATION.format(**given))
    command = [sys.executable, "-m", "ronnaplan", "node", "--config", str(config)]
    with started(command, port, home / "log") as running:
        yield running


@contextmanager
def storescp(home: Path) -> Iterator[Running]:
    """Run dcmtk's receiver, a process for each association, as it comes from Debian."""
    home.mkdir()
    port = free_port()
    command = [program("storescp"), "--fork", "-pdu", "131072", "-od", str(home), str(port)]
    with started(command, port, home.with_suffix(".log")) as running:
        yield running


@contextmanager
def started(command: Sequence[str], port: int, log: Path) -> Iterator[Running]:
    """Run a receiver until the end of the block; what it says goes to ``log``."""
    with log.open("wb") as stream:
        process = subprocess.Popen(command, stdout=stream, stderr=stream)
    try:
        wait(lambda: answers(port), 60.0)
        yield Running(process, port, log)
    finally:
        process.terminate()
        process.wait(30)


@contextmanager
def peak(measure: Callable[[], dict[str, int]]) -> Iterator[dict[str, int]]:
    """Yield the largest values so far."""
    most, over = dict(measure()), threading.Event()

    def watch() -> None:
        while not over.wait(0.05):
            for kind, value in measure().items():
                most[kind] = max(most[kind], value)

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield most
    finally:
        over.set()
        watcher.join()


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def answers(port: int) -> bool:
    """Whether somebody speaks DICOM there."""
    return not subprocess.call(
        [program("echoscu"), "-aet", "CT1", "-aec", "RONNAPLAN", "127.0.0.1", str(port)], stderr=subprocess.DEVNULL
    )


def program(name: str) -> str:
    """Return the path of a program of dcmtk's; pynetdicom's of the same name lie beside Python."""
    beside = Path(sys.executable).parent
    path = os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if Path(part) != beside)
    found = shutil.which(name, path=path)
    if found is None:
        raise SystemExit(f"{name} of dcmtk is not installed")
    return found


def wait(condition: Callable[[], object], seconds: float) -> None:
    """Wait until a condition holds; give up after so long."""
    last = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > last:
            raise SystemExit("it did not happen in time")
        time.sleep(0.05)
