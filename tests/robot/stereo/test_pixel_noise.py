"""The noise of an image's pixels on a ball and beside it."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.robot.stereo.pixel_noise import noise_on, roughness
from ronnaplan.robot.stereo.pixel_noise_compiled import roughness_about

MIDDLE = np.array([100.0, 100.0])


def ball(noise: float, rng: np.random.Generator) -> np.ndarray:
    """Return an image of a ball of radius 40 with a highlight in its middle and such noise."""
    away = np.hypot(*np.meshgrid(np.arange(200) - 100, np.arange(200) - 100))
    light = np.where(away < 40, 120 + 80 * np.exp(-((away / 8) ** 2)), 20)
    return np.clip(np.rint(light + noise * rng.normal(size=away.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("noise", [1.0, 2.0, 4.0])
def test_a_highlight_is_no_noise(noise: float) -> None:
    grey = ball(noise, np.random.default_rng(3))
    assert noise_on(grey, MIDDLE, 40.0) == pytest.approx(noise, rel=0.1)


def test_a_highlight_brighter_than_a_pixel_gets_hides_no_noise_beside_it() -> None:
    grey = np.minimum(ball(3.0, np.random.default_rng(3)), 140)
    assert noise_on(grey, MIDDLE, 40.0) == pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize("radius_px", [1.0, 3.0])
def test_a_few_pixels_tell_no_noise(radius_px: float) -> None:
    assert noise_on(ball(3.0, np.random.default_rng(3)), MIDDLE, radius_px) == np.inf


def test_an_overexposed_ball_tells_no_noise() -> None:
    grey = np.minimum(ball(3.0, np.random.default_rng(3)), 90)
    assert noise_on(grey, MIDDLE, 40.0) == np.inf


def test_noise_on_a_ball_and_in_each_direction_beside_it_is_that_of_its_pixels_second_differences() -> None:
    window = np.random.default_rng(3).normal(100.0, 20.0, (90, 120)).round()
    middle, radius = np.array([57.3, 44.6]), 22.0
    (on_ball, pixels, bright), sums, counts = roughness_about(window, middle, radius, 0.75, (1.25, 1.9), 24, 140.0)
    rough, columns, rows = roughness(window), np.arange(1, 119) - middle[0], np.arange(1, 89)[:, None] - middle[1]
    away = np.hypot(columns, rows) / radius
    assert (pixels, bright) == ((away < 0.75).sum(), (window[1:-1, 1:-1][away < 0.75] == 140.0).sum())
    assert on_ball == pytest.approx(rough[away < 0.75].sum())
    sectors = ((np.arctan2(rows, columns) / (2 * np.pi) + 0.5) * 24).astype(int)
    beside = [(away > 1.25) & (away < 1.9) & (sectors == sector) for sector in range(24)]
    assert sorted(counts) == sorted(one.sum() for one in beside)
    np.testing.assert_allclose(np.sort(sums), np.sort([rough[one].sum() for one in beside]))
