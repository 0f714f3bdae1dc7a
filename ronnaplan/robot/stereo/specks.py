"""What lies on a ball in an image, or before it, and is finer than light: dust, scratches, seams, hairs and cables."""

from __future__ import annotations

import cv2
import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.circles import Image, box_about

WIDTHS, LEAST_PX = (0.08, 0.16, 0.32), 3
"""How far to both sides of a pixel the ball is looked at, in its radii: what is wider is light."""
WAYS = ((1.0, 0.0), (0.0, 1.0), (0.7, 0.7), (0.7, -0.7))
EDGE_PX = 4.0
"""Nothing of a ball is left out so near to its edge: that tells where the ball is."""
OTHER = 2.5
"""A speck differs from the ball on both sides by so many times a pixel's noise, in means over 3 x 3 of them ..."""
BLUR_PX = 2
"""... and the blur carries it so far beside it."""
LARGEST_SHARE = 0.5
"""What covers more of a ball are no specks."""


def without_specks(grey: Image, middle_px: FloatArray, radius_px: float, noise: float) -> FloatArray | None:
    """Return ``grey`` (rows, columns) with NaN where something fine lies on a ball; None where nothing, or much, does.

    The ball is about ``middle_px`` (2,), column and row, and its pixels have that ``noise``. A speck is brighter, or
    darker, than the ball on both of its sides; of what has none on one, as it reaches the edge, nobody can tell.
    """
    rows, columns = box = box_about(grey.shape, middle_px, radius_px)
    across = np.arange(columns.start, columns.stop) - middle_px[0]
    down = np.arange(rows.start, rows.stop)[:, None] - middle_px[1]
    depth = radius_px - EDGE_PX - np.hypot(across, down)
    cleaned = np.array(grey, dtype=np.float64)
    window = cleaned[box]
    smooth, specks = cv2.blur(window, (3, 3)), np.zeros(window.shape, dtype=np.uint8)
    above, beside = (np.minimum(one, one[::-1]) for one in map(np.arange, window.shape))
    both_sides = np.minimum(depth, np.minimum(beside, above[:, None]))  # of a ball that the image cuts off, also
    for far in {max(round(share * radius_px), LEAST_PX) for share in WIDTHS}:
        for way in WAYS:
            step = round(far * way[0]), round(far * way[1])
            one, other = (smooth - np.roll(smooth, (sign * step[0], sign * step[1]), (0, 1)) for sign in (1, -1))
            unlike = (one * other > 0) & (np.minimum(np.abs(one), np.abs(other)) > OTHER * noise)
            specks |= unlike & (both_sides > far)
    blurred = (cv2.dilate(specks, np.ones((2 * BLUR_PX + 1,) * 2, dtype=np.uint8)) > 0) & (depth > 0)
    if not 0 < blurred.sum() < LARGEST_SHARE * np.pi * radius_px**2:
        return None
    window[blurred] = np.nan
    return cleaned
