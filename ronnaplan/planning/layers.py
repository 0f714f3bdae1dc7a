"""What a straight path meets on its way out of the head: brain, inner table, outer table, scalp, air."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.planning.head import SKIN_HU
from ronnaplan.planning.sampling import SliceSampler

STEP_MM = 0.5
"""Sampling step of the search; what it finds is refined by a fit."""

LONGEST_WAY_MM = 260.0
"""No path inside a head is longer."""

BONE_HU = 300.0
"""Denser than this is bone, as far as the search goes."""

DEEPEST_SKULL_MM = 40.0
"""The outer table lies within this below the scalp, along the path; else there is no bone (a craniotomy)."""

DIPLOE_MM = 4.0
"""A gap in the bone shorter than this is diploe or an air cell, not the inner side."""

COVER_MM = 5.0
"""Tissue-like matter that reaches further beyond the head than this is something attached: a post, an ear."""


class Way(IntEnum):
    """How the search along a path ended."""

    OPEN = 0
    """It left the head through skin into air."""
    CUT = 1
    """It left the scan before it left the head."""
    COVERED = 2
    """It left the head through something attached to it, such as a marker's post."""


def way_out(
    scan: SliceSampler, inside: NDArray[np.bool_], cell: int, start_mm: FloatArray, outward: FloatArray
) -> tuple[Way, float, float, float]:
    """Search from ``start_mm`` (3,) along unit ``outward`` (3,), both LPS, in the coarse head (`Head.inside`).

    Returns how it ended and the reach of scalp, outer and inner table in mm; NaN: not met.
    `ronnaplan.planning.compiled` holds the same search for many rays.
    """
    reach = STEP_MM * np.arange(int(LONGEST_WAY_MM / STEP_MM))
    values = scan.values_hu(start_mm + reach[:, np.newaxis] * outward)
    start, direction = scan.axes @ start_mm, scan.axes @ outward
    seen = values[: int(np.isnan(values).argmax())] if np.isnan(values).any() else values
    leaves = (seen[:-1] >= SKIN_HU) & (seen[1:] < SKIN_HU)
    for n in (np.flatnonzero(leaves) + 1).tolist():
        beyond, before = (start + (n * STEP_MM + cover) * direction for cover in (COVER_MM, -COVER_MM))
        if is_inside(inside, cell, scan.origins_uv_mm, scan.w_mm, scan.steps_mm, beyond):
            continue
        scalp = crossing(values, n, SKIN_HU)
        if not is_inside(inside, cell, scan.origins_uv_mm, scan.w_mm, scan.steps_mm, before):
            return Way.COVERED, scalp, np.nan, np.nan
        outer, inner = (crossing(values, m, BONE_HU) if m > 0 else np.nan for m in bone(values, n))
        return Way.OPEN, scalp, outer, inner
    return Way.CUT, np.nan, np.nan, np.nan


def is_inside(
    inside: NDArray[np.bool_],
    cell: int,
    origins: FloatArray,
    w_mm: FloatArray,
    steps: FloatArray,
    point: FloatArray,
) -> bool:
    """Whether (u, v, w) lies in the coarse head, in the slice next to it."""
    k = np.searchsorted(w_mm, point[2])
    if k >= len(w_mm) or (k > 0 and point[2] - w_mm[k - 1] < w_mm[k] - point[2]):
        k -= 1
    j = int((point[1] - origins[k, 1]) / steps[1]) // cell
    i = int((point[0] - origins[k, 0]) / steps[0]) // cell
    return bool(0 <= j < inside.shape[1] and 0 <= i < inside.shape[2] and inside[k, j, i])


def crossing(values: FloatArray, n: int, level: float) -> float:
    """Return the reach in mm at which ``values`` (N,), HU, passes ``level`` between samples n - 1 and n."""
    return float((n - 1 + (values[n - 1] - level) / (values[n - 1] - values[n])) * STEP_MM)


def bone(values: FloatArray, scalp: int) -> tuple[int, int]:
    """Return the samples of (N,) HU just beyond the outer and inner table below sample ``scalp``; 0 where not met."""
    outer = 0
    for n in range(scalp, max(scalp - int(DEEPEST_SKULL_MM / STEP_MM), 0), -1):
        if values[n - 1] >= BONE_HU > values[n]:
            outer = n
            break
    if outer == 0:
        return 0, 0
    last = outer - 1
    for n in range(outer - 1, -1, -1):
        if values[n] >= BONE_HU:
            last = n
        elif last - n >= DIPLOE_MM / STEP_MM:
            break
    return outer, last
