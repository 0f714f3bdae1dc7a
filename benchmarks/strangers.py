"""How often the markers of one head are taken for those of another: two random heads, paired all the same.

    python -m benchmarks.strangers [--pairs N] [--seed N]

Heads are upper halves of ellipsoids of any adult's size, with eight markers anywhere on them, no two closer than
25 mm; their readings err as stated.  Whatever is accepted is wrong.  Beside the answers as they are, those with the
tight bound on what the search leaves out (`evidence.LOOSE_CHI2`).
"""

from __future__ import annotations

import argparse
from unittest import mock

import numpy as np
from tqdm import tqdm

from ronnaplan import match_points
from ronnaplan.correspondence import priors
from ronnaplan.correspondence.evidence import GATE_CHI2
from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM
from ronnaplan.studies.scenes import random_rotations

MARKERS = 8
APART_MM = 25.0
LEAST_MM, MOST_MM = np.array([68.0, 85.0, 75.0]), np.array([82.0, 105.0, 95.0])
"""Half of a head's breadth and length, and its height above the ears."""
EXPECTED = (None, 8, 5, 4, 3)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=15_000)
    parser.add_argument("--seed", type=int, default=70521)
    given = parser.parse_args()
    print(f"| expected | accepted of {given.pairs} | with the tight bound |\n|---|---|---|")
    for expected in EXPECTED:
        as_it_is = accepted(given.pairs, given.seed, expected)
        with mock.patch.object(priors, "LOOSE_CHI2", GATE_CHI2):
            forget()
            tight = accepted(given.pairs, given.seed, expected)
        forget()
        print(f"| {expected or 'not stated'} | {as_it_is} | {tight} |", flush=True)


def forget() -> None:
    """Have what was computed of the bound be computed anew."""
    priors.tail_beyond_gate.cache_clear()
    priors.residual_priors.cache_clear()


def accepted(pairs: int, seed: int, expected: int | None) -> int:
    """Return how many pairs of heads are taken for one."""
    rng = np.random.default_rng(seed)
    count = 0
    for _ in tqdm(range(pairs), leave=False, desc=f"expected: {expected}", disable=None):
        ct = head(rng) + rng.normal(0.0, SIGMA_CT_MM, (MARKERS, 3))
        (turn,) = random_rotations(rng, 1)
        ots = head(rng) @ turn.T + rng.normal(0.0, SIGMA_OTS_MM, (MARKERS, 3))
        count += match_points(ct, ots, expected=expected).status == "unique"
    return count


def head(rng: np.random.Generator) -> FloatArray:
    """Return the markers on a head (8, 3), mm, its center at the origin."""
    half_mm = rng.uniform(LEAST_MM, MOST_MM)
    markers: list[FloatArray] = []
    while len(markers) < MARKERS:
        direction = rng.normal(size=3)
        direction[2] = abs(direction[2])
        one = direction / np.linalg.norm(direction / half_mm)
        if all(np.linalg.norm(one - other) >= APART_MM for other in markers):
            markers.append(one)
    return np.array(markers)


if __name__ == "__main__":
    main()
