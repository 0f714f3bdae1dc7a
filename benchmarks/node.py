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
import os
import subprocess
import sys
import tempfile
import time
from datetime import datetime
from pathlib import Path
from statistics import median
from typing import Any

from pydicom import dcmread
from pydicom.uid import generate_uid

from benchmarks.pipeline import make_series
from benchmarks.receivers import node, peak, program, storescp, wait
from phantoms.library import demo_head

RATE_GOAL, ANSWER_GOAL_S, MEMORY_GOAL = 150.0, 5.0, 2.0
"""Instances a second; seconds after the series is complete; times the series."""


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


if __name__ == "__main__":
    sys.exit(main())
