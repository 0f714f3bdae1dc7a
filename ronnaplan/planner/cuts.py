"""Flat cuts through a scan as grey pictures, and the planes of the views."""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Trajectory
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.scene.cut import Cut, axes_along, axes_beside
from ronnaplan.scene.sampled import values_hu

Shades = NDArray[np.uint8]

Picture = dict[str, Any]
"""A picture as the page takes it: its kind, its bytes, and a number that no other has."""

_NUMBERS = count(1)

BLACKEST_HU = -1e6
"""Stands where there is no voxel: black in any window."""

JPEG_QUALITY = 88

PNG_EFFORT = 1
"""Of zlib's nine: pictures at rest are lossless, and soon there."""

WINDOWS_HU = {
    "bone": (-450.0, 1550.0),
    "brain": (0.0, 80.0),
    "wide": (-1024.0, 3071.0),
    "markers": (-1024.0, 600.0),
}
"""Window presets: the HU shown black and white."""


STANDARD = {
    "axial": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
    "coronal": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])),
    "sagittal": (np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0])),
}
"""Right and down of the three cuts: the patient's left is on the right, as radiologists look."""

HEAD = "head"
"""The 3-D view."""

ACROSS = "probe"
PATH_VIEWS = ("inline", "second", ACROSS)
"""Two cuts that hold the selected trajectory, at right angles, and the one across it, seen along it from outside."""


def path_axes(view: str, trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Return right and down (3,) of a path view; in both that hold it the entry is above, the target below."""
    if view == ACROSS:
        return axes_along(trajectory.inward)
    return axes_beside(trajectory.inward)[PATH_VIEWS.index(view)], trajectory.inward


def picture(scan: SliceSampler, cut: Cut, window_hu: tuple[float, float], shape: tuple[int, int]) -> Shades:
    """Draw ``cut`` through ``scan`` as ``shape`` = (rows, columns) of grey; black where there is no voxel."""
    return shaded(sampled(scan, cut, shape), window_hu)


def sampled(scan: SliceSampler, cut: Cut, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return what ``scan`` holds in a cut (``shape``), in HU: what takes long of a picture, whatever its window."""
    return values_hu(scan, cut, shape, BLACKEST_HU)


def shaded(values_hu: NDArray[np.float32], window_hu: tuple[float, float]) -> Shades:
    """Return values (rows, columns) in HU as grey."""
    low, high = window_hu
    grey = np.clip((values_hu - low) * (255.0 / (high - low)), 0.0, 255.0)
    shades: Shades = grey.astype(np.uint8)
    return shades


def picture_of(kind: str, content: bytes) -> Picture:
    """Return an encoded picture as the page takes it."""
    return {"kind": f"image/{kind}", "bytes": content, "number": next(_NUMBERS)}


def png(shades: Shades) -> bytes:
    """Return a picture without any loss."""
    import cv2

    return bytes(cv2.imencode(".png", shades, [cv2.IMWRITE_PNG_COMPRESSION, PNG_EFFORT])[1])


def jpeg(shades: Shades) -> bytes:
    """Return a picture in few bytes, for as long as something moves."""
    import cv2

    return bytes(cv2.imencode(".jpg", shades, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])
