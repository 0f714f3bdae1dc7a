import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

from ronnaplan.correspondence import describe_layout, match_points
from ronnaplan.correspondence.evidence import FEW_PAIRS, MOST_ODDS_IF_LARGER, SCALE_PRIORS, SCALES
from ronnaplan.correspondence.layout import (
    LOWEST_SIGMAS,
    MIRROR_REACH_MM,
    QUADRATURE_STEPS,
    Layout,
    mirror_distance,
)
from ronnaplan.errors import InputError, RonnaplanError
from tests.correspondence.scenes import HEAD, SIGMA_CT, SIGMA_OTS
from tests.long import few_and_others, few_or_all


@few_and_others("seed", range(4), range(4, 12))
def test_the_nearest_rival_is_that_of_trying_every_order(seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(3 + seed % 4, 3)) * 50
    centered = points - points.mean(axis=0)
    orders = list(itertools.permutations(range(len(points))))[1:]
    least = min(Rotation.align_vectors(centered[list(order)], centered)[1] for order in orders)
    layout = describe_layout(points)
    assert layout.rival_distance_mm == pytest.approx(least, rel=1e-6)
    assert Rotation.align_vectors(centered[layout.rival], centered)[1] == pytest.approx(least, rel=1e-6)


@pytest.mark.parametrize(
    "points",
    [
        np.array([[0, 0, 0], [100, 0, 0], [50, 50 * 3**0.5, 0]]),
        np.array([[0, 0, 0], [80, 0, 0], [80, 80, 0], [0, 80, 0.0]]),
        np.array([[0, 0, 0], [90, 40, 0], [90, -40, 0], [130, 0, 0.0]]),
        np.vstack((HEAD[:4], HEAD[:1])),
    ],
    ids=["equilateral triangle", "square", "flat mirror-symmetric", "two at one place"],
)
def test_symmetric_layouts_have_a_rival_at_no_distance(points: np.ndarray) -> None:
    layout = describe_layout(points)
    assert layout.rival_distance_mm == pytest.approx(0.0, abs=1e-4)
    assert layout.refusal_probability() > 0.99


def test_a_layout_with_a_mirror_plane_but_no_rotation_is_distinguishable() -> None:
    points = np.array([[0, 0, 0], [90, 40, 0], [90, -40, 0], [130, 0, 60.0], [60, 0, 90.0]])
    assert describe_layout(points).rival_distance_mm > 20.0


@few_and_others("seed", range(4), range(4, 12))
def test_the_mirror_distance_is_that_of_trying_every_order(seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(3 + seed % 4, 3)) * [20, 20, 4]
    centered = points - points.mean(axis=0)
    mirrored = centered * [-1, 1, 1]
    orders = itertools.permutations(range(len(points)))
    least = min(Rotation.align_vectors(mirrored[list(order)], centered)[1] for order in orders)
    assert describe_layout(points).mirror_distance_mm == pytest.approx(
        min(least, MIRROR_REACH_MM), rel=1e-6, abs=1e-5
    )


@pytest.mark.parametrize("pairs", [3, 8, 16])
def test_a_layout_alike_on_the_left_and_right_is_its_own_mirror_image_until_a_marker_is_set_apart(
    pairs: int,
) -> None:
    half = np.random.default_rng(pairs).uniform(20.0, 90.0, (pairs, 3))
    points = np.concatenate([half, half * [-1, 1, 1]])
    assert describe_layout(points).mirror_distance_mm == pytest.approx(0.0, abs=1e-4)
    assert len(match_points(points, points * [1, 1, -1])) == 2 * pairs  # nothing tells
    points[0, 2] += 15.0
    assert describe_layout(points).mirror_distance_mm > 6.0
    assert "left-handed" in match_points(points, points * [1, 1, -1]).reason


def test_a_layout_that_equals_its_mirror_image_has_a_mirrored_rival_at_zero() -> None:
    kite = np.array([[-30.0, 0, 0], [30.0, 0, 0], [0.0, 50, 0], [0.0, -20, 10]])
    assert mirror_distance(kite) == pytest.approx(0.0, abs=1e-5)
    assert describe_layout(kite).rival_distance_mm > 1.0


def test_a_collinear_layout_is_always_refused() -> None:
    layout = describe_layout(np.outer([0.0, 30.0, 80.0, 170.0], [0, 0, 1]))
    assert layout.line_distance_mm == pytest.approx(0.0, abs=1e-6)
    assert layout.refusal_probability() == 1.0


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"sigma_ct_mm": float("nan")}, "CT error is nan mm"),
        ({"sigma_ct_mm": -1.0, "sigma_ots_mm": -1.0}, "CT error is -1.0 mm"),  # was refused never
        ({"sigma_ots_mm": float("inf")}, "tracker error is inf mm"),
        ({"sigma_ots_mm": "large"}, "str is given for the tracker error"),
        ({"sigma_ots_mm": np.ones(4)}, "ndarray is given for the tracker error"),
        ({"least_probability": 2.0}, "least_probability is 2.0"),
        ({"least_probability": 0.3}, "least_probability is 0.3"),
    ],
)
def test_how_often_a_layout_is_refused_is_told_of_errors_that_matching_takes(wrong: Any, says: str) -> None:
    with pytest.raises(RonnaplanError, match=says):
        describe_layout(HEAD).refusal_probability(**wrong)


def test_markers_without_errors_are_never_refused_unless_they_are_alike() -> None:
    assert describe_layout(HEAD).refusal_probability(0.0, 0.0) == 0.0
    assert describe_layout(np.vstack((HEAD[:4], HEAD[:1]))).refusal_probability(0.0, 0.0) > 0.99


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), scale=st.floats(0.5, 3.0))
def test_the_rival_distance_follows_scale_and_ignores_pose_and_order(seed: int, scale: Any) -> None:
    rng = np.random.default_rng(seed)
    points = 50 * rng.normal(size=(5, 3))
    moved = scale * Rotation.from_quat(rng.normal(size=4)).apply(points[rng.permutation(5)]) + 40.0
    expected_mm = scale * describe_layout(points).rival_distance_mm
    assert describe_layout(moved).rival_distance_mm == pytest.approx(expected_mm, rel=1e-5, abs=1e-4)


@few_or_all("cases", 300, 600)
@few_and_others("difference", [2.0], [4.0])
def test_the_refusal_probability_is_what_simulation_finds(difference: Any, cases: int) -> None:
    triangle = np.array([[-40.0, 0, 0], [40, 0, 0], [0.5 * difference, 90, 0]])
    rng = np.random.default_rng(6)
    refused = 0
    for _ in range(cases):
        ct, ots = (triangle + sigma * rng.normal(size=(3, 3)) for sigma in (SIGMA_CT, SIGMA_OTS))
        refused += match_points(ct, ots, expected=3).status != "unique"
    assert refused / cases == pytest.approx(describe_layout(triangle).refusal_probability(), abs=0.08)


@few_and_others("away_mm", [5.0], [3.5, 6.0])
def test_the_refusal_probability_of_regular_markers_is_what_simulation_finds(away_mm: float) -> None:
    """Six markers about an axis, as an even spread has them, were said to be refused in 3 % at 3.4 mm; 95 % were."""
    even = np.array([[0, 0, 0], [60, 0, 0], [60, 60, 0], [0, 60, 0], [30, 30, 40], [30, 30, 90.0]])
    rng = np.random.default_rng(8)
    off = rng.normal(size=even.shape)
    markers = even + off * away_mm / describe_layout(even + off).rival_distance_mm
    layout = describe_layout(markers)
    assert layout.rival_distance_mm == pytest.approx(away_mm, rel=0.1)
    refused = 0
    for _ in range(500):
        ct, ots = (markers + sigma * rng.normal(size=(6, 3)) for sigma in (SIGMA_CT, SIGMA_OTS))
        refused += match_points(ct, ots, expected=6).status != "unique"
    assert refused / 500 == pytest.approx(layout.refusal_probability(), abs=0.12)


@pytest.mark.parametrize("markers", [3, 6, 32])
def test_a_rival_too_far_to_be_looked_at_would_refuse_nothing(markers: int) -> None:
    least = 0.99
    odds = min((1.0 - least) / least, SCALE_PRIORS[-1] * MOST_ODDS_IF_LARGER if markers <= FEW_PAIRS else 1.0)
    far = math.sqrt(-2.0 * max(SCALES) ** 2 * math.log(odds) + LOWEST_SIGMAS**2) + LOWEST_SIGMAS
    sigma_mm = math.hypot(SIGMA_CT, SIGMA_OTS)
    nearer = Layout(0.999 * far * sigma_mm, np.arange(markers), 50.0, 20.0)
    assert nearer.refusal_probability(SIGMA_CT, SIGMA_OTS, least) == 0.0
    assert -ndtri(0.5 / QUADRATURE_STEPS) < LOWEST_SIGMAS


def test_a_point_cloud_is_no_layout() -> None:
    with pytest.raises(InputError, match="at most 32"):
        describe_layout(np.random.default_rng(0).normal(size=(33, 3)) * 50)
