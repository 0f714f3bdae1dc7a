"""Whether all rows of an image are of one moment: an interlaced camera reads the odd ones later than the even ones."""

from __future__ import annotations

import numpy as np

from ronnaplan.errors import RefusedError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.robot.stereo.circles import Image, box_about
from ronnaplan.robot.stereo.outline import Outline

BESIDE = 1.2
"""So far about the ball, in its radii, rows are looked at."""
LARGEST_SHIFT_PX, SHIFT_SDS = 0.1, 6.0
"""Odd rows that are shifted by more pixels against even ones, and by so many standard errors, are of another moment."""


def require_one_moment(
    images: tuple[Image, Image], cameras: tuple[Camera, Camera], seen: tuple[Outline, Outline]
) -> None:
    """Raise `RefusedError` where the odd rows of one of the ``images`` show the ball ``seen`` beside the even ones."""
    for side, image, camera, one in zip(("left", "right"), images, cameras, seen, strict=True):
        shift, sd = rows_apart(image, *one.in_image(camera))
        if shift > max(LARGEST_SHIFT_PX, SHIFT_SDS * sd):
            raise RefusedError(
                f"odd rows of the {side} image show the sphere {shift:.1f} pixels beside the even ones, as of an "
                "interlaced camera before which it moves; let it rest, or read all rows at one moment"
            )


def rows_apart(grey: Image, middle_px: FloatArray, radius_px: float) -> tuple[float, float]:
    """Return by how many pixels odd rows of ``grey`` (rows, columns) are shifted along them, and its standard error.

    It is told by the ball about ``middle_px`` (2,), column and row: a row less the mean of its neighbors goes with the
    brightness' slope, one way in odd rows and the other way in even ones. So does a sharp edge along a row with the
    slope across rows, so that of a shift across them nothing is told.
    """
    window = np.asarray(grey[box_about(grey.shape, middle_px, BESIDE * radius_px)], dtype=np.float64)
    if min(window.shape) < 3:
        return 0.0, float("inf")
    sides = (window[:-2] + window[2:]) / 2
    turns = np.where(np.arange(len(sides)) % 2, 1.0, -1.0)[:, None]
    apart = (turns * (window[1:-1] - sides))[:, 1:-1].ravel()
    slopes = np.column_stack([
        ((sides[:, 2:] - sides[:, :-2]) / 2).ravel(),
        ((window[2:] - window[:-2]) / 2)[:, 1:-1].ravel(),
    ])  # fmt: skip
    inverse = np.linalg.pinv(slopes.T @ slopes)
    shift = inverse @ (slopes.T @ apart)
    left = apart - slopes @ shift
    spread = inverse @ (slopes.T @ (slopes * left[:, None] ** 2)) @ inverse
    return abs(float(shift[0])), float(np.sqrt(spread[0, 0]))
