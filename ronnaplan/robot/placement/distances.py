"""Distances between capsules' axes, upright boxes and points, compiled.

A box is a row: middle (3), half sides (3), cosine and sine of its turn about z. A capsule is a row: start (3), end (3),
radius. All distances are exact; inside a box it is zero.
"""

from __future__ import annotations

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray

Triple = tuple[float, float, float]
"""Of a vector within a loop: an array would be taken from the heap."""


@njit(cache=True, nogil=True, error_model="numpy")
def segment_point(segment: FloatArray, point: FloatArray) -> float:
    """Return the distance from a segment's (6+,) nearest place to ``point`` (3+,)."""
    along = square = 0.0
    for k in range(3):
        step = segment[3 + k] - segment[k]
        along += step * (point[k] - segment[k])
        square += step * step
    t = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
    total = 0.0
    for k in range(3):
        away = segment[k] + t * (segment[3 + k] - segment[k]) - point[k]
        total += away * away
    return float(np.sqrt(total))


@njit(cache=True, nogil=True, error_model="numpy")
def segment_segment(one: FloatArray, other: FloatArray) -> float:
    """Return the distance between two segments (6+,), each of any length, zero included."""
    a = b = e = c = f = 0.0
    for k in range(3):
        u, v, w = one[3 + k] - one[k], other[3 + k] - other[k], one[k] - other[k]
        a, e, b = a + u * u, e + v * v, b + u * v
        c, f = c + u * w, f + v * w
    s = 0.0
    if a > 0.0 and a * e - b * b > 1e-12 * a * e:
        s = min(max((b * f - c * e) / (a * e - b * b), 0.0), 1.0)
    t = (b * s + f) / e if e > 0.0 else 0.0
    if t < 0.0 or t > 1.0 or e == 0.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((b * t - c) / a, 0.0), 1.0) if a > 0.0 else 0.0
    total = 0.0
    for k in range(3):
        away = one[k] + s * (one[3 + k] - one[k]) - other[k] - t * (other[3 + k] - other[k])
        total += away * away
    return float(np.sqrt(total))


@njit(cache=True, nogil=True, error_model="numpy")
def _excess(x: float, half: float) -> float:
    return x - half if x > half else (x + half if x < -half else 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _slope(start: Triple, step: Triple, box: FloatArray, t: float) -> float:
    """Return half the derivative by t of the squared distance."""
    total = 0.0
    for k in range(3):
        total += step[k] * _excess(start[k] + t * step[k], box[3 + k])
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def segment_box(segment: FloatArray, box: FloatArray, enough: float) -> float:
    """Return the distance between a segment (6+,) and a box (8,), infinite where it is surely ``enough``.

    Along the segment the squared distance is convex and its derivative is linear between the places where a side of
    the box is passed; so the least one lies where the derivative crosses zero between two such places.
    """
    x, y = segment[0] - box[0], segment[1] - box[1]
    u, v = segment[3] - segment[0], segment[4] - segment[1]
    start = box[6] * x + box[7] * y, box[6] * y - box[7] * x, segment[2] - box[2]
    step = box[6] * u + box[7] * v, box[6] * v - box[7] * u, segment[5] - segment[2]
    square = 0.0  # of the distance from the box about the segment, which is no greater
    for k in range(3):
        aside = max(abs(start[k] + step[k] / 2) - abs(step[k] / 2) - box[3 + k], 0.0)
        square += aside * aside
    if square >= enough * enough:
        return np.inf
    low, high = 0.0, 1.0
    for k in range(3):
        for side in range(2):
            half = box[3 + k] if side == 0 else -box[3 + k]
            if step[k] != 0.0:
                t = (half - start[k]) / step[k]
                if low < t < high:
                    if _slope(start, step, box, t) < 0.0:
                        low = t
                    else:
                        high = t
    g_low, g_high = _slope(start, step, box, low), _slope(start, step, box, high)
    t = low if g_low >= 0.0 else (high if g_high <= 0.0 else low + (high - low) * g_low / (g_low - g_high))
    total = 0.0
    for k in range(3):
        away = _excess(start[k] + t * step[k], box[3 + k])
        total += away * away
    return float(np.sqrt(total))


@njit(cache=True, nogil=True, error_model="numpy")
def point_box(point: FloatArray, box: FloatArray) -> float:
    """Return the distance between ``point`` (3+,) and a box (8,)."""
    x, y = point[0] - box[0], point[1] - box[1]
    u = _excess(box[6] * x + box[7] * y, box[3])
    v = _excess(box[6] * y - box[7] * x, box[4])
    w = _excess(point[2] - box[2], box[5])
    return float(np.sqrt(u * u + v * v + w * w))


@njit(cache=True, nogil=True, error_model="numpy")
def box_box(one: FloatArray, other: FloatArray) -> float:
    """Return the distance between two upright boxes (8,)."""
    up = max(abs(one[2] - other[2]) - one[5] - other[5], 0.0)
    flat, edge, away = np.empty(8), np.empty(6), np.inf
    for turn in range(2):
        a, b = (one, other) if turn == 0 else (other, one)
        for n in range(8):
            flat[n] = b[n] if n != 2 else 0.0
        for side in range(4):
            for end in range(2):
                corner = (side + end) % 4
                x = a[3] if corner in (0, 3) else -a[3]
                y = a[4] if corner in (0, 1) else -a[4]
                edge[3 * end] = a[0] + a[6] * x - a[7] * y
                edge[3 * end + 1] = a[1] + a[7] * x + a[6] * y
                edge[3 * end + 2] = 0.0
            away = min(away, segment_box(edge, flat, away))
    return float(np.hypot(away, up))
