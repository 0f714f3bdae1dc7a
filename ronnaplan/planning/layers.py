"""What a straight path meets on its way out of the head: brain, inner table, outer table, scalp, air."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numba import njit

from ronnaplan.planning.head import SKIN_HU
from ronnaplan.planning.sampling import sample

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


@njit(cache=True, nogil=True, error_model="numpy")
def is_inside(inside, cell, origins, w_mm, steps, point):  # type: ignore[no-untyped-def]
    """Whether (u, v, w) lies in the coarse head, in the slice next to it."""
    k = np.searchsorted(w_mm, point[2])
    if k >= len(w_mm) or (k > 0 and point[2] - w_mm[k - 1] < w_mm[k] - point[2]):
        k -= 1
    j = int((point[1] - origins[k, 1]) / steps[1]) // cell
    i = int((point[0] - origins[k, 0]) / steps[0]) // cell
    return 0 <= j < inside.shape[1] and 0 <= i < inside.shape[2] and inside[k, j, i]


@njit(cache=True, nogil=True, error_model="numpy")
def way_out(voxels, origins, w_mm, steps, inside, cell, start, direction, values):  # type: ignore[no-untyped-def]
    """Search outwards from ``start`` (u, v, w); ``values`` receives the HU at every `STEP_MM`.

    Returns (how, scalp, outer, inner): a `Way` and the reach of the three surfaces in mm; NaN: not met.
    """
    guess = 0
    for n in range(len(values)):
        place = start + n * STEP_MM * direction
        values[n], guess = sample(voxels, origins, w_mm, steps, place[0], place[1], place[2], guess)
        if np.isnan(values[n]):
            break
        if n == 0 or not (values[n - 1] >= SKIN_HU > values[n]):
            continue
        if is_inside(inside, cell, origins, w_mm, steps, place + COVER_MM * direction):
            continue
        scalp = crossing(values, n, SKIN_HU)
        if not is_inside(inside, cell, origins, w_mm, steps, place - COVER_MM * direction):
            return 2, scalp, np.nan, np.nan
        outer, inner = bone(values, n)
        return 0, scalp, outer, inner
    return 1, np.nan, np.nan, np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def crossing(values, n, level):  # type: ignore[no-untyped-def]
    """Return the reach in mm at which ``values`` passes ``level`` between samples n - 1 and n."""
    return (n - 1 + (values[n - 1] - level) / (values[n - 1] - values[n])) * STEP_MM


@njit(cache=True, nogil=True, error_model="numpy")
def bone(values, scalp):  # type: ignore[no-untyped-def]
    """Return the reach in mm of the outer and inner table below sample ``scalp``; NaN where not met."""
    outer = -1
    for n in range(scalp, max(scalp - int(DEEPEST_SKULL_MM / STEP_MM), 0), -1):
        if values[n - 1] >= BONE_HU > values[n]:
            outer = n
            break
    if outer < 0:
        return np.nan, np.nan
    last = outer - 1
    for n in range(outer - 1, -1, -1):
        if values[n] >= BONE_HU:
            last = n
        elif last - n >= DIPLOE_MM / STEP_MM:
            break
    if last == 0:
        return crossing(values, outer, BONE_HU), np.nan
    return crossing(values, outer, BONE_HU), crossing(values, last, BONE_HU)
