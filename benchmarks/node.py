"""The DICOM node on loopback: instances received a second, time to the first answer, memory (Linux; needs dcmtk).

    python -m benchmarks.node [FOLDER] [--associations 8] [--rounds 5] [--diameter 11.5] [--slices 190] [--many 10000]

Without a folder a head is rendered: uncompressed slices of 512 x 512. dcmtk's storescu sends them, split over so
many associations, to the node and to dcmtk's storescp (which syncs nothing) in turn; every instance that the node
acknowledges is on the disk and in the index. Then a series is sent twice, under other UIDs, to a node that delivers its
answers to dcmtk's storescp, and the log tells how long after each was complete its first answer was on the disk.
Memory is the largest sum over the node's processes while it receives, works and delivers: of what each holds for itself
(private), with its share of what several hold (proportional), and with all that it sees of that (resident). It is told
as it is, and that of the node before there is a series. Chromium, which prints the PDF, is a program of its own and not
counted. At last a series of many small instances is sent. ``--rounds 0`` and ``--many 0`` leave out a part.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from statistics import median
from typing import Any

from pydicom import dcmread
from pydicom.uid import generate_uid

from benchmarks.pipeline import make_series
from phantoms.library import demo_head

RATE_GOAL, ANSWER_GOAL_S, MEMORY_GOAL = 150.0, 5.0, 2.0
"""Instances a second; seconds after the series is complete; times the series."""

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


def main() -> int:
    """Measure and print; return 1 if a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--associations", type=int, default=8)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--slices", type=int, default=190)
    parser.add_argument("--many", type=int, default=10_000, metavar="INSTANCES")
    parser.add_argument("--diameter", type=float, default=11.5, metavar="MM")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as made:
        home = Path(made)
        scan = arguments.folder or make_series(
            home / "ct", demo_head(), slices=arguments.slices, spacing_mm=190 / arguments.slices
        )
        print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
        missed = arguments.rounds and receiving(home, scan, arguments.associations, arguments.rounds) < RATE_GOAL
        seconds, memory = answering(home, scan, arguments.associations, arguments.diameter)
        missed = missed or seconds > ANSWER_GOAL_S or memory > MEMORY_GOAL
        if arguments.many:
            missed = many(home, scan, arguments.many, arguments.associations) != arguments.many or missed
        print(f"load average {os.getloadavg()[0]:.1f}")
    return int(missed)


def receiving(home: Path, scan: Path, associations: int, rounds: int) -> float:
    """Print instances a second of both receivers, and the processor's time of an instance; return the node's rate."""
    series = [renamed(scan, home / f"sent-{number}", number) for number in range(rounds)]
    taken: dict[str, list[float]] = {"node": [], "storescp": []}
    count = len(list(series[0].iterdir()))
    with node(home / "receiving", calling="NOBODY") as running, storescp(home / "storescp") as other:

        def busy_s() -> dict[str, float]:
            return {"node": running.busy_s("ronnaplan.node.listening"), "storescp": other.busy_s("")}

        before = busy_s()  # it has loaded its code
        for folder in series:
            for name, port in (("node", running.port), ("storescp", other.port)):
                taken[name].append(count / sending_s(folder, port, associations))
        after = busy_s()
    best = {name: max(rates) for name, rates in taken.items()}
    print(f"{count} instances over {associations} associations, {rounds} rounds in turn")
    for name, rates in taken.items():
        cost = 1000 * (after[name] - before[name]) / (rounds * count)
        print(
            f"  {name:9} median {median(rates):6.0f}/s, best {best[name]:6.0f}/s, {cost:5.2f} ms of a processor each"
        )
    ratio = median(one / two for one, two in zip(taken["node"], taken["storescp"], strict=True))
    print(f"  node against storescp {ratio:.2f}; goal at least {RATE_GOAL:.0f}/s")
    return median(taken["node"])


def answering(home: Path, scan: Path, associations: int, diameter_mm: float) -> tuple[float, float]:
    """Print how long the first answer took and the memory; return seconds, and memory in times of the series."""
    size = sum(path.stat().st_size for path in scan.rglob("*") if path.is_file())
    series = [renamed(scan, home / f"worked-on-{number}", 1000 + number) for number in range(2)]
    with (
        storescp(home / "archive") as archive,
        node(home / "answering", archive.port, diameter=diameter_mm) as running,
    ):
        idle = running.memory()
        with peak(running.memory) as most:
            for number, folder in enumerate(series):
                sending_s(folder, running.port, associations)
                wait(lambda number=number: len(running.events("delivered")) == 4 * (number + 1), 600.0)  # type: ignore[misc]
        complete = [when(line) for line in running.events("complete")]
        first = [min(when(line) for line in running.events("answer") if line["job"] == job) for job in (1, 2)]
    seconds = [after - before for before, after in zip(complete, first, strict=True)]
    print(
        f"first answer {seconds[0]:.2f} s after the first series was complete, {seconds[1]:.2f} s after the second;"
        f" goal {ANSWER_GOAL_S:.0f} s"
    )
    print(f"memory at most, for a series of {size / 1e6:.0f} MB; goal {MEMORY_GOAL:.0f} times")
    for kind, value in most.items():
        print(
            f"  {kind:12} {value / 1e6:4.0f} MB, {value / size:.2f} times the series;"
            f" {idle[kind] / 1e6:.0f} MB without one"
        )
    return max(seconds), most["proportional"] / size


def many(home: Path, scan: Path, count: int, associations: int) -> int:
    """Print how a series of ``count`` small instances fares; return how many of them are complete in one series."""
    folder = home / "many"
    folder.mkdir()
    made = dcmread(min(scan.glob("*.dcm")))
    made.Rows = made.Columns = 16
    made.PixelData = made.PixelData[: 16 * 16 * 2]
    made.SeriesInstanceUID = generate_uid(entropy_srcs=["many"])
    for number in range(count):
        made.SOPInstanceUID = generate_uid(entropy_srcs=["many", str(number)])
        made.file_meta.MediaStorageSOPInstanceUID, made.InstanceNumber = made.SOPInstanceUID, number + 1
        made.save_as(folder / f"{number}.dcm")
    with node(home / "taking many", calling="NOBODY") as running:
        before = running.memory()["private"]
        with peak(running.memory) as most:
            seconds = sending_s(folder, running.port, associations)
        wait(lambda: running.events("complete"), 60.0)
        kept = int(running.events("complete")[-1]["instances"])
    print(
        f"{kept} of {count} small instances in one series, {count / seconds:.0f}/s,"
        f" {(most['private'] - before) / 1e6:.0f} MB more"
    )
    return kept


def when(line: dict[str, Any]) -> float:
    """Return when a line of the log was told."""
    return datetime.fromisoformat(line["time"]).timestamp()


def renamed(scan: Path, folder: Path, number: int) -> Path:
    """Write ``scan`` as another series of its own study."""
    folder.mkdir()
    for path in sorted(scan.glob("*.dcm")):
        made = dcmread(path)
        made.SeriesInstanceUID = generate_uid(entropy_srcs=["series", str(number)])
        made.SOPInstanceUID = generate_uid(entropy_srcs=[made.SOPInstanceUID, str(number)])
        made.file_meta.MediaStorageSOPInstanceUID = made.SOPInstanceUID
        made.save_as(folder / path.name)
    return folder


def sending_s(folder: Path, port: int, associations: int) -> float:
    """Send a folder over so many associations at one time; return how long it took."""
    paths = sorted(folder.glob("*.dcm"))
    start = time.perf_counter()
    senders = [
        subprocess.Popen(
            [
                program("storescu"),
                "-aet",
                "CT1",
                "-aec",
                "RONNAPLAN",
                "-pdu",
                "131072",
                "127.0.0.1",
                str(port),
                *map(str, part),
            ]
        )
        for part in (paths[number::associations] for number in range(associations))
    ]
    if any(sender.wait() for sender in senders):
        raise SystemExit("storescu could not send all")
    return time.perf_counter() - start


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


if __name__ == "__main__":
    sys.exit(main())
