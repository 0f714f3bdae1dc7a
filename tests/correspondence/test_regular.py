"""Markers that are laid out regularly pair in several ways, and are refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.correspondence import match_points
from ronnaplan.correspondence.chance import Claims
from ronnaplan.geometry import FloatArray
from tests.correspondence.scenes import SIGMA_CT, SIGMA_OTS
from tests.long import few_and_others


def test_a_lattice_is_ambiguous() -> None:
    axis = 30.0 * np.arange(6)
    lattice = np.array(np.meshgrid(axis, axis, axis)).reshape(3, -1).T
    turned = Rotation.from_rotvec([0.3, 0.2, 0.1]).apply(lattice)
    pairing = match_points(lattice, turned)
    assert pairing.status == "ambiguous"
    assert len(pairing.pairs) == 0


REGULAR = {
    "lattice": np.array(np.meshgrid(*[20.0 * np.arange(3)] * 2, 20.0 * np.arange(4))).reshape(3, -1).T[:32],
    "circle": 80.0
    * np.column_stack((np.cos(np.arange(32) * np.pi / 16), np.sin(np.arange(32) * np.pi / 16), np.zeros(32))),
    "small circle": 80.0
    * np.column_stack((np.cos(np.arange(12) * np.pi / 6), np.sin(np.arange(12) * np.pi / 6), np.zeros(12))),
}


@pytest.mark.parametrize("name", REGULAR)
def test_a_regular_set_is_ambiguous(name: str) -> None:
    pairing = match_points(REGULAR[name], REGULAR[name] + 3.0)
    assert pairing.status == "ambiguous"
    assert pairing.reason


@pytest.mark.parametrize(("rows", "columns"), [(5, 6), (10, 10)])
def test_of_a_plate_of_holes_it_is_said_that_they_are_regular(rows: int, columns: int) -> None:
    """Of more than 16 only the probability was told."""
    rng = np.random.default_rng(0)
    holes = 15.0 * np.array([[i, j, 0.0] for i in range(rows) for j in range(columns)])
    ct, ots = (holes + sigma * rng.normal(size=holes.shape) for sigma in (0.1, SIGMA_OTS))
    assert "laid out regularly" in match_points(ct, ots, sigma_ct_mm=0.1).reason


def test_which_points_each_pose_of_a_regular_set_pairs_is_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was told three times, which took half of the time: 32 markers and fewer took more than 20 ms."""
    told: list[bytes] = []
    of_points = Claims.point_probabilities

    def noted(claims: Claims, other: Claims | None = None) -> FloatArray:
        if other is None:
            told.append(claims.odds.tobytes())
        return of_points(claims, other)

    monkeypatch.setattr(Claims, "point_probabilities", noted)
    assert match_points(REGULAR["lattice"], REGULAR["lattice"] + 3.0).status == "ambiguous"
    assert len(told) == len(set(told)) > 10


def circle(count: int, radius: float) -> FloatArray:
    angles = np.arange(count) * 2.0 * np.pi / count
    return radius * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])


def with_a_half_turn(count: int) -> FloatArray:
    half = np.random.default_rng(count).normal(size=(count // 2, 3)) * 45.0
    return np.vstack([half, half * np.array([-1.0, -1.0, 1.0])])


@few_and_others(
    "points",
    [with_a_half_turn(10), with_a_half_turn(40), circle(100, 90.0)],
    [with_a_half_turn(12), circle(200, 80.0)],
    ids=["10 twofold", "40 twofold", "circle of 100", "12 twofold", "dense circle of 200"],
)
def test_regular_markers_are_refused_however_the_noise_falls(points: FloatArray) -> None:
    for seed in range(40 if len(points) < 20 else 4):
        rng = np.random.default_rng(seed)
        ct = points + SIGMA_CT * rng.normal(size=points.shape)
        ots = Rotation.random(rng=rng).apply(points + SIGMA_OTS * rng.normal(size=points.shape)) + 30.0
        found = match_points(ct, rng.permutation(ots))
        assert found.status == "ambiguous", found.reason


@pytest.mark.parametrize("count", [28, 40])
def test_regular_markers_are_refused_when_errors_are_larger_than_stated(count: int) -> None:
    """With the reach of errors as stated, one order lost more pairs than the other by chance and one was accepted."""
    points = with_a_half_turn(count)
    for seed in range(12):
        rng = np.random.default_rng([99, seed, count])
        noise = float(rng.uniform(2.0, 4.0))
        ct = points + noise * SIGMA_CT * rng.normal(size=points.shape)
        ots = Rotation.random(rng=rng).apply(points + noise * SIGMA_OTS * rng.normal(size=points.shape)) + 30.0
        assert match_points(ct, rng.permutation(ots)).status == "ambiguous", seed
