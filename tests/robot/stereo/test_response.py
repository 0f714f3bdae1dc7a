"""Whether images are linear in the light, by their noise."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.errors import RefusedError
from ronnaplan.robot.stereo.response import noise_beside
from ronnaplan.robot.stereo.sphere import locate_sphere
from tests.long import few_and_others
from tests.robot.stereo.stereo_views import DIAMETER, rendered


def bent(grey: np.ndarray) -> np.ndarray:
    """Return an image as a camera with a gamma of 2.2 stores it."""
    return np.rint(255 * (grey / 255) ** (1 / 2.2)).astype(np.uint8)


def ball(on: float, beside: float, rng: np.random.Generator) -> np.ndarray:
    """Return an image of a ball with such noise on it and beside it."""
    away = np.hypot(*np.meshgrid(np.arange(200) - 100, np.arange(200) - 100))
    noise = np.where(away < 40, on, beside) * rng.normal(size=away.shape)
    return np.clip(np.rint(np.where(away < 40, 180, 30) + noise), 0, 255).astype(np.uint8)


@few_and_others("scene", ["evenly bright"], ["limb darkens as the cosine"])
def test_images_that_are_not_linear_in_the_light_are_refused(scene: str) -> None:
    """What little light falls on a dark limb from one side is stretched, so that the center moves."""
    view, rig = rendered(scene, 3)
    locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER)
    with pytest.raises(RefusedError, match=r"times as much noise beside the sphere as on it.* gamma of 1"):
        locate_sphere(bent(view.left), bent(view.right), rig, diameter_mm=DIAMETER)


@pytest.mark.parametrize(("on", "beside", "ratio"), [(2.0, 2.0, 1.0), (3.0, 1.5, 0.5), (1.5, 3.0, 2.0)])
def test_noise_is_told_on_a_ball_and_beside_it(on: float, beside: float, ratio: float) -> None:
    grey = ball(on, beside, np.random.default_rng(5))
    assert noise_beside(grey, np.array([100.0, 100.0]), 40.0) == pytest.approx(ratio, rel=0.12)


def test_a_texture_beside_a_ball_is_no_noise_of_the_whole() -> None:
    grey = ball(2.0, 2.0, np.random.default_rng(5))
    grey[:, 120:] += (40 * (np.indices((200, 80)).sum(axis=0) % 2)).astype(np.uint8)
    assert noise_beside(grey, np.array([100.0, 100.0]), 40.0) < 1.2


@pytest.mark.parametrize("radius_px", [2.0, 40.0])
def test_a_ball_that_is_small_or_overexposed_tells_no_noise(radius_px: float) -> None:
    grey = ball(0.0, 3.0, np.random.default_rng(5))
    assert noise_beside(grey, np.array([100.0, 100.0]), radius_px) == 0.0
