"""Least distances of straight paths: to each other, to points, to boxes. All exact, all in mm."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray

SEARCH_STEPS = 40
"""Halvings of the convex search along a path; leaves less than a nanometre of a head's width."""


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


def box_distance(start: FloatArray, stop: FloatArray, low: FloatArray, high: FloatArray) -> tuple[float, float]:
    """Return the least distance of a segment to any of the boxes ``low``..``high`` (N, 3), and the share there.

    The distance to a box is convex along the segment: its slope is zero at the least.
    """
    half, middle = (high - low) / 2, (high + low) / 2
    distances = point_distances(middle, start, stop)
    # No box is further than its own middle, so what begins beyond the nearest middle need not be looked at.
    near = distances - np.linalg.norm(half, axis=1) <= distances.min()
    half, middle, span = half[near], middle[near], stop - start
    left, right = np.zeros((len(half), 1)), np.ones((len(half), 1))
    for _ in range(SEARCH_STEPS):
        share = (left + right) / 2
        beyond = (_outside(start + share * span, middle, half) @ span >= 0)[:, np.newaxis]
        left, right = np.where(beyond, left, share), np.where(beyond, share, right)
    distances = np.linalg.norm(_outside(start + right * span, middle, half), axis=1)
    best = int(distances.argmin())
    return float(distances[best]), float(right[best, 0])


def _outside(points: FloatArray, middle: FloatArray, half: FloatArray) -> FloatArray:
    """Return the vectors (N, 3) from each box to its point, zero inside."""
    offset = points - middle
    vectors: FloatArray = offset - np.clip(offset, -half, half)
    return vectors
