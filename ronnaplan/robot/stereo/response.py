"""Whether a camera's images are linear in the light, as far as their noise tells.

Light has more noise the brighter it is, and a sensor no less: what is beside a bright ball is never noisier than the
ball. Where it is, brightness was bent after it was read (gamma): what is dark was stretched, noise and all, and so was
what little light falls on a dark limb from one side.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.errors import RefusedError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.robot.stereo.circles import Image, box_about
from ronnaplan.robot.stereo.outline import Outline
from ronnaplan.robot.stereo.pixel_noise import FEWEST_PIXELS, INSIDE, LEAST_NOISE
from ronnaplan.robot.stereo.pixel_noise_compiled import roughness_about

BESIDE = (1.25, 1.9)
"""What is beside the ball, in its radii."""
SECTORS, QUIET = 24, 0.25
"""The noise beside it is that of the quieter parts, so many and this share: the others may show a texture."""
FALLING = 1.2
"""No more noise beside a ball than on it, within what textures and chance make of it, is that of light."""


def require_linear(
    images: tuple[Image, Image], cameras: tuple[Camera, Camera], seen: tuple[Outline, Outline]
) -> None:
    """Raise `RefusedError` where the noise of both ``images`` is less on the ball that is ``seen`` than beside it."""
    ratio = min(
        noise_beside(image, *one.in_image(camera))
        for image, camera, one in zip(images, cameras, seen, strict=True)
    )
    if ratio > FALLING:
        raise RefusedError(
            f"the images have {ratio:.1f} times as much noise beside the sphere as on it, as where they are not linear "
            "in the light; record them with a gamma of 1, and before a ground without a fine texture"
        )


def noise_beside(grey: Image, middle_px: FloatArray, radius_px: float) -> float:
    """Return how many times as much noise ``grey`` (rows, columns) has beside a ball as on it; 0 where nothing tells.

    The ball is about ``middle_px`` (2,), column and row.
    """
    rows, columns = box_about(grey.shape, middle_px, BESIDE[1] * radius_px)
    window = np.ascontiguousarray(grey[rows, columns], dtype=np.float64)
    brightest = float(grey.max())
    (on_ball, pixels, bright), sums, counts = roughness_about(
        window, middle_px - [columns.start, rows.start], radius_px, INSIDE, BESIDE, SECTORS, brightest
    )
    if pixels < FEWEST_PIXELS or bright >= FEWEST_PIXELS:
        return 0.0
    told = counts >= FEWEST_PIXELS
    if not told.any():
        return 0.0
    noise = float(np.quantile(sums[told] / counts[told], QUIET))
    return noise / max(on_ball / pixels, LEAST_NOISE * brightest)
