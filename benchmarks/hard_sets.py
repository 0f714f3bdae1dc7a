"""The time that `match_points` takes for sets that are hard on it: regular, dense, coincident, unrelated.

    python -m benchmarks.hard_sets [--points 32 200 1000]

By the clock, for the bound is one of waiting: run it with nothing beside it.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator

import numpy as np

from benchmarks.correspondence import body_scene
from ronnaplan.correspondence import match_points
from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM
from ronnaplan.studies.scenes import uniform_in_ball

WORST = 5
"""Sets printed of each size."""

Sets = tuple[FloatArray, FloatArray]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[32, 200, 1000], help="points a set")
    counts = parser.parse_args().points
    for _, sets in (*hard_sets(20), *(next(hard_sets(count)) for count in counts)):
        match_points(*sets)  # what is compiled is loaded once a process
    for count in counts:
        times = []
        for name, (ct, ots) in hard_sets(count):
            clock, processor = time.perf_counter(), time.process_time()
            status = match_points(ct, ots).status
            times.append((time.perf_counter() - clock, time.process_time() - processor, name, status))
        for waited, worked, name, status in sorted(times, reverse=True)[:WORST]:
            print(f"{count} points, {name}: {1e3 * waited:.0f} ms, processor {1e3 * worked:.0f} ms, {status}")


def hard_sets(count: int) -> Iterator[tuple[str, Sets]]:
    """Return sets of so many points (mm), named."""
    rng = np.random.default_rng(count)

    def read(points: FloatArray, errors: float = 1.0) -> Sets:
        ct, ots = (points + errors * s * rng.standard_normal(points.shape) for s in (SIGMA_CT_MM, SIGMA_OTS_MM))
        return ct, ots

    def ball(points: int, radius: float) -> FloatArray:
        return uniform_in_ball(rng, (points,), radius)

    for step in (8.0, 20.0, 30.0):
        axis = step * np.arange(math.ceil(count ** (1.0 / 3.0)))
        lattice = np.array(np.meshgrid(axis, axis, axis)).reshape(3, -1).T[:count]
        yield f"lattice of {step:g} mm", read(lattice)
        yield f"lattice of {step:g} mm without errors", (lattice, lattice + 3.0)
    angles = np.arange(count) * 2.0 * np.pi / count
    for radius in (80.0, 200.0):
        circle = radius * np.column_stack((np.cos(angles), np.sin(angles), 0.0 * angles))
        yield f"circle of {radius:g} mm", read(circle)
    for radius in (8.0, 20.0, 90.0):
        yield f"cloud of {radius:g} mm", read(ball(count, radius))
    fours = np.vstack((ball(count // 4 + 1, 90.0),) * 4)[:count]
    yield "four at each place", read(fours)
    yield "four at each place without errors", (fours, fours + 3.0)
    yield "all at one place", read(np.zeros((count, 3)), 4.0)
    yield "line", read(np.linspace(0.0, 300.0, count)[:, None] * [1.0, 0.0, 0.0])
    for radius in (20.0, 45.0, 90.0, 300.0):
        yield f"unrelated in {radius:g} mm", (ball(count, radius), ball(count, radius))
    for few in (12, 40, max(count // 3, 4)):
        yield f"unrelated, {few} points of the other", (ball(few, 50.0), ball(count, 50.0))
    markers, outliers = count // 5, count - count // 5
    for field in (25.0, 45.0):
        yield f"80 % outliers in {field:g} mm", body_scene(rng, markers, outliers, field, 0)[:2]
    for errors in (3.0, 4.0):
        yield f"errors {errors:g} times as stated", read(ball(count, 90.0), errors)
    flat = ball(count, 60.0) * [1.0, 1.0, 0.0]
    yield "flat", read(flat)
    yield "unrelated on planes", (flat, ball(count, 60.0) * [1.0, 1.0, 0.0])
    spheres = [
        80.0 * points / np.linalg.norm(points, axis=1, keepdims=True) for points in rng.normal(size=(2, count, 3))
    ]
    yield "unrelated on spheres", (spheres[0], spheres[1])
    half = ball(count, 60.0)
    half[: count // 2, 2] = 0.0
    yield "half flat and mirrored", (half * [1.0, 1.0, -1.0], half)


if __name__ == "__main__":
    main()
