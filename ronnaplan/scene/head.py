"""A head with its markers from one side, drawn without a screen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.scene.camera import Camera, Picture
from ronnaplan.scene.shapes import Body, ball, joined
from ronnaplan.scene.surfaces import SURFACES_HU, surface

SKIN_COLOUR, MARKER_COLOUR = np.array([0.93, 0.80, 0.70]), np.array([1.0, 0.55, 0.05])

VIEW_DIRECTION = np.array([-0.55, -0.75, 0.4])
"""From the head to the eye, LPS: to the right front, a little above."""

DISTANCE = 1.9
"""How far the eye is from the middle, in the scan's largest extent: a head fills the picture."""

PIXELS = 640
VEIL_MM = 1.0
"""A marker is drawn so much larger, to come out of its own surface among the skin's."""


def bounds_mm(volume: CTVolume) -> tuple[FloatArray, FloatArray]:
    """Return smallest and largest LPS coordinates (3,) of the voxel centers."""
    ends = [[0.0, n - 1.0] for n in volume.voxels_hu.shape]
    corners = volume.grid.positions_mm(np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 3))
    return corners.min(axis=0), corners.max(axis=0)


def head_picture(volume: CTVolume, centers_mm: FloatArray, diameter_mm: float) -> tuple[Picture, Camera]:
    """Draw skin and markers (N, 3); return the picture (P, P, 3), 0 to 1, and the camera that tells what is where."""
    low, high = bounds_mm(volume)
    middle = (low + high) / 2
    away = DISTANCE * float((high - low).max()) / np.linalg.norm(VIEW_DIRECTION)
    camera = Camera(middle + away * VIEW_DIRECTION, middle)
    picture: Picture = np.zeros((PIXELS, PIXELS, 3), dtype=np.float32)
    depths = camera.depths(PIXELS)
    skin: tuple[FloatArray, NDArray[np.int64]] = surface(volume, SURFACES_HU["skin"])
    if len(skin[1]):
        camera.draw(Body.of(*skin), SKIN_COLOUR, picture, depths)
    if len(centers_mm):
        balls = joined([ball(center, diameter_mm / 2 + VEIL_MM) for center in centers_mm])
        camera.draw(balls, MARKER_COLOUR, picture, depths)
    return picture, camera
