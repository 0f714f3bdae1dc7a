"""Point sets for the tests, made without the code under test."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.geometry import FloatArray
from ronnaplan.studies.heads import HEADS_MM

SIGMA_CT, SIGMA_OTS = 0.56, 0.17

HEAD = HEADS_MM[0]


def scene(
    seed: int,
    markers: int = 8,
    outliers: int = 4,
    hidden: int = 0,
    noise: float = 1.0,
    layout: Any = HEAD,
    radius: float = 300.0,
) -> Any:
    """CT points, OTS points, and the true OTS partner of each CT point (-1: none)."""
    rng = np.random.default_rng(seed)
    points = layout[:markers]
    ct_out, ots_out = (ball(rng, outliers, radius) for _ in range(2))
    ct = np.vstack((points + noise * SIGMA_CT * rng.normal(size=points.shape), ct_out))
    seen = points[hidden:]
    ots = np.vstack((seen + noise * SIGMA_OTS * rng.normal(size=seen.shape), ots_out))
    order = rng.permutation(len(ots))
    turn = Rotation.from_quat(rng.normal(size=4))
    partner = np.full(len(ct), -1)
    partner[hidden:markers] = np.argsort(order)[: markers - hidden]
    turned = np.ascontiguousarray(turn.apply(ots[order]))  # row by row, as `checked_points` has all: compiled once
    return ct, turned + rng.uniform(-1000, 1000, 3), partner


def ball(rng: np.random.Generator, count: int, radius: float) -> Any:
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True) + 1e-300
    return direction * radius * np.cbrt(rng.random((count, 1)))


def is_right(pairing: Any, partner: np.ndarray) -> Any:
    i = np.flatnonzero(partner >= 0)
    return np.array_equal(pairing.pairs, np.column_stack((i, partner[i])))


def bodies(
    seed: int, counts: Sequence[int], radii: Sequence[float], outliers: int = 0, field: float = 300.0
) -> tuple[FloatArray, FloatArray, IntArray]:
    """CT points, OTS points, and the true partners, of bodies that moved against each other among outliers.

    The first body's markers come first; ``counts`` and ``radii``: of each body.
    """
    rng = np.random.default_rng(seed)
    parts = [ball(rng, count, radius) for count, radius in zip(counts, radii, strict=True)]
    return apart(rng, parts, outliers, field)


def apart(
    rng: np.random.Generator,
    parts: Sequence[FloatArray],
    outliers: int,
    field: float,
    errors: float | FloatArray = 1.0,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """CT points, OTS points, and the true partners, of bodies (N, 3) of which all but the first moved."""
    moved = [Rotation.from_quat(rng.normal(size=4)).apply(part) + rng.uniform(-80, 80, 3) for part in parts[1:]]
    ct_true, ots_true = np.vstack(parts), np.vstack([parts[0], *moved])
    ct, ots = (
        np.vstack((true + errors * sigma * rng.normal(size=true.shape), ball(rng, outliers, field)))
        for true, sigma in ((ct_true, SIGMA_CT), (ots_true, SIGMA_OTS))
    )
    order = rng.permutation(len(ots))
    partner = np.where(np.arange(len(ct)) < len(ct_true), np.argsort(order), -1)
    return ct, Rotation.from_quat(rng.normal(size=4)).apply(ots[order]) + 500.0, partner
