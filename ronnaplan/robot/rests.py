"""Which poses of a recording count, where tool or robot is held still for a part of it.

Poses of a rest err alike, and less than those that move. Beside many of them, what is usual of all would be what is of
one place and no motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray

REST_DEG, REST_MM = 5.0, 20.0
"""Successive poses that turn, and move, by less from the first of them are of one rest."""
LARGEST_SHARE, TIMES_EVEN = 0.1, 2.0
"""No rest is a larger share of the poses that count than the first, nor, as of a robot that stops at a few places, more
than so many times what each would be if all were alike ..."""
FEWEST_OF_REST = 10
"""... or is of no more poses than these."""


def beside_rests(rotations: FloatArray, places_mm: FloatArray | None = None) -> NDArray[np.bool_]:
    """Return which of successive poses (N, 3, 3) and, where they may move without turning, (N, 3) count.

    Those of a rest that do lie evenly in it.
    """
    begins, least_trace = [0], 1 + 2 * np.cos(np.radians(REST_DEG))
    for n, rotation in enumerate(rotations):  # the trace of the turn between two is the sum of products
        turned = (rotation * rotations[begins[-1]]).sum() < least_trace
        moved = places_mm is not None and np.linalg.norm(places_mm[n] - places_mm[begins[-1]]) > REST_MM
        begins += [n] if turned or moved else []
    counts = np.diff([*begins, len(rotations)])
    share, most = max(LARGEST_SHARE, TIMES_EVEN / len(counts)), int(counts.max())
    while most > max(FEWEST_OF_REST, share * np.minimum(counts, most).sum()):
        most -= 1
    told = np.zeros(len(rotations), dtype=bool)
    for begin, count in zip(begins, counts, strict=True):
        told[begin + np.linspace(0, count - 1, min(count, most)).round().astype(int)] = True
    return told
