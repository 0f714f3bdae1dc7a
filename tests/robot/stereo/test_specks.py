"""What is finer than light on a ball, and what is not."""

import numpy as np
import pytest

from ronnaplan.robot.stereo.specks import without_specks

NOISE, RADIUS_PX = 0.5, 40.0


def ball(middle_px: tuple[float, float]) -> np.ndarray:
    """Return an image (120, 120) of a ball that gets brighter along both axes, on a dark ground."""
    down, across = np.mgrid[:120, :120] - np.reshape(middle_px[::-1], (2, 1, 1))
    light = np.where(np.hypot(down, across) < RADIUS_PX, 120 + across + 0.3 * down, 5.0)
    return light + np.random.default_rng(1).normal(0, NOISE, light.shape)


@pytest.mark.parametrize("middle_px", [(60, 60), (2, 60), (117, 60), (60, 2), (60, 117), (2, 117)])
def test_light_is_no_speck_on_a_ball_that_the_image_cuts_off(middle_px: tuple[float, float]) -> None:
    """What lies at one edge of the image was held against the other one."""
    assert without_specks(ball(middle_px), np.array(middle_px), RADIUS_PX, NOISE) is None


@pytest.mark.parametrize("middle_px", [(60, 60), (2, 60), (60, 117)])
def test_a_speck_is_left_out_also_of_a_ball_that_the_image_cuts_off(middle_px: tuple[float, float]) -> None:
    grey, (column, row) = ball(middle_px), (60 if middle_px[0] == 60 else 17, 60 if middle_px[1] == 60 else 102)
    grey[row - 1 : row + 2, column - 1 : column + 2] += 60
    cleaned = without_specks(grey, np.array(middle_px), RADIUS_PX, NOISE)
    assert cleaned is not None
    assert np.isnan(cleaned[row, column])
    assert np.isnan(cleaned).sum() < 500
