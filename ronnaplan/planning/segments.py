"""Least distances of straight paths: to each other, to points, to boxes. All exact, all in mm."""

from __future__ import annotations

import numpy as np
from numba import njit

from ronnaplan.geometry import FloatArray

SEARCH_STEPS = 60
"""Ternary steps of the convex search along a path; leaves less than a nanometre of a head's width."""


def along_segments(points: FloatArray, starts: FloatArray, stops: FloatArray) -> FloatArray:
    """Return the share (...) in 0..1 of each segment at which it is nearest to its point; all (..., 3)."""
    spans = stops - starts
    squares = (spans**2).sum(axis=-1)
    shares = ((points - starts) * spans).sum(axis=-1) / np.where(squares > 0, squares, 1.0)
    clipped: FloatArray = np.clip(shares, 0.0, 1.0)
    return clipped


def point_distances(points: FloatArray, starts: FloatArray, stops: FloatArray) -> FloatArray:
    """Return the distance (...) of each point (..., 3) to its segment."""
    nearest = starts + along_segments(points, starts, stops)[..., np.newaxis] * (stops - starts)
    distances: FloatArray = np.linalg.norm(points - nearest, axis=-1)
    return distances


def segment_distances(
    starts: FloatArray, stops: FloatArray, other_starts: FloatArray, other_stops: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the least distance (...) of pairs of segments, and the share (...) of the first at which it occurs.

    The least is at an end of one of the two, or where the lines' common perpendicular meets both.
    """
    starts, stops, other_starts, other_stops = np.broadcast_arrays(starts, stops, other_starts, other_stops)
    on_first = [along_segments(end, starts, stops) for end in (other_starts, other_stops)]
    shares = [*on_first, np.zeros(starts.shape[:-1]), np.ones(starts.shape[:-1])]
    distances = [point_distances(end, starts, stops) for end in (other_starts, other_stops)]
    distances += [point_distances(end, other_starts, other_stops) for end in (starts, stops)]
    u, v, w = stops - starts, other_stops - other_starts, other_starts - starts
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    determinant = uu * vv - uv**2
    skew = determinant > 1e-12 * uu * vv
    safe = np.where(skew, determinant, 1.0)
    s, t = (uw * vv - uv * vw) / safe, (uw * uv - uu * vw) / safe
    meets = skew & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    gap = np.linalg.norm(w + t[..., None] * v - s[..., None] * u, axis=-1)
    shares.append(np.where(meets, s, 0.0))
    distances.append(np.where(meets, gap, np.inf))
    best = np.argmin(distances, axis=0)
    return (
        np.take_along_axis(np.stack(distances), best[None], axis=0)[0],
        np.take_along_axis(np.stack(shares), best[None], axis=0)[0],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def box_distance(start, stop, low, high):  # type: ignore[no-untyped-def]
    """Return the least distance of a segment to any of the boxes ``low``..``high`` (N, 3), and the share there."""
    best, best_share = np.inf, 0.0
    span = stop - start
    square = (span**2).sum()
    for n in range(len(low)):
        half, middle = (high[n] - low[n]) / 2, (high[n] + low[n]) / 2
        share = min(max(((middle - start) * span).sum() / square, 0.0), 1.0)
        nearest = np.sqrt(((middle - start - share * span) ** 2).sum())
        if nearest - np.sqrt((half**2).sum()) >= best:
            continue
        left, right = 0.0, 1.0
        for _ in range(SEARCH_STEPS):
            a, b = left + (right - left) / 3, right - (right - left) / 3
            if _outside(start, span, a, low[n], high[n]) <= _outside(start, span, b, low[n], high[n]):
                right = b
            else:
                left = a
        share = (left + right) / 2
        distance = np.sqrt(_outside(start, span, share, low[n], high[n]))
        if distance < best:
            best, best_share = distance, share
    return best, best_share


@njit(cache=True, nogil=True, error_model="numpy")
def _outside(start, span, share, low, high):  # type: ignore[no-untyped-def]
    """Squared distance of the point at ``share`` to a box; convex in ``share``."""
    total = 0.0
    for axis in range(3):
        x = start[axis] + share * span[axis]
        out = max(low[axis] - x, x - high[axis], 0.0)
        total += out * out
    return total
