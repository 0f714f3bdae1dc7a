"""The size that a scan's markers have in common, found without being told."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.errors import RefusedError
from ronnaplan.localization.examine import Scan, distinct, examine

SEARCHED_MM = (3.0, 26.0)
"""Markers in use have diameters within this range."""

STEP = 1.1
"""Each size tried is this much larger than the last: within the tolerance of the acceptance tests."""

SAME_SIZE = 0.03
"""Balls whose diameters differ by at most this share are of one kind."""

MIN_MARKERS = 3
"""Fewer balls of one size could be anything; a registration needs three."""


def common_diameter(volume: CTVolume) -> float:
    """Diameter (mm) of the commonest kind of ball in a scan.

    Raises `RefusedError` when fewer than `MIN_MARKERS` balls have one size, or two sizes are equally common.
    """
    scan = Scan(volume)
    smallest_mm = max(SEARCHED_MM[0], 3.0 * volume.grid.row_spacing_mm)
    steps = np.arange(np.log(smallest_mm), np.log(SEARCHED_MM[1]), np.log(STEP))
    accepted = [one for step in steps for one in examine(scan, float(np.exp(step))) if one.is_marker]
    kinds = sorted(_kinds([one.diameter_mm for one in distinct(accepted)]), key=len, reverse=True)
    seen = ", ".join(f"{len(kind)} of {np.median(kind):.1f} mm" for kind in kinds) or "none"
    if not kinds or len(kinds[0]) < MIN_MARKERS:
        raise RefusedError(f"no {MIN_MARKERS} balls of one size were found (found: {seen}); state the diameter")
    if len(kinds) > 1 and len(kinds[1]) == len(kinds[0]):
        raise RefusedError(f"two sizes of balls are equally common (found: {seen}); state the diameter")
    return float(np.median(kinds[0]))


def _kinds(diameters_mm: list[float]) -> list[list[float]]:
    """Sort diameters into runs without a gap larger than `SAME_SIZE`."""
    ordered = sorted(diameters_mm)
    kinds = [[first] for first in ordered[:1]]
    for smaller, larger in pairwise(ordered):
        if larger > smaller * (1.0 + SAME_SIZE):
            kinds.append([])
        kinds[-1].append(larger)
    return kinds
