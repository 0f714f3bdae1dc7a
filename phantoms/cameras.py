"""What calibrated cameras see of spheres and chessboards, by ray tests.

Pixel centers are at whole numbers. Distortion is Brown's (k1, k2, p1, p2, k3), inverted here by Newton's method.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter

from phantoms.solids import FloatArray

SIZE = (1024, 1280)


def distort(x: FloatArray, y: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the lens puts points at ``x``, ``y`` of the plane at unit distance."""
    k1, k2, p1, p2, k3 = d
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


def pixel_rays(u: FloatArray, v: FloatArray, K: FloatArray, d: FloatArray) -> FloatArray:
    """Rays (..., 3) with z = 1 of pixel places ``u``, ``v``."""
    goal_x, goal_y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    k1, k2, p1, p2, k3 = d
    x, y = goal_x, goal_y
    for _ in range(4):  # the lens displaces little: each step squares what is left
        r2 = x * x + y * y
        radial, bent = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
        j11, j22 = radial + bent * x * x + 2 * p1 * y + 6 * p2 * x, radial + bent * y * y + 6 * p1 * y + 2 * p2 * x
        j12 = bent * x * y + 2 * p1 * x + 2 * p2 * y  # both ways alike
        at_x, at_y = distort(x, y, d)
        off_x, off_y = goal_x - at_x, goal_y - at_y
        det = j11 * j22 - j12 * j12
        x, y = x + (j22 * off_x - j12 * off_y) / det, y + (j11 * off_y - j12 * off_x) / det
    return np.stack([x, y, np.ones_like(x)], axis=-1)


@lru_cache(maxsize=8)
def frame_rays(
    K: tuple[float, ...], d: tuple[float, ...], size: tuple[int, int], du: float, dv: float
) -> FloatArray:
    """Return the rays (rows, columns, 3) of all pixels, ``du`` and ``dv`` beside their centers."""
    rows, columns = np.mgrid[: size[0], : size[1]].astype(float)
    return pixel_rays(columns + du, rows + dv, np.array(K).reshape(3, 3), np.array(d))


def project(point: FloatArray, K: FloatArray, d: FloatArray) -> FloatArray:
    """Return the pixels (..., 2) of places (..., 3) in the camera's frame."""
    x, y = distort(point[..., 0] / point[..., 2], point[..., 1] / point[..., 2], d)
    return np.stack([K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]], axis=-1)


def sphere_image(
    centers_mm: list[FloatArray],
    diameter_mm: float,
    K: FloatArray,
    d: FloatArray,
    rng: np.random.Generator,
    *,
    blur_px: float = 1.2,
    noise: float = 2.0,
    strays: int = 0,
    size: tuple[int, int] = SIZE,
    samples: int = 4,
) -> FloatArray:
    """Bright spheres at ``centers_mm`` (camera frame) on a dark, slightly uneven ground; 8-bit grey values."""
    rows, columns = np.mgrid[: size[0], : size[1]].astype(float)
    image = 12 + 6 * columns / size[1]
    for center in centers_mm:
        at = project(center, K, d)
        reach = 1.3 * K[0, 0] * diameter_mm / 2 / center[2] + 10
        r0, r1 = max(int(at[1] - reach), 0), min(int(at[1] + reach) + 1, size[0])
        c0, c1 = max(int(at[0] - reach), 0), min(int(at[0] + reach) + 1, size[1])
        cover = np.zeros((r1 - r0, c1 - c0))
        offsets = (np.arange(samples) + 0.5) / samples - 0.5
        for dv in offsets:
            for du in offsets:
                ray = pixel_rays(columns[r0:r1, c0:c1] + du, rows[r0:r1, c0:c1] + dv, K, d)
                along = (ray @ center) / np.linalg.norm(ray, axis=-1)
                cover += center @ center - along**2 <= (diameter_mm / 2) ** 2
        cover /= samples**2
        image[r0:r1, c0:c1] += cover * (190 - image[r0:r1, c0:c1])
    for _ in range(strays):  # glints: small discs and streaks away from the spheres
        at = rng.uniform((40, 40), (size[1] - 40, size[0] - 40))
        if min(np.linalg.norm(at - project(c, K, d)) for c in centers_mm) > 200:
            width, height = rng.uniform(2, 40), rng.uniform(2, 6)
            image[((columns - at[0]) / width) ** 2 + ((rows - at[1]) / height) ** 2 < 1] = 230
    return np.clip(np.round(gaussian_filter(image, blur_px) + rng.normal(size=size) * noise), 0, 255).astype(
        np.uint8
    )


def board_image(
    camera_from_board: FloatArray,
    corners: tuple[int, int],
    square_mm: float,
    K: FloatArray,
    d: FloatArray,
    rng: np.random.Generator,
    size: tuple[int, int] = SIZE,
) -> FloatArray:
    """A chessboard whose first inner corner is the board's origin, on a white margin; 8-bit grey values."""
    image = np.zeros(size)
    along_x, along_y, normal, origin = camera_from_board[:3].T
    for dv in (-0.25, 0.25):
        for du in (-0.25, 0.25):
            ray = frame_rays(tuple(K.ravel()), tuple(d), size, du, dv)
            reach = (normal @ origin) / (ray @ normal)
            x = (reach * (ray @ along_x) - origin @ along_x) / square_mm
            y = (reach * (ray @ along_y) - origin @ along_y) / square_mm
            inside = (x > -1) & (x < corners[0]) & (y > -1) & (y < corners[1])
            margin = (x > -2) & (x < corners[0] + 1) & (y > -2) & (y < corners[1] + 1)
            dark = inside & ((np.floor(x) + np.floor(y)) % 2 == 0)
            image += np.where(dark, 30.0, np.where(margin, 210.0, 90.0)) / 4
    return np.clip(gaussian_filter(image, 0.8) + rng.normal(size=size) * 1.5, 0, 255).astype(np.uint8)
