"""A pose fitted to the pairs that it makes, in kernels that numba compiles."""

from __future__ import annotations

import numpy as np

from kernelcache import njit
from ronnaplan.correspondence.lookup import Grid, nearest
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.geometry import FloatArray

PAIR_SIGMAS = 5.5
"""Points further apart than this many standard deviations under the fitted pose do not pair."""

REFINING_SIGMAS = (1.6 * PAIR_SIGMAS,) * 2 + (PAIR_SIGMAS,) * 8
"""How near pairs must be in each fit of a pose, until they stay: the first rest on three points only.  Most stay
after three to five fits; one that did not was weighed by pairs that are not its own."""


@njit(cache=True, nogil=True, error_model="numpy")
def partners_under(ct: FloatArray, ots: FloatArray, grid: Grid, pose: FloatArray, radius: float) -> IntArray:
    """Return the nearest OTS point of each CT point under a pose (3, 4), -1 when none is within ``radius``.

    An OTS point goes to the nearest CT point.
    """
    partner, taken_by, square = np.full(len(ct), -1), np.full(len(ots), -1), np.full(len(ots), np.inf)
    start, order, _, places, cells = grid
    for i in range(len(ct)):
        u, v, w = ct[i, 0], ct[i, 1], ct[i, 2]
        x = pose[0, 0] * u + pose[0, 1] * v + pose[0, 2] * w + pose[0, 3]
        y = pose[1, 0] * u + pose[1, 1] * v + pose[1, 2] * w + pose[1, 3]
        z = pose[2, 0] * u + pose[2, 1] * v + pose[2, 2] * w + pose[2, 3]
        j, d = nearest(start, order, places, cells, x, y, z, radius)
        if j >= 0 and d < square[j]:
            if taken_by[j] >= 0:
                partner[taken_by[j]] = -1
            partner[i], taken_by[j], square[j] = j, i, d
    return partner


@njit(cache=True, nogil=True, error_model="numpy")
def fitted(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the rigid pose (3, 4) that brings points x (k, 3) closest to y (Kabsch 1978), never a reflection."""
    x0, y0 = np.empty(3), np.empty(3)
    for d in range(3):
        x0[d], y0[d] = x[:, d].mean(), y[:, d].mean()
    u, _, vt = np.linalg.svd(np.ascontiguousarray((y - y0).T) @ (x - x0))
    if np.linalg.det(np.ascontiguousarray(u) @ np.ascontiguousarray(vt)) < 0.0:
        for d in range(3):
            u[d, 2] = -u[d, 2]
    pose = np.empty((3, 4))
    turn = np.ascontiguousarray(u) @ np.ascontiguousarray(vt)
    moved = turn @ x0
    for d in range(3):
        for c in range(3):
            pose[d, c] = turn[d, c]
        pose[d, 3] = y0[d] - moved[d]
    return pose


@njit(cache=True, nogil=True, error_model="numpy")
def refined(
    ct: FloatArray, ots: FloatArray, grid: Grid, poses: FloatArray, reaches: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Fit poses (K, 3, 4) to their pairs within each of the ``reaches`` in turn; return them and their pairs (K, n).

    The pairs are those within the last reach.
    """
    fits, partners = poses.copy(), np.empty((len(poses), len(ct)), np.int64)
    for k in range(len(poses)):
        pose = poses[k]
        partner = partners_under(ct, ots, grid, pose, reaches[0])
        is_fitted = False
        for step in range(1, len(reaches)):
            if not is_fitted:
                i = np.flatnonzero(partner >= 0)
                if len(i) < 3:
                    break
                pose = fitted(ct[i], ots[partner[i]])
            elif reaches[step] == reaches[step - 1]:
                continue
            before, partner = partner, partners_under(ct, ots, grid, pose, reaches[step])
            is_fitted = bool((before == partner).all())
        for i_ct in range(len(ct)):
            partners[k, i_ct] = partner[i_ct]
        for d in range(3):
            for c in range(4):
                fits[k, d, c] = pose[d, c]
    return fits, partners
