"""The published correspondence algorithm: Šuligoj et al. 2018, section 4.1, Fig. 5, step by step.

It is the baseline of every study.  It states no probability and lists no rivals; use `match_points` for patients.
"""

from __future__ import annotations

import math
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kernelcache import njit
from ronnaplan.correspondence.graph import distances
from ronnaplan.correspondence.inputs import checked_number, checked_points
from ronnaplan.correspondence.pairing import IntArray, Pairing
from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray

MOST_STEPS = 100_000
"""Of the tolerance: the paper's are 50; a step that no sum of two numbers shows would never end."""

TOLERANCE_ROUNDING = 1e-9
"""Added to the last tolerance so that 1.0, 1.1 ... 6.0 mm includes 6.0 despite rounding."""


def match_by_similarity(
    ct_points: ArrayLike,
    ots_points: ArrayLike,
    expected: int,
    e_start_mm: float = 1.0,
    e_stop_mm: float = 6.0,
    e_step_mm: float = 0.1,
    *,
    one_to_one: bool = True,
) -> Pairing:
    """Pair ``expected`` points of (n, 3) and (m, 3), in mm, by their shared distances (Eq. 10-13, steps 1-5).

    ``one_to_one``: each distance is shared with one other only; otherwise every distance that has any partner counts,
    up to min(n, m) - 1 (Eq. 11 allows both readings; the second refuses as often as the paper reports).  The
    tolerance e rises from ``e_start_mm`` to ``e_stop_mm`` until one pairing is found; otherwise the answer is
    ``unmatched``.  Raises `InputError` for unusable points, an impossible expected number or range of e.
    """
    ct, ots = checked_points(ct_points, "CT points"), checked_points(ots_points, "OTS points")
    count = checked_number(expected)
    if count is None:
        raise InputError(
            "no number of pairs is expected; the published algorithm needs it, so give a whole number"
        )
    if count > min(len(ct), len(ots)):
        raise InputError(
            f"{count} pairs are expected but the sets hold {len(ct)} CT and {len(ots)} OTS points; "
            "find the missing markers or lower the number"
        )
    for name, number in (("e_start_mm", e_start_mm), ("e_stop_mm", e_stop_mm), ("e_step_mm", e_step_mm)):
        check_type(number, Real, name, "give a number")
    risen_mm = e_stop_mm - e_start_mm
    if not (e_start_mm > 0 and 0 <= risen_mm < math.inf and e_step_mm > 0 and risen_mm <= MOST_STEPS * e_step_mm):
        raise InputError(
            f"the tolerance runs from {e_start_mm} to {e_stop_mm} mm by {e_step_mm}; "
            f"expected 0 < start <= stop and a positive step, {MOST_STEPS} steps at most"
        )
    partner = similarity_match(ct, ots, count, e_start_mm, e_stop_mm, e_step_mm, one_to_one)
    i = np.flatnonzero(partner >= 0)
    if len(i) == 0:
        reason = f"no tolerance from {e_start_mm:g} to {e_stop_mm:g} mm leaves one pairing of {count} points"
        return Pairing.unmatched(reason, math.nan)
    stated = np.full(len(i), math.nan)
    return Pairing("unique", np.column_stack((i, partner[i])), math.nan, pair_probabilities=stated)


@njit(cache=True, nogil=True)
def similarity_match(
    ct: FloatArray, ots: FloatArray, expected: int, e_start: float, e_stop: float, e_step: float, one_to_one: bool
) -> IntArray:
    """Return the partner (n,) of each CT point (n, 3) among (m, 3), -1 for none; all -1 when unsuccessful."""
    e = e_start
    while e <= e_stop + TOLERANCE_ROUNDING:
        partner = match_within(ct, ots, expected, e, one_to_one)
        if (partner >= 0).any():
            return partner
        e += e_step  # step 5A
    return np.full(len(ct), -1)


def similarity_match_many(
    ct: FloatArray, ots: FloatArray, expected: int, e_start: float, e_stop: float, e_step: float, one_to_one: bool
) -> IntArray:
    """Match T sets (T, n, 3) and (T, m, 3); return the partners (T, n).

    It is no kernel: to compile all once more within another one takes as long as a million calls do.
    """
    partner = np.empty(ct.shape[:2], np.int64)
    for t in range(len(ct)):
        partner[t] = similarity_match(ct[t], ots[t], expected, e_start, e_stop, e_step, one_to_one)
    return partner


@njit(cache=True, nogil=True)
def match_within(ct: FloatArray, ots: FloatArray, expected: int, e: float, one_to_one: bool) -> IntArray:
    """Run steps 1 to 4 with one tolerance e; return the partner (n,) of each CT point (n, 3)."""
    rows, columns = np.arange(len(ct)), np.arange(len(ots))
    nothing = np.full(len(ct), -1)
    while len(rows) >= expected and len(columns) >= expected:
        candidates = similarity_matrix(ct[rows], ots[columns], e, one_to_one) >= expected - 1  # steps 1 to 3
        keep_rows, keep_columns = any_per_row(candidates), any_per_row(candidates.T)
        if keep_rows.all() and keep_columns.all():
            if len(rows) != expected or len(columns) != expected:
                return nothing
            found = unique_partners(candidates)  # step 4C
            if (found < 0).any():
                found = complete_by_coordinates(ct[rows], ots[columns], found, e)  # step 4B
            if (found < 0).any():
                return nothing
            for a in range(len(rows)):
                nothing[rows[a]] = columns[found[a]]
            return nothing  # step 5B
        rows, columns = rows[keep_rows], columns[keep_columns]  # step 4A
    return nothing


@njit(cache=True, nogil=True)
def any_per_row(matrix: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell of each row of (n, m) whether any value in it meets the condition."""
    return np.array([matrix[a].any() for a in range(len(matrix))])


@njit(cache=True, nogil=True)
def similarity_matrix(ct: FloatArray, ots: FloatArray, e: float, one_to_one: bool) -> IntArray:
    """Return sim_ij (n, m), Eq. 11 and 12: how many distances of CT point i have a partner within e at OTS point j."""
    d_ct, d_ots = distances(ct), distances(ots)  # Eq. 10
    for a in range(len(ct)):
        d_ct[a].sort()
    for b in range(len(ots)):
        d_ots[b].sort()
    sim = np.zeros((len(ct), len(ots)), np.int64)
    for a in range(len(ct)):
        for b in range(len(ots)):
            if one_to_one:
                sim[a, b] = shared_distances(d_ct[a, 1:], d_ots[b, 1:], e)
            else:
                sim[a, b] = min(partnered_distances(d_ct[a, 1:], d_ots[b, 1:], e), len(ots) - 1)
    return sim


@njit(cache=True, nogil=True)
def partnered_distances(first: FloatArray, second: FloatArray, e: float) -> int:
    """Count the distances of the first (k,) with any partner in the second (l,) that differs by less than e."""
    count = 0
    for distance in first:
        if (np.abs(second - distance) < e).any():
            count += 1
    return count


@njit(cache=True, nogil=True)
def shared_distances(first: FloatArray, second: FloatArray, e: float) -> int:
    """Count the one-to-one partners of rising (k,) and (l,) that differ by less than e: at most the shorter one."""
    a = b = shared = 0
    while a < len(first) and b < len(second):
        if abs(first[a] - second[b]) < e:
            shared += 1
            a += 1
            b += 1
        elif first[a] < second[b]:
            a += 1
        else:
            b += 1
    return shared


@njit(cache=True, nogil=True)
def unique_partners(candidates: NDArray[np.bool_]) -> IntArray:
    """Return the partner of each row of (n, m) whose only candidate has no other candidate; -1 for the others."""
    found = np.full(len(candidates), -1)
    for a in range(len(candidates)):
        options = np.flatnonzero(candidates[a])
        if len(options) == 1 and candidates[:, options[0]].sum() == 1:
            found[a] = options[0]
    return found


@njit(cache=True, nogil=True)
def complete_by_coordinates(ct: FloatArray, ots: FloatArray, found: IntArray, e: float) -> IntArray:
    """Pair (n,) the rest by their coordinates in the frame of the first three uniquely paired points, within e."""
    anchors = np.flatnonzero(found >= 0)[:3]
    if len(anchors) < 3:
        return found
    ct_local = (ct - ct[anchors[0]]) @ frame_of(ct[anchors])
    ots_local = (ots - ots[found[anchors[0]]]) @ frame_of(ots[found[anchors]])
    completed = found.copy()
    for a in np.flatnonzero(found < 0):
        options = [
            b
            for b in range(len(ots))
            if not (found == b).any() and np.sqrt(((ct_local[a] - ots_local[b]) ** 2).sum()) < e
        ]
        if len(options) == 1 and not (completed == options[0]).any():
            completed[a] = options[0]
    return completed


@njit(cache=True, nogil=True)
def frame_of(points: FloatArray) -> FloatArray:
    """Return the axes (columns) of the coordinate system built on three points (3, 3)."""
    axes = np.zeros((3, 3))
    x, w = points[1] - points[0], points[2] - points[0]
    z = np.cross(x, w)
    y = np.cross(z, x)
    for column, axis in enumerate((x, y, z)):
        length = np.sqrt((axis**2).sum())
        if length > 0:
            for d in range(3):
                axes[d, column] = axis[d] / length
    return axes
