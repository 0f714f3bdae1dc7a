"""A cohort at scale: listing many files, working many series off, and the same while everything is killed (Linux).

    python -m benchmarks.cohort listing [--files 100000]
    python -m benchmarks.cohort series [--series 200] [--workers 2]
    python -m benchmarks.cohort kills [--series 200] [--kills 20] [--seed 1]
    python -m benchmarks.cohort charts [--series 4000]

``series`` compares processor time with that of one process which does the same by itself; ``kills`` ends the client,
the scheduler, Dask workers and their children (SIGKILL) at random moments, starts again what is gone, and compares the
tables with those of a run in peace. One series in ten is broken. ``charts`` simulates years of 260 scans of a phantom.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from phantoms.fast import render
from phantoms.series import SeriesOptions, write_series
from phantoms.stack import axial_stack
from ronnaplan.cohort.charts import control_chart
from ronnaplan.cohort.cohort import run_cohort
from ronnaplan.cohort.index import DONE, WAITING, Index
from ronnaplan.cohort.listing import bring_up_to_date
from ronnaplan.cohort.planning import decide, orders, tasks_of
from ronnaplan.cohort.rules import CohortRule, Rules
from ronnaplan.cohort.work import work
from tests.cohort.scans import CENTERS_MM, tiny
from tests.scans import balls

RULES = "[limits]\nattempts = 1000\n[[rule]]\nname = 'all'\ndiameters = [11.5]\nexpected = 4\n"
NOISE_HU = 10.0
BROKEN_EVERY = 10
FILES_A_SERIES = 250


def make_files(root: Path, count: int) -> None:
    """Write so many one-slice files of tiny series, each of `FILES_A_SERIES`, a folder each."""
    one = next(iter(sorted(tiny(root.parent / "pattern", "1000000").iterdir()))).read_bytes()
    for number in range(count):
        series, k = divmod(number, FILES_A_SERIES)
        folder = root / f"{series // 100:03d}" / f"{series:06d}"
        if k == 0:
            folder.mkdir(parents=True)
        # the same length, so that no length in the file changes
        content = one.replace(b"1.2.9.1000000", f"1.2.9.{1_000_000 + series}".encode())
        (folder / f"{k:03d}").write_bytes(content)


def make_series(root: Path, count: int) -> None:
    """Write so many scans of four balls, 43 slices of 128 x 128 with a noise of their own each; some are broken."""
    stack = axial_stack(start_mm=-22, stop_mm=22, matrix=128, field_of_view_mm=64, spacing_mm=1.0)
    clean = render(balls(CENTERS_MM), stack, blur_mm=0.5, noise_hu=0.0, seed=1)
    draws = np.random.default_rng(7)
    for number in range(count):
        folder = root / f"{number:04d}"
        folder.mkdir(parents=True)
        noisy = np.round(clean + NOISE_HU * draws.standard_normal(clean.shape)).astype(np.int16)
        write_series(folder, noisy, stack, SeriesOptions(seed=number))
        if number % BROKEN_EVERY == BROKEN_EVERY - 1:
            damage(folder, number // BROKEN_EVERY)


def damage(folder: Path, kind: int) -> None:
    """Break a series: a slice cut off, slices missing, or nothing but noise."""
    files = sorted(folder.iterdir())
    if kind % 3 == 0:
        files[5].write_bytes(files[5].read_bytes()[:-500])
    elif kind % 3 == 1:
        for path in files[2:]:
            path.unlink()
    else:
        for path in files:
            path.write_bytes(path.read_bytes()[:200])


def cpu_s() -> float:
    """Return the processor time of this process and of those that it has ended."""
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(used.ru_utime + used.ru_stime for used in map(resource.getrusage, kinds))


def listing(folder: Path, files: int) -> None:
    """List a tree twice; say what it takes."""
    make_files(folder / "in", files)
    (folder / "out").mkdir()
    before_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    for run in ("first", "second"):
        start, begun = cpu_s(), time.monotonic()
        with Index(folder / "out") as index:
            listed = bring_up_to_date(index, [str(folder / "in")])
            series = index.value("SELECT COUNT(*) FROM series")
        used, wall = cpu_s() - start, time.monotonic() - begun
        mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{run} listing: {listed.files} files, {listed.changed} headers read, {series} series: "
            f"{1e6 * used / files:.0f} us of processor a file ({wall:.0f} s), memory {mib:.0f} MiB "
            f"({mib - before_mib:+.0f})"
        )
    size = sum(path.stat().st_size for path in (folder / "out").iterdir())
    print(f"index: {size / files:.0f} bytes a file; load {os.getloadavg()[0]:.0f}")


def by_itself(folder: Path) -> float:
    """Work on every series in this process; returns the processor time of one."""
    (folder / "alone").mkdir()
    rules = Rules(rule=(CohortRule(name="all", diameters=(11.5,), expected=4),))
    with Index(folder / "alone") as index:
        bring_up_to_date(index, [str(folder / "in")])
        tasks = tasks_of(rules)
        decide(index, rules, tasks)
        given = [order for _, order, _ in orders(index, rules, tasks)]
    work(given[0], lambda event, **_: None)  # imports and compiled code
    start = time.process_time()
    for order in given:
        with suppress(Exception):
            work(order, lambda event, **_: None)
    return (time.process_time() - start) / len(given)


def series(folder: Path, count: int, workers: int) -> None:
    """Work a cohort off; say how fast, and how much of the processor's time is the work itself."""
    make_series(folder / "in", count)
    alone = by_itself(folder)
    rules = Rules(rule=(CohortRule(name="all", diameters=(11.5,), expected=4),))
    start, begun = cpu_s(), time.monotonic()
    counts = run_cohort([str(folder / "in")], folder / "out", rules, workers=workers)
    used, wall = cpu_s() - start, time.monotonic() - begun
    with Index(folder / "out") as index:
        peak = index.value("SELECT MAX(peak_bytes) FROM series")
        listed = index.value("SELECT COUNT(*) FROM series")
    print(
        f"{count} series made, {listed} listed, {counts.worked} worked on with {workers} processes: {wall:.0f} s, "
        f"{3600 * counts.worked / wall:.0f} an hour, {peak / 2**20:.0f} MiB a process; load {os.getloadavg()[0]:.0f}"
    )
    per = used / counts.worked
    print(f"processor time of a series: {per:.2f} s, by itself {alone:.2f} s: efficiency {alone / per:.0%}")


class Cluster:
    """A scheduler, two workers and a client, all of which may be killed."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.random = folder, random.Random(seed)
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self.parts: dict[str, subprocess.Popen[bytes]] = {}
        self.killed: Counter[str] = Counter()

    def tend(self) -> None:
        """Start what is not running; of a client that is done, nothing more."""
        dask = [sys.executable, "-m"]
        commands = {
            "scheduler": [*dask, "distributed.cli.dask_scheduler", "--host", self.address, "--no-dashboard"],
            "worker 1": [*dask, "distributed.cli.dask_worker", self.address, "--nthreads", "1", "--no-nanny"],
            "worker 2": [*dask, "distributed.cli.dask_worker", self.address, "--nthreads", "1", "--no-nanny"],
            "client": [
                *(sys.executable, "-m", "ronnaplan", "cohort", str(self.folder / "in"), "-o"),
                *(str(self.folder / "killed"), "--rules", str(self.folder / "rules.toml")),
                *("--scheduler", self.address),
            ],
        }
        with (self.folder / "log").open("ab") as log:
            for name, command in commands.items():
                if name not in self.parts or self.parts[name].poll() is not None:
                    self.parts[name] = subprocess.Popen(command, stderr=log, stdout=log, cwd=self.folder)

    def kill(self) -> None:
        """Kill one of them, or a child that works on a series."""
        name = self.random.choice([*self.parts, "child"])
        pids = self._children() if name == "child" else [self.parts[name].pid]
        if pids:
            with suppress(ProcessLookupError):
                os.kill(self.random.choice(pids), signal.SIGKILL)
                self.killed[name] += 1

    def _children(self) -> list[int]:
        workers = {part.pid for part in self.parts.values()}
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
                if parent in workers and b"ronnaplan.cohort.work" in (process / "cmdline").read_bytes():
                    found.append(int(process.name))
        return found

    def close(self) -> None:
        """End all of them."""
        for part in self.parts.values():
            part.kill()
            part.wait()


def kills(folder: Path, count: int, most: int, seed: int) -> None:
    """Work a cohort off in peace and under fire; say whether the tables are the same."""
    from pyarrow import parquet

    make_series(folder / "in", count)
    (folder / "rules.toml").write_text(RULES)
    command = [sys.executable, "-m", "ronnaplan", "cohort", str(folder / "in"), "-o", str(folder / "peace")]
    subprocess.run([*command, "--rules", str(folder / "rules.toml"), "--workers", "2"], check=True, cwd=folder)
    under_fire = Cluster(folder, seed)
    try:
        while True:
            under_fire.tend()
            begun = time.monotonic()
            wait_s = under_fire.random.uniform(0.0, 40.0)
            while time.monotonic() < begun + wait_s and under_fire.parts["client"].poll() is None:
                time.sleep(0.2)
            if under_fire.parts["client"].poll() == 0:
                break
            if under_fire.killed.total() < most:
                under_fire.kill()
    finally:
        under_fire.close()
    same = {
        name: parquet.read_table(folder / "peace" / name).equals(parquet.read_table(folder / "killed" / name))
        for name in ("series.parquet", "markers.parquet")
    }
    with Index(folder / "killed") as index:
        states: dict[str, Any] = {state: index.count(state) for state in (DONE, WAITING, "aside")}
    print(
        f"killed {dict(under_fire.killed)}; series {states}; the same tables: {same}; load {os.getloadavg()[0]:.0f}"
    )


def charts(years: int) -> None:
    """Chart simulated years; say how often they are flagged, and how soon where something is wrong."""
    draws = np.random.default_rng(1)
    days = [f"{n:03d}" for n in range(260)]
    for what, step, slope in (("nothing wrong", 0.0, 0.0), ("a step", 1.0, 0.0), ("a drift", 0.0, 0.02)):
        begin, drifts, leaps, delays = 100 if step else 60, 0, 0, []
        for _ in range(years):
            values = draws.standard_normal(len(days))
            values[begin:] += step + slope * np.arange(len(days) - begin)
            chart = control_chart("scanner", "value", days, list(values))
            drifts, leaps = drifts + bool(chart.drifts.any()), leaps + bool(chart.leaps.any())
            if chart.drifts[begin:].any():
                delays.append(int(np.argmax(chart.drifts[begin:])))
        soon = f", half of them within {np.median(delays):.0f} scans" if step or slope else ""
        print(f"{what}: a drift in {drifts / years:.1%} of years{soon}; a single value in {leaps / years:.1%}")


def main() -> None:
    """Run one of the measurements."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("listing", "series", "kills", "charts"))
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--series", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if given.what == "charts":
        charts(given.series)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if given.what == "listing":
            listing(folder, given.files)
        elif given.what == "series":
            series(folder, given.series, given.workers)
        else:
            kills(folder, given.series, given.kills, given.seed)


if __name__ == "__main__":
    main()
