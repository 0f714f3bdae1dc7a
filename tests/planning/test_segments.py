"""Least distances equal a brute-force search over finely sampled paths, however the paths are moved."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from ronnaplan.planning.segments import box_distance, point_distances, segment_distances

seeds = st.integers(0, 2**32 - 1)


@given(seeds)
@settings(max_examples=40)
def test_segments_as_an_optimizer_finds_them(seed: int) -> None:
    p, q, r, s = np.random.default_rng(seed).uniform(-50, 50, (4, 3))

    def squared(x: np.ndarray) -> float:
        return float((((p + x[0] * (q - p)) - (r + x[1] * (s - r))) ** 2).sum())

    starts = [(0.0, 0.0), (1.0, 1.0), (0.5, 0.5)]
    best = min(
        minimize(squared, start, bounds=[(0, 1), (0, 1)], method="L-BFGS-B", tol=1e-14).fun for start in starts
    )
    distance, share = segment_distances(p, q, r, s)
    assert abs(float(distance) - np.sqrt(best)) < 1e-3
    on_path = p + float(share) * (q - p)
    assert abs(float(point_distances(on_path, r, s)) - float(distance)) < 1e-9


@given(seeds)
@settings(max_examples=30)
def test_moving_both_segments_changes_nothing(seed: int) -> None:
    generator = np.random.default_rng(seed)
    ends = generator.uniform(-50, 50, (4, 3))
    turn, shift = Rotation.random(rng=generator).as_matrix(), generator.uniform(-100, 100, 3)
    moved = ends @ turn.T + shift
    assert np.isclose(segment_distances(*ends)[0], segment_distances(*moved)[0], atol=1e-9)
    assert np.isclose(segment_distances(*ends)[0], segment_distances(ends[1], ends[0], ends[3], ends[2])[0])


def test_parallel_touching_and_crossing_segments() -> None:
    a, b = np.array([0.0, 0, 0]), np.array([10.0, 0, 0])
    assert segment_distances(a, b, a + np.array([2, 3, 0]), b + np.array([2, 3, 0]))[0] == 3.0
    assert segment_distances(a, b, b, b + np.array([0, 5, 0]))[0] == 0.0
    assert segment_distances(a, b, np.array([5.0, -5, 0]), np.array([5.0, 5, 0]))[0] == 0.0


@given(seeds)
@settings(max_examples=40)
def test_boxes_as_sampling_finds_them(seed: int) -> None:
    generator = np.random.default_rng(seed)
    start, stop = generator.uniform(-30, 30, (2, 3))
    low = generator.uniform(-20, 20, (8, 3))
    high = low + generator.uniform(0.2, 4.0, (8, 3))
    points = start + np.linspace(0, 1, 4001)[:, None] * (stop - start)
    outside = np.maximum(np.maximum(low[:, None] - points, points - high[:, None]), 0.0)
    distance, _ = box_distance(start, stop, low, high)
    assert abs(distance - np.linalg.norm(outside, axis=-1).min()) < 0.02
