"""Plain matchers that the correspondence benchmark compares with: each pairs ``expected`` points or none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from ronnaplan.geometry import FloatArray
from ronnaplan.rigid import fit_closed_form
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM

Pairs = NDArray[np.int64]

SIGMA_MM = float(np.hypot(SIGMA_CT_MM, SIGMA_OTS_MM))
GATE_MM = 4.0 * np.sqrt(2.0) * SIGMA_MM
CHI2_GAP = 9.2
ACCEPT_MM = 3.0


def none() -> Pairs:
    """Return no pairs."""
    return np.zeros((0, 2), dtype=np.int64)


def misfit(ct: FloatArray, ots: FloatArray, pairs: Pairs) -> float:
    """Return the chi^2 of the best rigid fit of pairs."""
    x, y = ct[pairs[:, 0]], ots[pairs[:, 1]]
    matrix = fit_closed_form(x, y)
    return float(((x @ matrix[:3, :3].T + matrix[:3, 3] - y) ** 2).sum()) / SIGMA_MM**2


def exhaustive(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
    """Try every pairing of the expected number whose distances agree; accept the best if it leads by a chi^2 gap."""
    x, y = cdist(ct, ct), cdist(ots, ots)
    fits: list[tuple[float, Pairs]] = []

    def extend(pairs: list[tuple[int, int]], start: int) -> None:
        if len(pairs) == expected:
            found = np.array(pairs, dtype=np.int64)
            fits.append((misfit(ct, ots, found), found))
            return
        for i in range(start, len(ct) - (expected - len(pairs)) + 1):
            for j in range(len(ots)):
                if all(j != q and abs(x[i, p] - y[j, q]) < GATE_MM for p, q in pairs):
                    extend([*pairs, (i, j)], i + 1)

    extend([], 0)
    fits.sort(key=lambda fit: fit[0])
    if not fits or (len(fits) > 1 and fits[1][0] - fits[0][0] < CHI2_GAP):
        return none()
    return fits[0][1]


def dense_clique(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
    """Take the densest part of the graph of consistent pairs by its leading eigenvector (the idea of CLIPPER)."""
    n, m = len(ct), len(ots)
    i, j = np.indices((n, m)).reshape(2, -1)
    difference = cdist(ct, ct)[i][:, i] - cdist(ots, ots)[j][:, j]
    affinity = np.exp(-(difference**2) / (4.0 * SIGMA_MM**2)) * (np.abs(difference) < GATE_MM)
    affinity[(i[:, None] == i) ^ (j[:, None] == j)] = 0.0
    weight = np.ones(n * m)
    for _ in range(100):
        weight = affinity @ weight
        weight /= np.linalg.norm(weight)
    chosen: list[int] = []
    for node in np.argsort(-weight):
        if len(chosen) < expected and all(affinity[node, other] > 0 for other in chosen):
            chosen.append(int(node))
    pairs = np.column_stack((i[chosen], j[chosen])).astype(np.int64)
    pairs = pairs[np.argsort(pairs[:, 0])]
    return pairs if len(pairs) == expected else none()


def hungarian_icp(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
    """Assign points by their sorted distances, then align and assign again, keeping the ``expected`` closest."""
    depth = min(len(ct), len(ots)) - 1
    x, y = (np.sort(cdist(points, points), axis=1)[:, 1 : depth + 1] for points in (ct, ots))
    cost = cdist(x, y)
    kept = none()
    for _ in range(20):
        rows, columns = linear_sum_assignment(cost)
        closest = np.argsort(cost[rows, columns])[:expected]
        before, kept = kept, np.column_stack((rows[closest], columns[closest])).astype(np.int64)
        matrix = fit_closed_form(ct[kept[:, 0]], ots[kept[:, 1]])
        cost = cdist(ct @ matrix[:3, :3].T + matrix[:3, 3], ots)
        if np.array_equal(before, kept):
            break
    kept = kept[np.argsort(kept[:, 0])]
    return kept if cost[kept[:, 0], kept[:, 1]].max() < ACCEPT_MM else none()
