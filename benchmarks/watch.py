"""The live chain: which shifts of head and of robot's base are told, as what, and how often rest is taken for a shift.

    python -m benchmarks.watch [--shifts N] [--seed N] [--sizes MM ...]

Each shift, in a direction drawn at random, is of another room and chain: spheres that err by 0.1 mm per axis, a robot
by 0.03 mm and 0.01 degrees, the chain taken from ten frames and the moment judged of ten.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from phantoms.live_room import LiveRoom
from phantoms.robot_session import placed
from ronnaplan.report.tables import align
from ronnaplan.robot.live import LiveStatus
from tests.robot.live_moments import CASE, live, recording

TOLD = {
    "head_moved": LiveStatus.HEAD_MOVED,
    "base_moved": LiveStatus.ROBOT_MOVED,
    "tracker_moved": LiveStatus.TRACKER_MOVED,
}
"""What is shifted, and what is to be said of it."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shifts", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sizes", type=float, nargs="+", default=[0, 0.25, 0.5, 0.75, 1, 2], metavar="MM")
    arguments = parser.parse_args()
    rows = [["shifted", "by, mm", "told as that", "as nothing", "as another kind"]]
    for what, right in TOLD.items():
        for size_mm in arguments.sizes:
            told = Counter(
                told_of(what, size_mm, seed) for seed in range(arguments.seed, arguments.seed + arguments.shifts)
            )
            other = told.total() - told[right] - told[LiveStatus.VALID]
            counts = (told[right], told[LiveStatus.VALID], other)
            rows.append([what.removesuffix("_moved"), f"{size_mm:g}", *(str(count) for count in counts)])
    print(align(rows))


def told_of(what: str, size_mm: float, seed: int) -> LiveStatus:
    """Return what is said when ``what`` of a room of its own was shifted by so much."""
    room = LiveRoom.of_case(CASE, seed)
    chain = live(room)
    way = np.random.default_rng([seed, 1]).normal(size=3)
    shift = placed(Rotation.identity(), size_mm * way / np.linalg.norm(way))
    return chain.judge(recording(replace(room, **{what: shift}))).status  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
