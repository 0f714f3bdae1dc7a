"""A cohort at scale: listing many files, working many series off, and the same while everything is killed (Linux).

    python -m benchmarks.cohort listing [--files 100000]
    python -m benchmarks.cohort series [--series 200] [--workers 2]
    python -m benchmarks.cohort kills [--series 200] [--kills 20] [--pause 10] [--seed 1]
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
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np

from benchmarks.cohort_material import DIAMETERS_MM, make_files, make_series
from ronnaplan.cohort.charts import control_chart
from ronnaplan.cohort.cohort import run_cohort
from ronnaplan.cohort.index import Index
from ronnaplan.cohort.listing import bring_up_to_date
from ronnaplan.cohort.planning import decide, orders, tasks_of
from ronnaplan.cohort.rules import CohortRule, Rules
from ronnaplan.cohort.work import work
from tests.cohort.scans import CENTERS_MM
from tests.cohort.under_fire import UnderFire

RULES = Rules(rule=(CohortRule(name="all", diameters=DIAMETERS_MM, expected=len(CENTERS_MM)),))
RULES_FILE = (
    f"[limits]\nattempts = 1000\n[[rule]]\nname = 'all'\n"
    f"diameters = {list(DIAMETERS_MM)}\nexpected = {len(CENTERS_MM)}\n"
)


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
    with Index(folder / "alone") as index:
        bring_up_to_date(index, [str(folder / "in")])
        tasks = tasks_of(RULES)
        decide(index, RULES, tasks)
        given = [order for _, order, _ in orders(index, RULES, tasks)]
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
    start, begun = cpu_s(), time.monotonic()
    counts = run_cohort([str(folder / "in")], folder / "out", RULES, workers=workers)
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


def kills(folder: Path, count: int, most: int, pause_s: float, seed: int) -> None:
    """Work a cohort off in peace and under fire; say whether the tables are the same."""
    from pyarrow import parquet

    make_series(folder / "in", count)
    (folder / "rules.toml").write_text(RULES_FILE)
    command = ["-m", "ronnaplan", "cohort", str(folder / "in"), "--rules", str(folder / "rules.toml"), "-o"]
    peace = [*(sys.executable, *command, str(folder / "peace")), "--workers", "2"]
    subprocess.run(peace, check=True, cwd=folder)
    fire, draws = UnderFire(folder, [*command, str(folder / "killed"), "--scheduler"]), random.Random(seed)
    begun = time.monotonic()
    try:
        fire.tend()
        while True:
            fire.pause(draws.uniform(0.0, 2.0 * pause_s))
            if fire.is_done:
                break
            if fire.killed.total() < most:
                fire.kill(draws.choice(fire.names), draws)
            fire.tend()
    finally:
        fire.close()
    wall = time.monotonic() - begun
    tables = {
        name: tuple(parquet.read_table(folder / out / name) for out in ("peace", "killed"))
        for name in ("series.parquet", "markers.parquet")
    }
    same = {f"{name}, {ours.num_rows} rows": ours.equals(theirs) for name, (ours, theirs) in tables.items()}
    series, _ = tables["series.parquet"]
    states = Counter(series.column("state").to_pylist())
    print(
        f"killed in {wall:.0f} s: {dict(fire.killed)}; {dict(states)}; the same: {same}; load {os.getloadavg()[0]:.0f}"
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
    parser.add_argument("--pause", type=float, default=10.0, metavar="S", help="from kill to kill, on average")
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
            kills(folder, given.series, given.kills, given.pause, given.seed)


if __name__ == "__main__":
    main()
