"""Simulated point sets: markers displaced, read with noise by two instruments, moved and shuffled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM

DISPLACEMENT_RADIUS_MM = 10.0
OUTLIER_RADIUS_MM = 300.0
"""Of the spheres in which the paper moves markers, and puts outliers about their centroid (section 4.2)."""


@dataclass(frozen=True, eq=False)
class Scenes:
    """T tests: ``ct`` (T, n, 3), ``ots`` (T, m, 3), and the true OTS partner of each CT point (T, n) or -1."""

    ct: FloatArray
    ots: FloatArray
    partner: NDArray[np.int64]


def simulate_scenes(
    rng: np.random.Generator,
    layout_mm: FloatArray,
    tests: int,
    markers: int,
    outliers: int,
    *,
    hidden: int = 0,
    noise: FloatArray | float = 1.0,
    displaced_mm: float = DISPLACEMENT_RADIUS_MM,
) -> Scenes:
    """Simulate the protocol of the paper's section 4.2.

    Each point of ``layout_mm`` (N, 3) is displaced uniformly inside a sphere of radius ``displaced_mm``; ``markers``
    of them are kept; normal noise of `SIGMA_CT_MM` and `SIGMA_OTS_MM` (times ``noise``, one or one a test) is added;
    ``outliers`` points uniform in a sphere of `OUTLIER_RADIUS_MM` about the markers' centroid join each set; the first
    ``hidden`` markers are missing from the OTS set, which is turned, shifted and shuffled.
    """
    points = layout_mm + uniform_in_ball(rng, (tests, len(layout_mm)), displaced_mm)
    kept = np.argsort(rng.random(points.shape[:2]), axis=1)[:, :markers]
    points = np.take_along_axis(points, kept[:, :, None], axis=1)
    center = points.mean(axis=1, keepdims=True)
    scale = np.reshape(noise, (-1, 1, 1))
    sets = []
    for sigma, seen in ((SIGMA_CT_MM, points), (SIGMA_OTS_MM, points[:, hidden:])):
        read = seen + scale * sigma * rng.standard_normal(seen.shape)
        strays = center + uniform_in_ball(rng, (tests, outliers), OUTLIER_RADIUS_MM)
        sets.append(np.concatenate((read, strays), axis=1))
    ct, ots = sets
    scenes = shuffled(rng, ct, ots, markers, hidden)
    turned = np.einsum("tab,tnb->tna", random_rotations(rng, tests), scenes.ots)
    return replace(scenes, ots=turned + rng.uniform(-1000, 1000, (tests, 1, 3)))


def shuffled(rng: np.random.Generator, ct: FloatArray, ots: FloatArray, markers: int, hidden: int = 0) -> Scenes:
    """Return scenes of ``ct`` (T, n, 3) and of ``ots`` (T, m, 3), whose points get a random order in each test.

    The first ``markers`` of ``ct`` are markers, and the first of ``ots`` are the same without the first ``hidden``;
    all others are outliers.
    """
    order = np.argsort(rng.random(ots.shape[:2]), axis=1)
    partner = np.full(ct.shape[:2], -1)
    partner[:, hidden:markers] = np.argsort(order, axis=1)[:, : markers - hidden]
    return Scenes(ct, np.ascontiguousarray(np.take_along_axis(ots, order[:, :, None], axis=1)), partner)


def uniform_in_ball(rng: np.random.Generator, shape: tuple[int, ...], radius_mm: float) -> FloatArray:
    """Return points (*shape, 3) uniform inside a ball about the origin."""
    direction = rng.standard_normal((*shape, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.asarray(direction * radius_mm * np.cbrt(rng.random((*shape, 1))))


def random_rotations(rng: np.random.Generator, count: int) -> FloatArray:
    """Return ``count`` rotation matrices (count, 3, 3), uniform over all rotations (normal quaternions)."""
    q = rng.standard_normal((count, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)
