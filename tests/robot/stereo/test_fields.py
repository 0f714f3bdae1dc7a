"""Images that are not of one moment: left and right, or odd and even rows."""

import numpy as np
import pytest
from scipy.ndimage import shift

from ronnaplan.errors import RefusedError
from ronnaplan.robot.stereo.fields import rows_apart
from ronnaplan.robot.stereo.sphere import locate_sphere
from tests.robot.stereo.stereo_views import DIAMETER, RIG_EXACT, rendered, seen


def interlaced(grey: np.ndarray, moved_px: tuple[float, float]) -> np.ndarray:
    """Return an image (rows, columns; uint8) whose odd rows are of when all was moved by so many rows and columns."""
    later = np.rint(np.clip(shift(grey.astype(float), moved_px, order=3, mode="nearest"), 0, 255)).astype(np.uint8)
    both = grey.copy()
    both[1::2] = later[1::2]
    return both


@pytest.mark.parametrize("moved_px", [(0.0, 0.3), (0.4, 0.2)])
def test_an_interlaced_image_of_what_moves_is_refused(moved_px: tuple[float, float]) -> None:
    """What is found is in the middle of both moments, and was stated as if nothing moved."""
    left, right = seen([np.array([3.0, -2, 300])], np.random.default_rng(3))
    with pytest.raises(RefusedError, match=r"odd rows of the left image .* 0\.[23] pixels beside the even ones"):
        locate_sphere(interlaced(left, moved_px), right, RIG_EXACT, diameter_mm=DIAMETER)


def test_rows_of_one_moment_are_not_apart() -> None:
    for name in ("evenly bright", "bright base", "dim beside reflections"):
        view, _ = rendered(name, 3)
        middle = np.array([view.left.shape[1], view.left.shape[0]]) / 2.0
        apart_px, sd_px = rows_apart(view.left, middle, 200.0)
        assert apart_px < 0.05
        assert apart_px < 5 * sd_px


def test_images_of_two_moments_are_told_as_such() -> None:
    """What moved by 0.3 pixels across the lines of sight's plane may have moved along it unseen."""
    left, right = seen([np.array([3.0, -2, 300])], np.random.default_rng(3))
    later = np.rint(np.clip(shift(right.astype(float), (0.3, 0.0), order=3, mode="nearest"), 0, 255))
    with pytest.raises(RefusedError, match=r"miss each other by 0\.\d+ pixels, .* take both at one moment"):
        locate_sphere(left, later.astype(np.uint8), RIG_EXACT, diameter_mm=DIAMETER)
