"""The planner with few and with hundreds of trajectories: the processor's time of an edit.

    python -m benchmarks.crowded [--few 10] [--many 300] [--edits 20]

Without a browser: one page is answered as a browser's would be, and what it would be sent is thrown away. Trajectories
lead from the scalp of the committed scan to targets within 30 mm of one place, every third with an electrode. An edit
moves the target of one of them; the pictures at rest after it are counted. Both ways to draw the head are timed: in the
browser, which asks for what changed, and by the server, as for a browser without a graphics card.
"""

from __future__ import annotations

import argparse
import asyncio
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from ronnaplan.ct import CTVolume, read_ct
from ronnaplan.documents.plan import write_plan
from ronnaplan.errors import RonnaplanError
from ronnaplan.planner.painter import REST_S
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.planner.tab import Tab
from ronnaplan.planning import Head, Plan, Trajectory
from ronnaplan.planning.crossings import find_crossings
from ronnaplan.planning.electrodes import ELECTRODES
from ronnaplan.planning.measures import check_ends
from ronnaplan.scene.head import HeadParts

SMALL = Path(__file__).resolve().parents[1] / "data" / "synthetic_ct"
MIDDLE_MM, REACH_MM = np.array([10.0, 5.0, 20.0]), 30.0
SEED = 1


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--few", type=int, default=10)
    parser.add_argument("--many", type=int, default=300)
    parser.add_argument("--edits", type=int, default=20)
    arguments = parser.parse_args()
    volume, counts = read_ct(SMALL), (arguments.few, arguments.many)
    for drawn_here in (True, False):
        with asyncio.Runner() as loop:
            few, many = (loop.run(edited(volume, count, arguments.edits, drawn_here)) for count in counts)
        drawn = "the browser" if drawn_here else "the server"
        print(f"head drawn by {drawn}: an edit of {arguments.few} trajectories {1e3 * few:.0f} ms, of", end=" ")
        print(f"{arguments.many} {1e3 * many:.0f} ms, {many / few:.1f} times as much")
    return 0


async def edited(volume: CTVolume, count: int, edits: int, drawn_here: bool) -> float:
    """Return the median processor's time, in seconds, of an edit in a plan of so many trajectories."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.json"
        write_plan(path, crowd(volume, count))
        state = PlannerState(volume, Storage.of(str(path), None, None))
        state.case.surroundings.judge_all(state.case.plan)
        tab = Tab(state, lambda _: None)
        tab.painter.pictures = not drawn_here
        tab.head.open(HeadParts())
        await tab.answer("select", ("E0",))
        across_mm = float(state.case.plan.trajectory("E0").target_mm[0])
        taken = []
        for number in range(edits):
            before = time.process_time()
            await tab.answer("place", ("E0", "target", 0, f"{across_mm + number % 5:.2f}"))
            await asyncio.sleep(2 * REST_S)
            taken.append(time.process_time() - before)
        tab.close()
        return median(taken)


def crowd(volume: CTVolume, count: int) -> Plan:
    """Return a plan of so many trajectories."""
    random, head, plan = np.random.default_rng(SEED), Head.of(volume), Plan.of_scan(volume)
    electrodes = list(ELECTRODES.values())
    while len(plan.trajectories) < count:
        number = len(plan.trajectories)
        target_mm, outward = MIDDLE_MM + random.uniform(-REACH_MM, REACH_MM, 3), random.normal(size=3)
        outward[2] = abs(outward[2]) + 0.2
        outward /= np.linalg.norm(outward)
        scalp = find_crossings(head, target_mm, outward).scalp
        if scalp is None:
            continue
        one = Trajectory(f"E{number}", target_mm + scalp.reach_mm * outward, target_mm, plan.frame)
        try:
            check_ends(one, head)
        except RonnaplanError:
            continue
        plan = plan.add(replace(one, electrode=electrodes[number % len(electrodes)] if number % 3 == 0 else None))
    return plan


if __name__ == "__main__":
    raise SystemExit(main())
