"""What calibrated cameras see of spheres and chessboards, by ray tests.

Pixel centers are at whole numbers. Distortion is Brown's (k1, k2, p1, p2, k3), inverted here by Newton's method.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter, maximum_filter, minimum_filter

from phantoms.solids import FloatArray

SIZE = (1024, 1280)

BAND = 32
"""Rows that are worked out together: what they take stays in a processor's cache."""

NEIGHBORS = np.ones((3, 3), dtype=bool)
"""A pixel with those that touch it; samples are taken only of pixels where these are not all alike."""


SETTLED = 1e-13
"""In focal lengths: a ray that is so near its pixel comes no nearer."""

SAMPLES, STRIDE = 13, 8
LATTICE = np.array([np.arange(SAMPLES), STRIDE * np.arange(SAMPLES)]) / SAMPLES
"""Where in a pixel it is sampled, each pixel's shifted at random and around: with the same places in all, an edge along
a row of them would leap where it passes it, and a board's corners with it by up to a tenth of a pixel."""


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
        at_x, at_y = distort(x, y, d)
        off_x, off_y = goal_x - at_x, goal_y - at_y
        if max(np.abs(off_x).max(initial=0.0), np.abs(off_y).max(initial=0.0)) < SETTLED:
            break
        r2 = x * x + y * y
        radial, bent = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
        j11, j22 = radial + bent * x * x + 2 * p1 * y + 6 * p2 * x, radial + bent * y * y + 6 * p1 * y + 2 * p2 * x
        j12 = bent * x * y + 2 * p1 * x + 2 * p2 * y  # both ways alike
        det = j11 * j22 - j12 * j12
        x, y = x + (j22 * off_x - j12 * off_y) / det, y + (j11 * off_y - j12 * off_x) / det
    return np.stack([x, y, np.ones_like(x)], axis=-1)


@lru_cache(maxsize=2)
def frame_rays(K: tuple[float, ...], d: tuple[float, ...], size: tuple[int, int]) -> FloatArray:
    """Return the rays (rows, columns, 3) of all pixels' centers."""
    columns = np.arange(size[1])
    rays = np.empty((*size, 3))
    for first in range(0, size[0], BAND):
        rows = np.arange(first, min(first + BAND, size[0]))[:, None]
        u, v = np.broadcast_arrays(columns, rows)
        rays[first : first + BAND] = pixel_rays(u, v, np.array(K).reshape(3, 3), np.array(d))
    return rays


def project(point: FloatArray, K: FloatArray, d: FloatArray) -> FloatArray:
    """Return the pixels (..., 2) of places (..., 3) in the camera's frame."""
    x, y = distort(point[..., 0] / point[..., 2], point[..., 1] / point[..., 2], d)
    return np.stack([K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]], axis=-1)


def sphere_cover(
    center_mm: FloatArray,
    diameter_mm: float,
    u: FloatArray,
    v: FloatArray,
    K: FloatArray,
    d: FloatArray,
    samples: int,
) -> FloatArray:
    """Return which share of each pixel (``u``, ``v``) of a part of the frame a sphere covers."""

    def covered(u: FloatArray, v: FloatArray) -> NDArray[np.bool_]:
        ray = pixel_rays(u, v, K, d)
        along = (ray @ center_mm) / np.linalg.norm(ray, axis=-1)
        hit: NDArray[np.bool_] = center_mm @ center_mm - along**2 <= (diameter_mm / 2) ** 2
        return hit

    inside = covered(u, v)
    edge = binary_dilation(inside, NEIGHBORS) & ~binary_erosion(inside, NEIGHBORS)
    cover = inside.astype(float)
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    cover[edge] = np.mean([covered(u[edge] + du, v[edge] + dv) for dv in offsets for du in offsets], axis=0)
    return cover


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
        cover = sphere_cover(center, diameter_mm, columns[r0:r1, c0:c1], rows[r0:r1, c0:c1], K, d, samples)
        image[r0:r1, c0:c1] += cover * (190 - image[r0:r1, c0:c1])
    for _ in range(strays):  # glints: small discs and streaks away from the spheres
        at = rng.uniform((40, 40), (size[1] - 40, size[0] - 40))
        if min(np.linalg.norm(at - project(c, K, d)) for c in centers_mm) > 200:
            width, height = rng.uniform(2, 40), rng.uniform(2, 6)
            left, top = at.astype(int) - 40
            near = np.s_[top : top + 81, left : left + 81]
            image[near][((columns[near] - at[0]) / width) ** 2 + ((rows[near] - at[1]) / height) ** 2 < 1] = 230
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
    along_x, along_y, normal, origin = camera_from_board[:3].T
    # Columns: a ray's place on the board, times the ray's way along the normal; that way.
    onto = np.array([along * (normal @ origin) - normal * (along @ origin) for along in (along_x, along_y)])
    onto = np.vstack([onto / square_mm, normal]).T

    def grey(rays: FloatArray) -> FloatArray:
        x, y, depth = np.moveaxis(rays @ onto, -1, 0)
        x, y = x / depth, y / depth
        inside = (x > -1) & (x < corners[0]) & (y > -1) & (y < corners[1])
        margin = (x > -2) & (x < corners[0] + 1) & (y > -2) & (y < corners[1] + 1)
        dark = inside & ((np.floor(x) + np.floor(y)) % 2 == 0)
        return np.where(dark, 30.0, np.where(margin, 210.0, 90.0))

    image, rays = np.empty(size), frame_rays(tuple(K.ravel()), tuple(d), size)
    for row in range(0, size[0], BAND):
        image[row : row + BAND] = grey(rays[row : row + BAND])
    edge = np.nonzero(maximum_filter(image, 5) != minimum_filter(image, 5))  # no other pixel meets one
    v, u = np.array(edge, dtype=np.float64)
    du, dv = (LATTICE[:, :, None] + rng.uniform(size=(2, 1, len(u)))) % 1 - 0.5
    image[edge] = np.mean([grey(pixel_rays(u + du[k], v + dv[k], K, d)) for k in range(SAMPLES)], axis=0)
    return np.clip(gaussian_filter(image, 0.8) + rng.normal(size=size) * 1.5, 0, 255).astype(np.uint8)
