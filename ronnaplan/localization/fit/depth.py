"""How deep inside a ball or far outside of it voxels are, beside the blur of its edge there, and what they tell."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.parameters import BLUR, LEAST_SPREAD_MM2, RADIUS, WIDTH, U, V, W

SURFACE_BLURS = 2.0
"""The ball's blurred edge reaches so many times its blur to either side of the surface."""

REACH_BLURS, REACH_MM = 3.0, 0.5
"""The fit reaches so many times the blur and so much farther: beyond is what else is there, deep inside may be a metal
insert."""

TYPICAL_BLUR_MM = 0.5
"""Where the search for the in-plane blur begins; CT kernels lie between 0.25 and 0.9 mm."""

ROUNDED = 1.0 + 1e-9
"""Bounds are as much wider, so that rounding leaves nothing out."""


def margin_mm(thickness_mm: float, sigma_mm: float = TYPICAL_BLUR_MM) -> float:
    """How far beyond the ball's surface its blur can be seen."""
    return 3.0 * sigma_mm + 0.6 * thickness_mm


@njit(cache=True, nogil=True)
def edge_depth(offsets_mm: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distance outward from the surface (N,) and the blur across the surface there (N,), both in mm."""
    depth, blur = np.empty(len(offsets_mm)), np.empty(len(offsets_mm))
    for n in range(len(offsets_mm)):
        u, v, w = offsets_mm[n, U] - theta[U], offsets_mm[n, V] - theta[V], offsets_mm[n, W] - theta[W]
        depth[n], blur[n] = depth_and_blur(u, v, w, theta)
    return depth, blur


@njit(cache=True, nogil=True)
def depth_and_blur(u: float, v: float, w: float, theta: FloatArray) -> tuple[float, float]:
    """Return what `edge_depth` does, of one place, ``u``, ``v`` and ``w`` mm from the center."""
    square = u * u + v * v + w * w
    along = w * w / max(square, 1e-18)
    spread = theta[BLUR] ** 2 * (1.0 - along) + theta[WIDTH] ** 2 / 12.0 * along
    return math.sqrt(square) - theta[RADIUS], math.sqrt(spread + LEAST_SPREAD_MM2)


@njit(cache=True, nogil=True)
def reach_mm(blur: float) -> float:
    """How far from the surface the fit reaches where that is blurred so, in mm."""
    return REACH_BLURS * blur + REACH_MM


@njit(cache=True, nogil=True)
def squares_within_reach(theta: FloatArray) -> tuple[float, float]:
    """Squared distances from the center that all places within the fit's reach lie between, in mm^2.

    Half of the voxels around a candidate lie beyond, which takes no roots to tell.
    """
    widest = math.sqrt(max(theta[BLUR] ** 2, theta[WIDTH] ** 2 / 12.0) + LEAST_SPREAD_MM2)
    reach = ROUNDED * reach_mm(widest)
    nearest = theta[RADIUS] - reach
    return (nearest * nearest if nearest > 0.0 else -1.0), (theta[RADIUS] + reach) ** 2


def on_surface(depth: FloatArray, blur: FloatArray) -> NDArray[np.bool_]:
    """Voxels (N,) in the blurred edge of the ball, where the center is told; by what `edge_depth` returns."""
    near: NDArray[np.bool_] = np.abs(depth) < SURFACE_BLURS * blur
    return near


def within_reach(depth: FloatArray, blur: FloatArray) -> NDArray[np.bool_]:
    """Voxels (N,) near the surface: farther out is what else is there, deep inside may be a metal insert."""
    near: NDArray[np.bool_] = np.abs(depth) < REACH_BLURS * blur + REACH_MM
    return near


def deep_inside(depth: FloatArray, blur: FloatArray) -> NDArray[np.bool_]:
    """Voxels (N,) within the fit's reach, but inside the ball's blur: they show what is in the ball."""
    near: NDArray[np.bool_] = within_reach(depth, blur) & (depth < -SURFACE_BLURS * blur)
    return near
