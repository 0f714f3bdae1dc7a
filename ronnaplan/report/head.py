"""A shaded 3-D view of the head by ray casting: needs no graphics hardware and no graphics library."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray

SKIN_HU = -300.0
"""Half way between air and soft tissue."""

PIXEL_MM = 1.5
MARGIN_MM = 8.0
VIEW_DIRECTION = (0.55, 0.75, -0.4)
"""From the eye into the patient, LPS: from the right front, a little from above."""

LIGHT = (-0.35, 0.45, 0.82)
"""Towards the light, in the picture's axes: across, up, to the eye."""

SKIN_COLOUR = np.array([0.93, 0.80, 0.70])
MARKER_COLOUR = np.array([1.0, 0.55, 0.05])


@dataclass(frozen=True)
class HeadView:
    """A picture (H, W, 3) in 0..1 with the frame it is drawn in: rows of ``axes`` are across, up, to the eye."""

    image: FloatArray
    axes: FloatArray
    extent_mm: tuple[float, float, float, float]

    def project(self, points_mm: FloatArray) -> FloatArray:
        """Place points (N, 3) in LPS on the picture: (N, 2) across and up, in mm."""
        projected: FloatArray = points_mm @ self.axes[:2].T
        return projected


def head_view(volume: CTVolume, centers_mm: FloatArray, diameter_mm: float) -> HeadView:
    """Look at the skin and the markers (N, 3) from the right front."""
    axes = _view_axes()
    corners = _corners(volume) @ axes.T
    low, high = corners.min(axis=0) - MARGIN_MM, corners.max(axis=0) + MARGIN_MM
    across, up, depth = (np.arange(a, b, PIXEL_MM) for a, b in zip(low, high, strict=True))
    surface, hit = _first_surface(volume, axes, across, up, depth[::-1])
    places = np.stack([*np.meshgrid(across, up), surface], axis=-1) @ axes
    image = _shade(surface)[..., np.newaxis] * SKIN_COLOUR
    if len(centers_mm):
        distance = np.linalg.norm(places[:, :, np.newaxis] - centers_mm, axis=-1).min(axis=-1)
        marker = distance < diameter_mm / 2 + PIXEL_MM
        image = np.where(marker[..., np.newaxis], _shade(surface)[..., np.newaxis] * MARKER_COLOUR, image)
    image = np.where(hit[..., np.newaxis], image, 0.0)
    rows, columns = (_span(np.asarray(hit.any(axis=axis))) for axis in (1, 0))
    extent = (across[columns][0], across[columns][-1], up[rows][0], up[rows][-1])
    return HeadView(image[rows, columns], axes, extent)


def _span(filled: NDArray[np.bool_]) -> slice:
    """Range of places that holds every filled one, with a little room about it."""
    places = np.flatnonzero(filled)
    if places.size == 0:
        return slice(None)
    room = int(MARGIN_MM / PIXEL_MM)
    return slice(max(0, int(places[0]) - room), int(places[-1]) + room + 1)


def _view_axes() -> FloatArray:
    into = np.array(VIEW_DIRECTION) / np.linalg.norm(VIEW_DIRECTION)
    across = np.cross(into, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(across, into), -into])


def _corners(volume: CTVolume) -> FloatArray:
    ends = [[0, n - 1] for n in volume.voxels_hu.shape]
    return volume.grid.positions_mm(np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 3).astype(np.float64))


def _first_surface(
    volume: CTVolume, axes: FloatArray, across: FloatArray, up: FloatArray, depths: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Depth (up, across) at which each ray first meets something denser than skin, and whether it does."""
    from scipy.ndimage import map_coordinates

    plane = np.stack(np.meshgrid(across, up), axis=-1) @ axes[:2]
    surface = np.full(plane.shape[:2], depths[-1])
    hit = np.zeros(plane.shape[:2], dtype=np.bool_)
    before = np.full(plane.shape[:2], -1024.0)
    for depth in depths:
        open_rays = ~hit
        indices = volume.grid.indices(plane[open_rays] + depth * axes[2])
        values = map_coordinates(volume.voxels_hu, indices.T, output=np.float64, order=1, cval=-1024.0)
        now = np.full_like(before, -1024.0)
        now[open_rays] = values
        fresh = open_rays & (now > SKIN_HU)
        share = (SKIN_HU - before[fresh]) / (now[fresh] - before[fresh])
        surface[fresh] = depth + PIXEL_MM * (1.0 - share)
        hit |= fresh
        before = now
    return surface, hit


def _shade(surface: FloatArray) -> FloatArray:
    """Light (0..1) on a depth map: Lambert's law with a little ambient light."""
    by_up, by_across = np.gradient(surface, PIXEL_MM)
    normal = np.stack([-by_across, -by_up, np.ones_like(surface)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    lambert = np.clip(normal @ (np.array(LIGHT) / np.linalg.norm(LIGHT)), 0.0, 1.0)
    shade: FloatArray = 0.18 + 0.82 * lambert
    return shade
