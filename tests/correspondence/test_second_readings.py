"""Markers that one set holds twice: a second reading is no other order, and no second body."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.correspondence import match_points
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.geometry import FloatArray
from tests.correspondence.scenes import HEAD, SIGMA_CT, SIGMA_OTS, ball


def read_twice(
    seed: int, markers: int, ct_twice: int, ots_twice: int, apart_mm: float = 2.0
) -> tuple[FloatArray, FloatArray, IntArray]:
    """CT points, OTS points, and the true partners of the markers, which come first; others are second readings."""
    rng = np.random.default_rng(seed)
    points = HEAD[:markers]
    seconds = [
        points[rng.permutation(markers)[:count]] + apart_mm * _directions(rng, count)
        for count in (ct_twice, ots_twice)
    ]
    ct, ots = (
        true + sigma * rng.normal(size=true.shape)
        for true, sigma in (
            (np.vstack((points, seconds[0])), SIGMA_CT),
            (np.vstack((points, seconds[1])), SIGMA_OTS),
        )
    )
    order = rng.permutation(len(ots))
    return ct, Rotation.random(rng=rng).apply(ots[order]) + 400.0, np.argsort(order)[:markers]


def _directions(rng: np.random.Generator, count: int) -> FloatArray:
    directions = ball(rng, count, 1.0)
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))


@pytest.mark.parametrize(("markers", "twice"), [(7, 3), (8, 3), (8, 4)])
def test_markers_that_the_tracker_reads_twice_are_paired_by_the_others(markers: int, twice: int) -> None:
    """They were refused as laid out regularly, or as two bodies."""
    for seed in range(10):
        ct, ots, partner = read_twice(seed, markers, 0, twice)
        found = match_points(ct, ots)
        assert found.status == "unique", found.reason
        assert len(found.pairs) >= markers - twice
        assert np.array_equal(found.pairs[:, 1], partner[found.pairs[:, 0]])


def test_markers_that_the_scan_shows_twice_are_paired_alike() -> None:
    for seed in range(10):
        ct, ots, _ = read_twice(seed, 7, 0, 3)
        found, swapped = match_points(ct, ots), match_points(ots, ct, sigma_ct_mm=SIGMA_OTS, sigma_ots_mm=SIGMA_CT)
        assert swapped.status == "unique", swapped.reason
        assert np.array_equal(found.swapped().pairs, swapped.pairs)


def test_one_marker_that_each_set_holds_twice_is_no_second_body() -> None:
    for seed in range(10):
        found = match_points(*read_twice(seed, 6, 1, 1)[:2])
        assert found.status == "unique", found.reason


def test_second_readings_of_both_sets_which_may_pair_with_each_other_are_refused_and_told() -> None:
    refused = [match_points(*read_twice(seed, 6, 3, 3)[:2]) for seed in range(10)]
    assert all(found.status == "ambiguous" for found in refused)
    assert any("if one marker was read twice, leave one out" in found.reason for found in refused)
