from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.correspondence import match_points
from tests.correspondence.scenes import ball, scene


def cloud(seed: int, markers: int, outliers: int, radius: float = 300.0) -> Any:
    layout = ball(np.random.default_rng(1000 + seed), markers, radius)
    return scene(seed, markers, outliers, layout=layout, radius=radius)


@pytest.mark.parametrize(
    ("markers", "outliers", "radius"), [(20, 20, 300.0), (100, 100, 300.0), (100, 100, 100.0)]
)
def test_clouds_with_half_outliers_are_paired(markers: int, outliers: int, radius: float) -> None:
    for seed in range(10):
        ct, ots, partner = cloud(seed, markers, outliers, radius)
        pairing = match_points(ct, ots)
        assert pairing.status == "unique", (seed, pairing.reason)
        assert (partner[pairing.pairs[:, 0]] == pairing.pairs[:, 1]).all()
        assert len(pairing.pairs) >= 0.85 * markers


def test_a_thousand_points_are_paired() -> None:
    ct, ots, partner = cloud(0, 500, 500)
    pairing = match_points(ct, ots)
    assert pairing.status == "unique"
    assert (partner[pairing.pairs[:, 0]] == pairing.pairs[:, 1]).all()
    assert len(pairing.pairs) >= 475


def test_the_answer_repeats_itself() -> None:
    ct, ots, _ = cloud(1, 40, 40)
    assert np.array_equal(match_points(ct, ots).pairs, match_points(ct, ots).pairs)


def test_clouds_that_share_nothing_are_unmatched() -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        assert match_points(ball(rng, 80, 200.0), ball(rng, 80, 200.0)).status == "unmatched"


def test_a_mirror_image_is_refused_even_where_a_flat_part_of_it_fits() -> None:
    for seed in range(5):
        points = ball(np.random.default_rng(seed), 60, 150.0)
        points[:15, 2] = 0.0
        pairing = match_points(points * [1, 1, -1], points)
        assert pairing.status != "unique", seed
        assert "left-handed" in pairing.reason or pairing.status == "ambiguous"


def test_a_lattice_is_ambiguous() -> None:
    axis = 30.0 * np.arange(6)
    lattice = np.array(np.meshgrid(axis, axis, axis)).reshape(3, -1).T
    turned = Rotation.from_rotvec([0.3, 0.2, 0.1]).apply(lattice)
    pairing = match_points(lattice, turned)
    assert pairing.status == "ambiguous"
    assert len(pairing.pairs) == 0


def test_two_points_at_one_place_are_doubtful_and_the_rest_is_given() -> None:
    points = ball(np.random.default_rng(3), 50, 200.0)
    points[7] = points[8]
    pairing = match_points(points, points)
    assert pairing.status == "unique"
    assert not set(pairing.pairs[:, 0].tolist()) & {7, 8}
    assert {7, 8} >= set(pairing.doubtful[:, 0].tolist())
    assert len(pairing.pairs) == 48


def test_another_number_than_expected_is_refused() -> None:
    ct, ots, _ = cloud(4, 40, 20)
    pairing = match_points(ct, ots, expected=50)
    assert pairing.status == "unmatched"
    assert "50 are expected" in pairing.reason


def test_known_pairs_are_honoured() -> None:
    ct, ots, partner = cloud(5, 40, 20)
    assert match_points(ct, ots, known_pairs=[(0, int(partner[0]))]).status == "unique"
    assert match_points(ct, ots, known_pairs=[(0, int(partner[1]))]).status == "unmatched"
