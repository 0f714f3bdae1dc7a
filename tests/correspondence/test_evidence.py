from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from ronnaplan.correspondence.anisotropic import fit_anisotropic
from ronnaplan.correspondence.evidence import (
    FEW_PAIRS,
    GATE_CHI2,
    LOOSE_CHI2,
    SCALE_PRIORS,
    SCALES,
    filled_volume,
    fit,
    largest_overlap,
    log_misfit,
)
from ronnaplan.correspondence.priors import log_pairings, tail_beyond_gate
from tests.correspondence.scenes import HEAD, SIGMA_CT, SIGMA_OTS, ball


@settings(max_examples=100)
@given(seed=st.integers(0, 10**6), count=st.integers(3, 12), flat=st.booleans())
def test_chi2_is_that_of_the_best_proper_rotation(seed: int, count: int, flat: Any) -> None:
    rng = np.random.default_rng(seed)
    x, y = (60 * rng.normal(size=(count, 3)) for _ in range(2))
    if flat:
        x[:, 2] = 0.0
    weight = rng.uniform(0.5, 3.0, (count, count))
    index = np.arange(count)
    w = weight[index, index]
    x0, y0 = (np.average(points, axis=0, weights=w) for points in (x, y))
    rssd = Rotation.align_vectors(y - y0, x - x0, weights=w)[1]
    assert fit(x, y, weight, index, index, count, 60.0)[0] == pytest.approx(rssd**2, rel=1e-6, abs=1e-6)


def test_a_mirror_image_is_not_fitted() -> None:
    weight, index = np.ones((8, 8)), np.arange(8)
    assert fit(HEAD, HEAD, weight, index, index, 8, 60.0)[0] == pytest.approx(0.0, abs=1e-7)
    assert fit(HEAD, HEAD * [1, 1, -1], weight, index, index, 8, 60.0)[0] > 1000.0


def test_the_largest_overlap_of_a_reflection_is_that_of_a_rotation() -> None:
    assert largest_overlap(np.diag([3.0, 2.0, -1.0]), 6.0) == pytest.approx(4.0)


def test_adding_a_pair_never_lowers_chi2_nor_raises_the_volume() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        x = 60 * rng.normal(size=(8, 3))
        y = x + rng.normal(size=(8, 3))
        weight, index = rng.uniform(0.5, 3, (8, 8)), np.arange(8)
        values = np.array([fit(x, y, weight, index, index, k, 60.0) for k in range(3, 9)])
        assert (np.diff(values[:, 0]) > -1e-9).all()
        assert (np.diff(values[:, 1]) < 1e-9).all()


def test_evidence_is_the_integral_over_all_poses() -> None:
    """Laplace's approximation against Monte Carlo integration over rotations and shifts near the best pose."""
    rng = np.random.default_rng(2)
    x = HEAD[:4]
    c = 0.34
    y = x + np.sqrt(c) * rng.normal(size=x.shape)
    weight, index = np.full((4, 4), 1 / c), np.arange(4)
    chi2, volume = fit(x, y, weight, index, index, 4, 1e9)
    laplace = 3 * np.log(2 * np.pi) + volume - 0.5 * chi2
    best = Rotation.align_vectors(y - y.mean(axis=0), x - x.mean(axis=0))[0]
    widths = np.repeat([0.008, 0.4], 3)
    drawn = widths * rng.normal(size=(400_000, 6))
    density = np.exp(-0.5 * ((drawn / widths) ** 2).sum(axis=1)) / np.prod(widths) / (2 * np.pi) ** 3
    turns, shifts = drawn[:, :3], drawn[:, 3:]
    moved = Rotation.from_rotvec(turns).as_matrix() @ best.apply(x - x.mean(axis=0)).T
    residual = (y - y.mean(axis=0)).T[None] - moved - shifts[:, :, None]
    angle = np.linalg.norm(turns, axis=1)
    haar = (2 * np.sin(angle / 2) / angle) ** 2
    inside = haar * np.exp(-0.5 * (residual**2).sum(axis=(1, 2)) / c)
    assert np.log((inside / density).mean()) == pytest.approx(laplace, abs=0.05)


def test_a_false_pairing_has_evidence_of_at_most_one_on_average() -> None:
    """The remainder rests on it; it is below 1, as poses that move points out of the field are counted."""
    rng = np.random.default_rng(3)
    radius, sigma, tests = 20.0, 3.0, 60_000
    volume = 4 / 3 * np.pi * radius**3
    weight, index = np.full((3, 3), 1 / sigma**2), np.arange(3)
    x, y = ball(rng, 3 * tests, radius).reshape(-1, 3, 3), ball(rng, 3 * tests, radius).reshape(-1, 3, 3)
    total = 0.0
    for one, two in zip(x, y, strict=True):
        chi2, log_volume = fit(one, two, weight, index, index, 3, 1e9)
        total += np.exp(log_volume - 0.5 * chi2)
    constant = volume**2 / (8 * np.pi**2) * (2 * np.pi) ** -1.5 * sigma**-9
    assert 0.05 < total / tests * constant < 1.0


def test_the_scale_of_the_errors_is_integrated_out() -> None:
    for size, chi2 in ((3, 4.0), (8, 60.0), (5, 900.0)):
        weights = zip(SCALE_PRIORS, SCALES, strict=True)
        expected = sum(w * s ** (6 - 3 * size) * np.exp(-chi2 / 2 / s**2) for w, s in weights)
        assert log_misfit(chi2, size) == pytest.approx(np.log(expected))


@pytest.mark.parametrize(("size", "tests"), [(3, 200_000), (8, 10_000)])
def test_the_tail_beyond_the_gate_is_what_the_search_leaves_out(size: int, tests: int) -> None:
    """A true pairing is left out where two of its pairs differ too much in distance; of three, the bound is close."""
    rng, a, b = np.random.default_rng(6), *np.triu_indices(size, 1)
    left_out = 0.0
    for share, scale in zip(SCALE_PRIORS, SCALES, strict=True):
        if scale > 1.0:
            read = (HEAD[:size] + scale * s * rng.normal(size=(tests, size, 3)) for s in (SIGMA_CT, SIGMA_OTS))
            ct, ots = (np.linalg.norm(points[:, a] - points[:, b], axis=2) for points in read)
            beyond = (ct - ots) ** 2 > GATE_CHI2 * 2.0 * (SIGMA_CT**2 + SIGMA_OTS**2)
            left_out += share * beyond.any(axis=1).mean()
    sampling = np.sqrt(SCALE_PRIORS[-1] * left_out / tests)
    assert left_out < tail_beyond_gate(size) + 3.0 * sampling
    assert size > FEW_PAIRS or left_out > 0.7 * tail_beyond_gate(size)


def test_of_more_than_three_pairs_the_tail_of_the_whole_chi2_is_left_to_chance() -> None:
    weights = zip(SCALE_PRIORS, SCALES, strict=True)
    expected = sum(w * chdtrc(18, LOOSE_CHI2 / s**2) for w, s in weights)
    assert tail_beyond_gate(8) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("n", "m", "size", "known", "count"), [(3, 3, 3, 0, 6), (4, 5, 3, 0, 240), (4, 4, 4, 2, 2)]
)
def test_pairings_are_counted(n: Any, m: Any, size: Any, known: Any, count: int) -> None:
    assert np.exp(log_pairings(n, m, size, known)) == pytest.approx(count)


def test_a_uniform_ball_fills_its_own_volume() -> None:
    points = ball(np.random.default_rng(4), 20_000, 300.0)
    assert filled_volume(points, points) == pytest.approx(4 / 3 * np.pi * 300.0**3, rel=0.02)


def test_the_anisotropic_fit_is_the_maximum_of_the_likelihood() -> None:
    from scipy.optimize import minimize

    rng = np.random.default_rng(5)
    covariances = np.array([np.diag(rng.uniform(0.05, 4.0, 3)) for _ in range(10)])
    x, turn = HEAD[:5], Rotation.from_rotvec([0.4, -1.0, 0.3])
    y = turn.apply(x) + rng.normal(size=x.shape)

    def chi2(pose: np.ndarray) -> float:
        rotation = Rotation.from_rotvec(pose[:3]) * turn
        residual = y - rotation.apply(x) - pose[3:]
        c = rotation.as_matrix() @ covariances[:5] @ rotation.as_matrix().T + covariances[5:]
        return float(np.einsum("ka,kab,kb->", residual, np.linalg.inv(c), residual))

    found = minimize(chi2, np.zeros(6), method="BFGS").fun
    chi2_fitted = fit_anisotropic(x[None], y[None], covariances[None, :5], covariances[None, 5:])[0]
    assert chi2_fitted == pytest.approx(found, rel=1e-4)
