"""A sphere before two cameras under real light: the scenes that stereo re-localization has to measure or to refuse.

Every pixel is the mean of rays through it. The ball is shaded by its normal, and may stand on a post before a ground
whose brightness slopes; glare, glints and things before the ball are drawn into the image, as each camera has its own.
Then come the lens's blur, shot and read noise, and eight bits. Frames: RIG is the left camera's; lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from phantoms.cameras import SIZE, pixel_rays, project
from phantoms.compiled import compiled
from phantoms.solids import FloatArray
from phantoms.spoilt_views import cross, glare, glints, hide, highlight
from phantoms.stereo_kinds import DIAMETER_MM, Scene

WIDTHS_PX = 60.0, 200.0
"""How wide a ball is in an image, from and to."""
SAMPLES = 5
"""Rays along each side of a pixel."""
POST_MM = 18.0
"""How far a post reaches from the ball's center."""
SHADINGS = {"even": 0, "cosine": 1, "side": 2, "disc": 3, "lamp": 2}


@dataclass(frozen=True, eq=False)
class SceneRig:
    """Two cameras before a ball: ``matrices`` (3, 3), ``distortions`` (5) and ``places`` (4, 4), RIG from camera."""

    matrices: tuple[FloatArray, FloatArray]
    distortions: tuple[FloatArray, FloatArray]
    places: tuple[FloatArray, FloatArray]
    middle_mm: FloatArray
    """Where both look (3,)."""


@dataclass(frozen=True, eq=False)
class View:
    """The rendered pair and the truth."""

    left: FloatArray
    right: FloatArray
    center_mm: FloatArray
    """The first ball (3,) in RIG; of no meaning if there is none."""


def random_rig(rng: np.random.Generator) -> SceneRig:
    """Return cameras 200 to 450 mm away and 15 to 40 degrees apart that see a ball `WIDTHS_PX` wide."""
    away, apart = rng.uniform(200, 450), np.radians(rng.uniform(15, 40))
    focal = np.exp(rng.uniform(*np.log(WIDTHS_PX))) * away / DIAMETER_MM
    middle = np.array([0.0, 0.0, away])
    turn = Rotation.from_rotvec([0, -apart, 0]) * Rotation.from_rotvec(rng.normal(0, 0.02, 3))
    right = np.eye(4)
    right[:3, :3] = turn.as_matrix()
    right[:3, 3] = middle - away * rng.uniform(0.95, 1.05) * turn.apply((0, 0, 1))
    matrices, distortions = [], []
    for _ in range(2):
        one = focal * rng.uniform(0.97, 1.03)
        offset = rng.normal(0, 12, 2)
        K = np.diag([one, one * rng.uniform(0.998, 1.002), 1])
        K[:2, 2] = np.array(SIZE[::-1]) / 2 + offset
        matrices.append(K)
        distortions.append(np.array([rng.uniform(-0.2, 0.1), rng.uniform(-0.2, 0.2), *rng.normal(0, 7e-4, 2), 0]))
    return SceneRig((matrices[0], matrices[1]), (distortions[0], distortions[1]), (np.eye(4), right), middle)


def render(scene: Scene, rig: SceneRig, rng: np.random.Generator) -> View:
    """Return both cameras' images (rows, columns; uint8) of a scene drawn at random."""
    pixel_mm = rig.middle_mm[2] / rig.matrices[0][0, 0]
    centers = [rig.middle_mm + rng.uniform(-1, 1, 3) * (150 * pixel_mm, 110 * pixel_mm, 8)]
    if scene.spheres == 2:
        aside = rng.choice([-1.0, 1.0])
        centers.append(centers[0] + (0, aside * rng.uniform(1.3, 1.6) * scene.diameter_mm, rng.uniform(-3, 3)))
    down = Rotation.from_rotvec(rng.normal(0, 0.3, 3)).apply((0.0, 1, 0))
    between = Rotation.from_matrix(rig.places[1][:3, :3])
    facing = Rotation.from_rotvec(between.as_rotvec() / 2).apply((0.0, 0, -1))
    facing = Rotation.from_rotvec(rng.normal(0, np.radians(3), 3)).apply(facing)
    bright, fall = rng.uniform(*scene.bright), rng.uniform(*scene.fall)
    lost = Rotation.from_rotvec(facing * rng.uniform(0, 2 * np.pi)).apply(np.cross(facing, down)) * fall
    light = Rotation.from_rotvec(np.cross(facing, lost + down) * rng.uniform(0.3, 0.7)).apply(facing)
    ambient = rng.uniform(0.35, 0.5) if scene.shading == "side" else rng.uniform(0.0, 0.05)
    post = rng.uniform(*scene.post) * scene.diameter_mm / 2
    blur_px, read_sd = rng.uniform(0.8, 1.8), rng.uniform(1, 3)
    images = []
    both_hidden = rng.uniform() < 0.5
    hidden_side = rng.integers(2)
    for side in range(2):
        K, d, place = rig.matrices[side], rig.distortions[side], rig.places[side]
        turn = place[:3, :3].T
        seen = [turn @ (center - place[:3, 3]) for center in centers[: scene.spheres]]
        image = _ground(rng, *scene.slope)
        for center in seen:
            lamp = _beside(center, rng.uniform(*scene.beside), rng) if scene.shading == "lamp" else turn @ light
            solid = np.concatenate([center, turn @ down, turn @ facing, lamp, turn @ lost])
            _draw_solid(image, solid, scene, (bright, ambient, post, scene.power), K, d)
        at = project(seen[0] if seen else turn @ (centers[0] - place[:3, 3]), K, d)
        radius_px = K[0, 0] * scene.diameter_mm / 2 / (turn @ (centers[0] - place[:3, 3]))[2]
        if scene.gloss[1]:
            highlight(image, at, radius_px, rng.uniform(*scene.gloss) * bright, rng)
        if scene.cable[1]:
            cross(image, at, radius_px, rng.uniform(*scene.cable) * 2 * radius_px, rng)
        if scene.hidden[1] and (both_hidden or side == hidden_side):
            hide(image, at, radius_px, rng.uniform(*scene.hidden), rng)
        if scene.glare[1]:
            glare(image, at, radius_px, rng.uniform(*scene.glare) * radius_px, rng)
        glints(image, at, 1.5 * radius_px, scene.glints, rng)
        images.append(_developed(image, blur_px, read_sd, rng))
    return View(images[0], images[1], centers[0])


def _ground(rng: np.random.Generator, least: float, most: float) -> FloatArray:
    rows, columns = (places / float(max(SIZE)) for places in np.ogrid[: SIZE[0], : SIZE[1]])
    angle, slope = rng.uniform(0, 2 * np.pi), rng.uniform(least, most)
    along = np.cos(angle) * columns + np.sin(angle) * rows
    ground: FloatArray = rng.uniform(8, 20) + slope * (along - along.min())
    return ground


def _beside(center: FloatArray, angle_deg: float, rng: np.random.Generator) -> FloatArray:
    """Return the unit direction (3,) from a ball at ``center`` to a lamp so far beside the camera, to any side."""
    out = -center / np.linalg.norm(center)
    side = np.cross(out, rng.normal(size=3))
    return Rotation.from_rotvec(side / np.linalg.norm(side) * np.radians(angle_deg)).apply(out)


def _draw_solid(
    image: FloatArray,
    solid: FloatArray,
    scene: Scene,
    light: tuple[float, float, float, float],
    K: FloatArray,
    d: FloatArray,
) -> None:
    at = project(solid[:3], K, d)
    reach = (5 if light[2] > 0 else 1.25) * K[0, 0] * scene.diameter_mm / 2 / solid[2] + 6
    low = np.maximum(np.floor(at - reach), 0).astype(int)
    high = np.minimum(np.ceil(at + reach), np.array(SIZE[::-1]) - 1).astype(int) + 1
    rows, columns = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1] - 0.5
    corners = pixel_rays(columns.astype(float), rows.astype(float), K, d)[..., :2].copy()
    window = image[low[1] : high[1], low[0] : high[0]]
    _trace(window, corners, solid, scene.diameter_mm / 2, SHADINGS[scene.shading], *light)


@compiled()
def _trace(
    window: FloatArray,
    corners: FloatArray,
    solid: FloatArray,
    radius: float,
    shading: int,
    bright: float,
    ambient: float,
    post: float,
    power: float,
) -> None:
    """Draw a ball or a disc, and its post, over ``window``; ``corners`` hold the rays' x and y there."""
    for i in range(window.shape[0]):
        for j in range(window.shape[1]):
            total = 0.0
            for a in range(SAMPLES):
                s = (a + 0.5) / SAMPLES
                for b in range(SAMPLES):
                    t = (b + 0.5) / SAMPLES
                    x = (corners[i, j, 0] * (1 - t) + corners[i, j + 1, 0] * t) * (1 - s)
                    x += (corners[i + 1, j, 0] * (1 - t) + corners[i + 1, j + 1, 0] * t) * s
                    y = (corners[i, j, 1] * (1 - t) + corners[i, j + 1, 1] * t) * (1 - s)
                    y += (corners[i + 1, j, 1] * (1 - t) + corners[i + 1, j + 1, 1] * t) * s
                    length = np.sqrt(x * x + y * y + 1)
                    ray = (x / length, y / length, 1 / length)
                    value = window[i, j]
                    if post > 0 and _meets_post(ray, solid, post):
                        value = 0.95 * bright
                    total += _brightness(ray, solid, radius, shading, bright, ambient, power, value)
            window[i, j] = total / SAMPLES**2


@compiled()
def _brightness(
    ray: tuple[float, float, float],
    solid: FloatArray,
    radius: float,
    shading: int,
    bright: float,
    ambient: float,
    power: float,
    behind: float,
) -> float:
    """Return what a ray sees of the ball or the disc, or what is ``behind`` it."""
    x, y, z = ray
    along = x * solid[0] + y * solid[1] + z * solid[2]
    if shading == 3:
        far = solid[0] * solid[6] + solid[1] * solid[7] + solid[2] * solid[8]
        far /= x * solid[6] + y * solid[7] + z * solid[8]
        off = (x * far - solid[0]) ** 2 + (y * far - solid[1]) ** 2 + (z * far - solid[2]) ** 2
        return bright if off <= radius**2 else behind
    under = along**2 - (solid[0] ** 2 + solid[1] ** 2 + solid[2] ** 2) + radius**2
    if under < 0:
        return behind
    near = along - np.sqrt(under)
    nx, ny, nz = (x * near - solid[0]) / radius, (y * near - solid[1]) / radius, (z * near - solid[2]) / radius
    lit = 1.0
    if shading == 1:
        lit = ambient + (1 - ambient) * abs(nx * x + ny * y + nz * z)
    elif shading == 2:
        lit = ambient + (1 - ambient) * max(nx * solid[9] + ny * solid[10] + nz * solid[11], 0.0) ** power
    return float(bright * lit * (1 + (nx * solid[12] + ny * solid[13] + nz * solid[14]) / 2))


@compiled()
def _meets_post(ray: tuple[float, float, float], solid: FloatArray, radius: float) -> bool:
    """Tell whether a ray from the camera meets the cylinder that goes down from the ball's center."""
    x, y, z = ray
    dx, dy, dz = solid[3], solid[4], solid[5]
    down = x * dx + y * dy + z * dz
    ax, ay, az = x - dx * down, y - dy * down, z - dz * down
    base = solid[0] * dx + solid[1] * dy + solid[2] * dz
    ox, oy, oz = solid[0] - dx * base, solid[1] - dy * base, solid[2] - dz * base
    square = ax * ax + ay * ay + az * az
    nearest = (ax * ox + ay * oy + az * oz) / square
    gap = (ax * nearest - ox) ** 2 + (ay * nearest - oy) ** 2 + (az * nearest - oz) ** 2
    if gap > radius**2:
        return False
    far = nearest - np.sqrt((radius**2 - gap) / square)
    return bool(0 < far * down - base < POST_MM)


def _developed(image: FloatArray, blur_px: float, read_sd: float, rng: np.random.Generator) -> FloatArray:
    """Return the image as the camera gives it: blurred, with shot and read noise, in whole grey levels."""
    blurred: FloatArray = gaussian_filter(np.minimum(image, 400.0), blur_px)
    noisy = rng.normal(size=SIZE)
    noisy *= np.sqrt(read_sd**2 + 0.02 * blurred)
    noisy += blurred
    return np.clip(np.round(noisy, out=noisy), 0, 255, out=noisy).astype(np.uint8)
