"""The noise of an image's pixels on a ball."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.robot.stereo.pixel_noise import noise_on

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
