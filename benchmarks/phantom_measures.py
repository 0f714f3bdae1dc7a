"""What the claims about the phantom scanner are measured with: where a ball is in its images, and how much of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantoms.machine import Machine
from phantoms.scene import Scene
from phantoms.solids import FloatArray
from phantoms.stack import SliceStack, axial_stack

Excess = NDArray[np.floating[Any]]
"""HU above the surroundings (K, rows, columns)."""

Row = tuple[str, str, str, bool]
"""Claim, measured, limit, whether it holds."""

HOME = np.array([45.0, -30.0, 0.0])
"""Where the balls are scanned: away from the center of rotation, where errors would show."""


def hu(scene: Scene, stack: SliceStack, scanner: Machine, seed: int = 0) -> FloatArray:
    """Return the images in HU, neither rounded nor clipped."""
    return scanner.reconstruct(scene, [stack], seed=seed)[0].astype(np.float64)


def places(stack: SliceStack) -> FloatArray:
    """Return where every voxel is (K, rows, columns, 3)."""
    v, u = np.mgrid[: stack.rows, : stack.columns] * stack.pixel_mm
    in_plane = v[..., np.newaxis] * stack.row_direction + u[..., np.newaxis] * stack.column_direction
    found: FloatArray = stack.origins_mm[:, np.newaxis, np.newaxis] + in_plane
    return found


def centroid(excess: Excess, stack: SliceStack, center: FloatArray, reach_mm: float) -> FloatArray:
    """Return the centroid (mm) of what rises above the surroundings near ``center``."""
    return np.average(places(stack), axis=(0, 1, 2), weights=_near(excess, stack, center, reach_mm))


def moments(excess: Excess, stack: SliceStack, center: FloatArray, reach_mm: float) -> tuple[FloatArray, float]:
    """Return centroid (mm) and mass (HU x mm3) of what rises above the surroundings near ``center``."""
    mass = float(_near(excess, stack, center, reach_mm).sum()) * stack.pixel_mm**2
    return centroid(excess, stack, center, reach_mm), mass * float(np.diff(stack.positions_mm).mean())


def _near(excess: Excess, stack: SliceStack, center: FloatArray, reach_mm: float) -> Excess:
    return np.where(np.linalg.norm(places(stack) - center, axis=-1) < reach_mm, excess, 0.0)


def ball_stack(diameter_mm: float, spacing_mm: float, thickness_mm: float, **options: object) -> SliceStack:
    """Return slices about `HOME` that hold a ball with a margin."""
    half = diameter_mm / 2 + thickness_mm + 2
    return axial_stack(
        start_mm=-half,
        stop_mm=half,
        spacing_mm=spacing_mm,
        thickness_mm=thickness_mm,
        matrix=160,
        field_of_view_mm=60,
        center_mm=HOME,
        **options,  # type: ignore[arg-type]
    )
