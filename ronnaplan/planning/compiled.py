"""The compiled inner loops of the planning room: all ways from a target, and the exchange of marker places.

Loading this loads numba, a hundred megabytes of it, so it is imported where it is used. The search along a ray is
that of `ronnaplan.planning.layers`, for tens of thousands of rays; points are given along the slice axes (u along
a row, v down a column, w along the normal).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.bounds import LOWEST_HU
from ronnaplan.ct.volume import Voxels
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import layers
from ronnaplan.planning.head import SKIN_HU
from ronnaplan.planning.layers import BONE_HU, COVER_MM, LONGEST_WAY_MM, STEP_MM

IntArray = NDArray[np.int64]

AIR_IN_HEAD_HU = -300.0
"""Below this a path inside the head runs through an air space."""

is_inside = njit(cache=True, nogil=True, error_model="numpy")(layers.is_inside)
crossing = njit(cache=True, nogil=True, error_model="numpy")(layers.crossing)
bone = njit(cache=True, nogil=True, error_model="numpy")(layers.bone)


@njit(cache=True, nogil=True, error_model="numpy")
def slice_below(w_mm: FloatArray, w: float, guess: int) -> int:
    """Return k with ``w_mm[k] <= w <= w_mm[k + 1]`` of rising ``w_mm`` (K,), searched from ``guess``; -1 outside."""
    count = len(w_mm)
    if count < 2 or not (w_mm[0] <= w <= w_mm[count - 1]):
        return -1
    k = min(max(guess, 0), count - 2)
    while w < w_mm[k]:
        k -= 1
    while w > w_mm[k + 1]:
        k += 1
    return k


@njit(cache=True, nogil=True, error_model="numpy")
def bilinear(plane: Voxels, row: float, column: float) -> float:
    """Return the value of ``plane`` (J, I) at a fractional place, at least `LOWEST_HU`; NaN outside."""
    rows, columns = plane.shape
    if not (0.0 <= row <= rows - 1 and 0.0 <= column <= columns - 1):
        return np.nan
    j, i = min(int(row), rows - 2), min(int(column), columns - 2)
    y, x = row - j, column - i
    upper = (1.0 - x) * max(plane[j, i], LOWEST_HU) + x * max(plane[j, i + 1], LOWEST_HU)
    lower = (1.0 - x) * max(plane[j + 1, i], LOWEST_HU) + x * max(plane[j + 1, i + 1], LOWEST_HU)
    return float((1.0 - y) * upper + y * lower)


@njit(cache=True, nogil=True, error_model="numpy")
def sample(
    voxels: Voxels,
    origins: FloatArray,
    w_mm: FloatArray,
    steps: FloatArray,
    u: float,
    v: float,
    w: float,
    guess: int,
) -> tuple[float, int]:
    """Return the value at (u, v, w) in HU, NaN outside, and the slice below it (a guess for the next call)."""
    k = slice_below(w_mm, w, guess)
    if k < 0:
        return np.nan, guess
    low = bilinear(voxels[k], (v - origins[k, 1]) / steps[1], (u - origins[k, 0]) / steps[0])
    high = bilinear(voxels[k + 1], (v - origins[k + 1, 1]) / steps[1], (u - origins[k + 1, 0]) / steps[0])
    share = (w - w_mm[k]) / (w_mm[k + 1] - w_mm[k])
    return (1.0 - share) * low + share * high, k


@njit(cache=True, nogil=True, error_model="numpy")
def way_out(
    voxels: Voxels,
    origins: FloatArray,
    w_mm: FloatArray,
    steps: FloatArray,
    inside: NDArray[np.bool_],
    cell: int,
    start: FloatArray,
    direction: FloatArray,
    values: FloatArray,
) -> tuple[int, float, float, float]:
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
        outer_mm = crossing(values, outer, BONE_HU) if outer > 0 else np.nan
        return 0, scalp, outer_mm, crossing(values, inner, BONE_HU) if inner > 0 else np.nan
    return 1, np.nan, np.nan, np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def search(
    voxels: Voxels,
    origins: FloatArray,
    w_mm: FloatArray,
    steps: FloatArray,
    inside: NDArray[np.bool_],
    cell: int,
    target: FloatArray,
    outward: FloatArray,
    field_mm: float,
    corner: FloatArray,
    distances: NDArray[np.float32],
    ball: FloatArray,
    numbers: FloatArray,
    states: NDArray[np.int64],
) -> None:
    """Fill ``numbers`` (M, 5) and ``states`` (M, 2) for rays ``outward`` (M, 3) along the slice axes."""
    values = np.empty(int(LONGEST_WAY_MM / STEP_MM))
    for m in range(len(outward)):
        direction = outward[m]
        how, scalp, outer, inner = way_out(voxels, origins, w_mm, steps, inside, cell, target, direction, values)
        states[m, 0] = how
        if how != 0:
            continue
        numbers[m, 0], numbers[m, 1], numbers[m, 2] = scalp, outer, inner
        if np.isnan(inner):
            continue
        numbers[m, 3] = _angle(voxels, origins, w_mm, steps, target + outer * direction, direction, ball)
        numbers[m, 4] = _least(field_mm, corner, distances, target, direction, scalp)
        states[m, 1] = 1
        for n in range(int(inner / STEP_MM)):
            if values[n] >= BONE_HU or values[n] < AIR_IN_HEAD_HU:
                states[m, 1] = 0
                break


@njit(cache=True, nogil=True, error_model="numpy")
def _angle(
    voxels: Voxels,
    origins: FloatArray,
    w_mm: FloatArray,
    steps: FloatArray,
    place: FloatArray,
    direction: FloatArray,
    ball: FloatArray,
) -> float:
    """Return the angle in degrees between ``direction`` and the mean gradient in a ball about ``place``.

    The first moment of the values over a ball points along the normal of a plane step, however sharp it is.
    """
    x = y = z = 0.0
    guess = 0
    for n in range(len(ball)):
        u, v, w = ball[n, 0], ball[n, 1], ball[n, 2]
        value, guess = sample(voxels, origins, w_mm, steps, place[0] + u, place[1] + v, place[2] + w, guess)
        if value > 0.0:
            x, y, z = x + value * u, y + value * v, z + value * w
    along = abs(x * direction[0] + y * direction[1] + z * direction[2])
    return float(np.degrees(np.arccos(min(along / np.sqrt(x * x + y * y + z * z), 1.0))))


@njit(cache=True, nogil=True, error_model="numpy")
def _least(
    field_mm: float,
    corner: FloatArray,
    distances: NDArray[np.float32],
    target: FloatArray,
    direction: FloatArray,
    length: float,
) -> float:
    """Return the least of the field along the ray; a distance cannot fall faster than the ray advances."""
    least, reach = np.inf, 0.0
    while reach <= length:
        x = (target[0] + reach * direction[0] - corner[0]) / field_mm
        y = (target[1] + reach * direction[1] - corner[1]) / field_mm
        z = (target[2] + reach * direction[2] - corner[2]) / field_mm
        here = _field_at(distances, x, y, z)
        least = min(least, here)
        reach += max(here - least, field_mm / 2)
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def _field_at(distances: NDArray[np.float32], x: float, y: float, z: float) -> float:
    """Return the distance at node coordinates, interpolated between the nodes; infinite outside."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    sx, sy, sz = distances.shape
    if not (0 <= i < sx - 1 and 0 <= j < sy - 1 and 0 <= k < sz - 1):
        return np.inf
    total = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = abs(1 - a - (x - i)) * abs(1 - b - (y - j)) * abs(1 - c - (z - k))
                if weight > 0.0:
                    total += weight * distances[i + a, j + b, k + c]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def exchange(
    centers: FloatArray, targets: FloatArray, chosen: IntArray, place: int, apart: float, scores: FloatArray
) -> None:
    """Fill ``scores`` (S,) with the largest error were marker ``place`` at each site that keeps its distance."""
    markers = np.empty((len(chosen), 3))
    for n in range(len(chosen)):
        for d in range(3):
            markers[n, d] = centers[chosen[n], d]
    for site in range(len(centers)):
        near = False
        for n in range(len(chosen)):
            if n != place and ((centers[chosen[n]] - centers[site]) ** 2).sum() < apart**2:
                near = True
                break
        if not near:
            for d in range(3):
                markers[place, d] = centers[site, d]
            scores[site] = largest(markers, targets)


@njit(cache=True, nogil=True, error_model="numpy")
def largest(markers: FloatArray, targets: FloatArray) -> float:
    """Return the largest squared error over targets (T, 3) of markers (M, 3), in sigma^2; infinite for a line."""
    count = len(markers)
    centroid = np.zeros(3)
    for n in range(count):
        centroid += markers[n] / count
    inertia = np.zeros((3, 3))
    for n in range(count):
        p = markers[n] - centroid
        square = (p * p).sum()
        for a in range(3):
            inertia[a, a] += square
            for b in range(3):
                inertia[a, b] -= p[a] * p[b]
    if np.linalg.det(inertia) <= 1e-9 * np.trace(inertia) ** 3:
        return np.inf
    inverse = np.linalg.inv(inertia)
    worst = 0.0
    for t in range(len(targets)):
        r = targets[t] - centroid
        # trace([r]x K^-1 [r]x') = r' (trace(K^-1) 1 - K^-1) r
        spread = np.trace(inverse) * (r * r).sum() - (r * (inverse @ r)).sum()
        worst = max(worst, 3.0 / count + spread)
    return worst
