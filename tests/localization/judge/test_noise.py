"""The noise about a ball is that of the quieter of its inside and its surroundings, whatever else disturbs voxels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.cells import CELL_COUNT, direction_cells
from ronnaplan.localization.fit.parameters import CENTER
from ronnaplan.localization.judge.noise import noise_level
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, scan, small_stack

DIAMETER_MM, SEEDS = 11.5, 40
EDGE_MM = 0.5
"""Voxels so near to the surface lie in its blur."""


def fit_of(volume: CTVolume) -> BallFit:
    return fit_place(Scan(volume), np.array([1.2, 1.9, 2.8]), DIAMETER_MM)


@pytest.fixture(scope="module")
def quiet() -> CTVolume:
    return scan(balls([(1.0, 2.0, 3.0)]), small_stack(), noise_hu=0.0)


@pytest.fixture(scope="module")
def ball(quiet: CTVolume) -> BallFit:
    return fit_of(quiet)


def with_white_noise(volume: CTVolume, noise_hu: float) -> CTVolume:
    noise = np.random.default_rng(1).normal(0, noise_hu, volume.voxels_hu.shape)
    return replace(volume, voxels_hu=(volume.voxels_hu + noise).astype(np.float32))


def outward_mm(ball: BallFit) -> FloatArray:
    """How far each voxel (N,) lies outside of the ball."""
    far_mm: FloatArray = np.linalg.norm(ball.neighbourhood.offsets_mm - ball.theta[CENTER], axis=1)
    return far_mm - DIAMETER_MM / 2


def left_over(ball: BallFit, inside_hu: float, outside_hu: float, seed: int) -> BallFit:
    """The ball with so much white noise left over, and far more at its edge and where nothing informs the fit."""
    away_mm = outward_mm(ball)
    noise_hu = np.where(away_mm < 0.0, inside_hu, outside_hu)
    noise_hu[(np.abs(away_mm) < EDGE_MM) | ~ball.used] = 1000.0
    return replace(ball, residuals_hu=np.random.default_rng(seed).normal(0.0, noise_hu))


@pytest.mark.parametrize("noise_hu", [5.0, 20.0, 80.0])
def test_the_level_of_white_noise_is_measured_to_a_fifth(quiet: CTVolume, noise_hu: float) -> None:
    assert noise_level(fit_of(with_white_noise(quiet, noise_hu))) == pytest.approx(noise_hu, rel=0.2)


def test_the_noise_of_a_small_ball_is_told_though_most_directions_show_a_single_voxel_of_it() -> None:
    """Such a voxel is its direction's mean: it looked as if there were no noise, and noisy balls were turned down."""
    small = scan(balls([(1.0, 2.0, 3.0)], 5.0), small_stack(), noise_hu=0.0)
    fit = fit_place(Scan(with_white_noise(small, 100.0)), np.array([1.2, 1.9, 2.8]), 5.0)
    assert noise_level(fit) == pytest.approx(100.0, rel=0.25)


def test_the_noise_is_told_where_no_two_voxels_share_a_direction(ball: BallFit) -> None:
    """As of balls of two pixels. What is left over at the edge, as of what is no ball, is not taken for noise."""
    around, away_mm = ball.neighbourhood, outward_mm(ball)
    cells = direction_cells(around.offsets_mm - ball.theta[CENTER])
    alone = np.abs(away_mm) < EDGE_MM
    outside = np.flatnonzero(ball.used & (away_mm > 3 * EDGE_MM))
    alone[outside[np.unique(cells[outside], return_index=True)[1]]] = True
    seen = replace(around, floors_hu=np.full(len(cells), -3000.0))
    fit = replace(ball, used=ball.used & alone, neighbourhood=seen, jacobian=np.ones_like(ball.jacobian))
    levels_hu = [
        noise_level(replace(fit, residuals_hu=left_over(ball, 10.0, 10.0, seed).residuals_hu))
        for seed in range(SEEDS)
    ]
    assert np.mean(levels_hu) == pytest.approx(10.0, rel=0.1)


def test_the_noise_of_a_small_ball_is_told_where_the_scale_cuts_that_of_air_off() -> None:
    small = scan(balls([(1.0, 2.0, 3.0)], 5.0), small_stack(), noise_hu=0.0)
    noisy = with_white_noise(small, 100.0)
    cut = replace(noisy, voxels_hu=np.maximum(noisy.voxels_hu, -900.0))
    fit = fit_place(Scan(cut), np.array([1.2, 1.9, 2.8]), 5.0)
    assert noise_level(fit) > 30.0  # 6 by its air


@pytest.mark.parametrize("begins_hu", [-950.0, -900.0, -800.0, -700.0])
def test_the_noise_of_a_ball_is_told_where_the_scale_cuts_that_of_air_off(
    quiet: CTVolume, begins_hu: float
) -> None:
    """Cone beams show air at their scale's lower end, or below it: without any noise."""
    noisy = with_white_noise(quiet, 40.0)
    fit = fit_of(replace(noisy, voxels_hu=np.maximum(noisy.voxels_hu, begins_hu)))
    assert noise_level(fit) == pytest.approx(40.0, rel=0.25)


@pytest.mark.parametrize(("inside_hu", "outside_hu"), [(10.0, 40.0), (40.0, 10.0)])
def test_the_quieter_of_inside_and_outside_tells_the_noise(
    ball: BallFit, inside_hu: float, outside_hu: float
) -> None:
    """It is not underrated for the means of the directions, which take up some of it."""
    levels_hu = [noise_level(left_over(ball, inside_hu, outside_hu, seed)) for seed in range(SEEDS)]
    assert np.mean(levels_hu) == pytest.approx(10.0, rel=0.03)


def test_what_whole_directions_are_off_by_is_no_noise(ball: BallFit) -> None:
    """Streaks lighten some directions and darken others."""
    fit = left_over(ball, 10.0, 10.0, 1)
    streaks_hu = np.random.default_rng(2).normal(0.0, 100.0, CELL_COUNT)
    cells = direction_cells(ball.neighbourhood.offsets_mm - ball.theta[CENTER])
    assert noise_level(replace(fit, residuals_hu=fit.residuals_hu + streaks_hu[cells])) == pytest.approx(
        noise_level(fit)
    )


def test_air_of_which_most_is_below_the_scale_does_not_tell_the_noise(ball: BallFit) -> None:
    """Two thirds of it look as if there were none."""
    fit, around = left_over(ball, 20.0, 20.0, 1), ball.neighbourhood
    is_cut_off = (outward_mm(ball) > 0.0) & (np.random.default_rng(2).random(len(ball.used)) < 0.66)
    fit = replace(
        fit,
        residuals_hu=np.where(is_cut_off, 0.0, fit.residuals_hu),
        neighbourhood=replace(around, floors_hu=np.where(is_cut_off, around.values_hu, -3000.0)),
    )
    assert noise_level(fit) == pytest.approx(20.0, rel=0.1)


def test_metal_brighter_than_the_scale_does_not_tell_the_noise(ball: BallFit) -> None:
    """All that is seen in it is the scale's end, with nothing left over, and no parameter changes that."""
    fit, is_inside = left_over(ball, 0.0, 20.0, 1), outward_mm(ball) < 0.0
    fit = replace(fit, jacobian=np.where(is_inside[:, np.newaxis], 0.0, fit.jacobian))
    assert noise_level(fit) == pytest.approx(20.0, rel=0.1)


def test_a_few_voxels_tell_no_noise(ball: BallFit) -> None:
    """Where there are more neither inside nor outside, all that is left over counts, if there is any."""
    fit, away_mm = left_over(ball, 1.0, 40.0, 1), outward_mm(ball)
    inside, outside = (np.flatnonzero(ball.used & (zone > 2.5 * EDGE_MM)) for zone in (-away_mm, away_mm))
    few, none = np.zeros_like(ball.used), np.zeros_like(ball.used)
    few[inside[:20]] = True
    assert noise_level(replace(fit, used=few)) == pytest.approx(np.sqrt(np.mean(fit.residuals_hu[few] ** 2)))
    few[outside] = True
    assert noise_level(replace(fit, used=few)) == pytest.approx(40.0, rel=0.15)
    assert noise_level(replace(fit, used=none)) == 1.0


def test_voxels_in_whole_hu_are_never_quieter_than_their_rounding(ball: BallFit) -> None:
    assert noise_level(left_over(ball, 0.0, 0.0, 1)) == pytest.approx(1.0 / np.sqrt(12.0), rel=0.01)
