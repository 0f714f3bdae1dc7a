"""Shading is believed as far as it stands out: a contrast that slopes, slices with a level of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit import ball_fit
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, offsets_mm, scan, small_stack

CENTER = np.array([1.0, 2.0, 3.0])
SLOPE_PER_MM = 0.004
STREAK_HU = 6.0
SEEDS = range(6)


@pytest.fixture(scope="module")
def even() -> CTVolume:
    """A ball without any shading or noise."""
    return scan(balls([(1.0, 2.0, 3.0)]), small_stack(), noise_hu=0.0)


@pytest.fixture(scope="module")
def sloping(even: CTVolume) -> CTVolume:
    """Its contrast grows by 0.4 % a millimetre towards +x."""
    x, _, _ = offsets_mm(even, CENTER)
    ball = even.voxels_hu + 1000.0
    return replace(even, voxels_hu=(ball * (1 + SLOPE_PER_MM * x) - 1000.0).astype(np.float32))


def fitted(volume: CTVolume) -> BallFit:
    return fit_place(Scan(volume), CENTER + 0.1, 11.5)


def unshaded(volume: CTVolume, monkeypatch: pytest.MonkeyPatch) -> BallFit:
    with monkeypatch.context() as context:
        context.setattr(ball_fit, "PLATEAU_SHARE", np.nan)  # no scale reaches it
        return fitted(volume)


def streaked(volume: CTVolume, seed: int) -> CTVolume:
    """Each slice lifted or lowered as a whole."""
    levels = np.random.default_rng(seed).normal(0.0, STREAK_HU, len(volume.voxels_hu))
    return replace(volume, voxels_hu=(volume.voxels_hu + levels[:, np.newaxis, np.newaxis]).astype(np.float32))


def root_mean_square(values: list[FloatArray]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_a_slope_that_stands_out_is_believed(sloping: CTVolume, monkeypatch: pytest.MonkeyPatch) -> None:
    without_mm = unshaded(sloping, monkeypatch).center_mm[0] - CENTER[0]
    assert without_mm > 0.004
    assert fitted(sloping).center_mm == pytest.approx(CENTER, abs=0.15 * without_mm)


def test_a_slope_that_noise_hides_is_not(sloping: CTVolume, monkeypatch: pytest.MonkeyPatch) -> None:
    noise = np.random.default_rng(1).normal(0.0, 150.0, sloping.voxels_hu.shape)
    noisy = replace(sloping, voxels_hu=(sloping.voxels_hu + noise).astype(np.float32))
    without, with_it = unshaded(noisy, monkeypatch), fitted(noisy)
    assert with_it.converged
    error_mm = np.sqrt(np.trace(with_it.influence_mm_per_hu.T @ with_it.influence_mm_per_hu)) * 150.0
    assert np.linalg.norm(with_it.center_mm - without.center_mm) < 0.1 * error_mm


def test_slices_may_have_a_level_of_their_own(even: CTVolume, monkeypatch: pytest.MonkeyPatch) -> None:
    scans = [streaked(even, seed) for seed in SEEDS]
    with_it = root_mean_square([fitted(one).center_mm - CENTER for one in scans])
    without = root_mean_square([unshaded(one, monkeypatch).center_mm - CENTER for one in scans])
    assert with_it < 0.3 * without


def test_the_influence_tells_what_a_voxel_does_to_the_center(even: CTVolume) -> None:
    rng = np.random.default_rng(2)
    usual = replace(
        even, voxels_hu=even.voxels_hu + rng.normal(0.0, 10.0, even.voxels_hu.shape).astype(np.float32)
    )
    fit = fitted(usual)
    noise = rng.normal(0.0, 2.0, even.voxels_hu.shape)
    noisy = fitted(replace(usual, voxels_hu=(usual.voxels_hu + noise).astype(np.float32)))
    moved = fit.neighbourhood.axes @ (noisy.center_mm - fit.center_mm)
    own, others = (
        np.round(even.grid.indices(around.origin_mm + around.offsets_mm @ around.axes)).astype(int)
        for around in (fit.neighbourhood, noisy.neighbourhood)
    )
    kept = set(map(tuple, others))
    common = np.array([n for n, index in enumerate(own) if tuple(index) in kept])
    at = tuple(own[common].T)
    expected = noise[at] @ fit.influence_mm_per_hu[common]
    assert moved == pytest.approx(expected, abs=0.2 * float(np.linalg.norm(expected)))


def test_clipping_that_hides_the_balls_own_level_hides_its_shading(
    sloping: CTVolume, monkeypatch: pytest.MonkeyPatch
) -> None:
    clipped = replace(sloping, voxels_hu=np.minimum(4.0 * (sloping.voxels_hu + 1000.0) - 1000.0, 2500.0))
    fit = fitted(clipped)
    assert not fit.is_shaded
    assert fit.center_mm == pytest.approx(unshaded(clipped, monkeypatch).center_mm, abs=1e-12)
