"""Days of traffic in minutes: does a node grow beyond its retention rule? (Linux)

    python -m tests.node.hours [--hours 72] [--speed 360]

The node and all its processes live by a clock that runs so many times faster. A scanner sends a small series about
every 12 minutes of theirs, every tenth one twice, every tenth with other content under known UIDs; scans are kept for
3 hours. Memory, handles, threads and the disk are looked at all the time: the median of the last quarter is compared
with that of the second one. The audit trail, which nobody removes, is told apart.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from statistics import median

from ronnaplan.node.index import Index
from tests.node.killing import WAIT_S, Trial

CLOCK = """
import os, time
_speed, _began, _now = float(os.environ["CLOCK_SPEED"]), float(os.environ["CLOCK_BEGAN"]), time.time
time.time = lambda: _began + (_now() - _began) * _speed
_steady = time.perf_counter
time.perf_counter = lambda: _steady() * _speed
"""
EVERY_S = 720.0
KEEP_DAYS = 0.125
LOOK_S = 1.0
GROWTH = 1.05
"""What the median may grow by: the index takes and frees pages, an allocator keeps some."""

SPARE = 2.0
"""Of any measure: a file or a handle that is just in use."""

TABLES = ("instances", "aside", "answers")
"""Of the index, what names files."""

SETTLE_S = 3.0
"""After the last answer: for what is just on its way."""

Look = dict[str, float]


def main() -> int:
    """Run, print what was seen; return 1 where something grew."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=72.0)
    parser.add_argument("--speed", type=float, default=360.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        looks, series, wrong = watch(Path(folder), given.hours, given.speed)
    quarters = [looks[len(looks) * part // 4 : len(looks) * (part + 1) // 4] for part in range(4)]
    for name in looks[0]:
        second, last = (median(look[name] for look in quarters[part]) for part in (1, 3))
        print(f"{name:12} second quarter {second:10.1f}, last quarter {last:10.1f}")
        if name != "audit_kib" and last > GROWTH * second + SPARE:
            wrong.append(f"{name} grew from {second:.1f} to {last:.1f}")
    print(json.dumps({"hours": given.hours, "series": series, "looks": len(looks), "wrong": wrong}))
    return 1 if wrong else 0


def watch(home: Path, hours: float, speed: float) -> tuple[list[Look], int, list[str]]:
    """Send for so many hours of the node's clock; return what was seen, how many series were sent, and faults."""
    (home / "clock").mkdir()
    (home / "clock" / "sitecustomize.py").write_text(CLOCK)
    os.environ["CLOCK_SPEED"], os.environ["CLOCK_BEGAN"] = str(speed), str(time.time())
    os.environ["PYTHONPATH"] = os.pathsep.join([str(home / "clock"), str(Path.cwd())])
    trial = Trial(home, 1, f"keep_days = {KEEP_DAYS}\n", quiet_s=speed * 0.5)
    looks: list[Look] = []
    try:
        number, began = 0, time.monotonic()
        while (passed_s := time.monotonic() - began) < 3600 * hours / speed:
            if passed_s * speed >= number * EVERY_S:
                trial.send_series(number)
                if number % 10 == 3:
                    trial.send_series(number)
                if number % 10 == 7:
                    trial.send_series(number, other=True)
                number += 1
            looks.append(look(trial.node, home / "node-data"))
            time.sleep(LOOK_S)
        trial.archive.wait_for(number, 1, WAIT_S)
        time.sleep(SETTLE_S)
        wrong = [f"{name} is in no index" for name in unknown_files(home / "node-data")]
        if len(trial.archive.got) != number:
            wrong.append(f"{len(trial.archive.got)} of {number} series were answered")
        return looks, number, wrong
    finally:
        trial.end()


def look(node: subprocess.Popen[bytes], data: Path) -> Look:
    """Return memory, handles and threads of the node's processes, and what its folder takes."""
    found: Look = {"rss_mib": 0.0, "handles": 0.0, "threads": 0.0}
    for pid in family(node.pid):
        with suppress(OSError):
            status = Path(f"/proc/{pid}/status").read_text()
            found["rss_mib"] += int(_field(status, "VmRSS")) / 1024
            found["threads"] += int(_field(status, "Threads"))
            found["handles"] += len(list(Path(f"/proc/{pid}/fd").iterdir()))
    # os.walk goes on where a folder was removed meanwhile
    files = [Path(folder) / name for folder, _, names in os.walk(data) for name in names]
    found["unknown_files"] = len(unknown_files(data))
    found["audit_kib"] = size_kib(lambda path: path.name == "audit.log", files)
    found["disk_kib"] = size_kib(lambda path: path.name != "audit.log", files)
    return found


def unknown_files(data: Path) -> list[str]:
    """Return the files below the node's folder that the index does not name, but for those of the node itself."""
    there = {
        Path(folder, name).relative_to(data).as_posix() for folder, _, names in os.walk(data) for name in names
    }
    with Index(data) as index:  # asked later: what is entered meanwhile is known
        known = {path for table in TABLES for (path,) in index.rows(f"SELECT path FROM {table}")}
    return sorted(path for path in there - known if "/" in path)


def size_kib(wanted: Callable[[Path], bool], files: list[Path]) -> float:
    """Return what some files take."""
    total = 0
    for path in filter(wanted, files):
        with suppress(OSError):
            total += path.stat().st_size
    return total / 1024


def family(pid: int) -> list[int]:
    """Return a process and all that descend from it."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            parents[int(path.name)] = int((path / "stat").read_text().rpartition(")")[2].split()[1])
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def _field(status: str, name: str) -> str:
    match = re.search(rf"^{name}:\s+(\d+)", status, re.MULTILINE)
    return match[1] if match else "0"


if __name__ == "__main__":
    sys.exit(main())
