"""Two rigid bodies that moved against each other: whether equal ones are refused, and the larger is paired.

    python -m benchmarks.two_bodies [--tests N] [--seed N]

Balls, half shells, plates, rows and pairs of clusters of 6 to 45 markers, up to 1.5 times as many outliers in 60 to
300 mm, with errors of once to three times the stated.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.matchers import Pairs
from ronnaplan.correspondence import match_points
from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM
from ronnaplan.studies.scenes import uniform_in_ball

FEWER, SCALES = (0, 3, 4), (1.0, 1.4, 2.0, 3.0)
"""Markers that the second body has less, and errors over the stated ones."""

LEAST_MARKERS, MOST_MARKERS = 6, 45
PLATE_MM, ROW_MM = 3.0, 6.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tests", type=int, default=600, help="scenes a row")
    parser.add_argument("--seed", type=int, default=930)
    arguments = parser.parse_args()
    print("| markers less | errors | refused | the first | the second | another | processor time, s |")
    print("|---|---|---|---|---|---|---|")
    for fewer in FEWER:
        for scale in SCALES:
            start, count = time.process_time(), Counter[str]()
            for test in range(arguments.tests):
                rng = np.random.default_rng([arguments.seed, int(10 * scale), fewer, test])
                count[judged(*scene(rng, fewer, scale))] += 1
            numbers = [count[name] for name in ("refused", "first", "second", "another")]
            seconds = time.process_time() - start
            print(f"| {fewer} | {scale:g} | {' | '.join(map(str, numbers))} | {seconds:.0f} |", flush=True)


def judged(ct: FloatArray, ots: FloatArray, partner: Pairs, first: int, second: int) -> str:
    """Return which body is paired: the one that holds most of the pairs, rightly."""
    pairs = match_points(ct, ots).pairs
    if len(pairs) == 0:
        return "refused"
    i, j = pairs.T
    right = partner[i] == j
    if 2 * (right & (i < first)).sum() > len(i):
        return "first"
    return "second" if 2 * (right & (i >= first) & (i < first + second)).sum() > len(i) else "another"


def scene(rng: np.random.Generator, fewer: int, scale: float) -> tuple[FloatArray, FloatArray, Pairs, int, int]:
    """Return a CT set, an OTS set, the true partners, and how many markers the bodies have, the first's first."""
    drawn = int(np.exp(rng.uniform(np.log(LEAST_MARKERS), np.log(MOST_MARKERS + 1))))
    first = max(drawn, LEAST_MARKERS, fewer + 3)
    second = first - fewer
    one, other = body(rng, first), body(rng, second)
    field = rng.uniform(60.0, 300.0)
    outliers = int(rng.uniform(0.0, 1.5) * first)
    other = other + uniform_in_ball(rng, (1,), field)
    one = one + uniform_in_ball(rng, (1,), 0.5 * field)
    center = other.mean(axis=0)
    moved = Rotation.from_quat(rng.normal(size=4)).apply(other - center) + center + rng.uniform(-60.0, 60.0, 3)
    ct_true, ots_true = np.vstack((one, other)), np.vstack((one, moved))
    ct, ots = (
        np.vstack((true + scale * sigma * rng.normal(size=true.shape), uniform_in_ball(rng, (outliers,), field)))
        for sigma, true in ((SIGMA_CT_MM, ct_true), (SIGMA_OTS_MM, ots_true))
    )
    order = rng.permutation(len(ots))
    turned = Rotation.from_quat(rng.normal(size=4)).apply(ots[order]) + rng.uniform(-500.0, 500.0, 3)
    partner = np.where(np.arange(len(ct)) < first + second, np.argsort(order), -1)
    return ct, turned, partner, first, second


def body(rng: np.random.Generator, count: int) -> FloatArray:
    """Return so many markers (count, 3) of a body of one of five shapes, 60 to 180 mm wide."""
    shape, radius = rng.integers(5), rng.uniform(30.0, 90.0)
    if shape == 0:
        return uniform_in_ball(rng, (count,), radius)
    if shape == 1:
        direction = rng.normal(size=(count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        return np.asarray(radius * np.column_stack((direction[:, :2], np.abs(direction[:, 2]))))
    if shape == 2:
        return rng.uniform(-0.5, 0.5, (count, 3)) * [1.5 * radius, 1.5 * radius, PLATE_MM]
    if shape == 3:
        return rng.uniform(-0.5, 0.5, (count, 3)) * [2.0 * radius, ROW_MM, ROW_MM]
    clusters = uniform_in_ball(rng, (2,), radius)
    return np.asarray(clusters[rng.integers(2, size=count)] + uniform_in_ball(rng, (count,), radius / 3.0))


if __name__ == "__main__":
    main()
