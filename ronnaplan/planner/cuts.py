"""Flat cuts through a scan as grey pictures, each voxel taken from where it is: tilt and uneven slices included."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Trajectory
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.scene.cut import Cut

PIXELS = 448
"""Width and height of a picture; the browser stretches it."""

JPEG_QUALITY = 92

LEAST_SLOPE = 1e-9
"""A plane that rises less than this along its rows is level there."""

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

PATH_VIEWS = ("inline", "probe")
"""The cut that holds the selected trajectory, and the one across it, seen along it from outside."""


def path_axes(view: str, trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Return right and down of a path view; in line the entry is above, the target below."""
    inward = trajectory.inward
    side = np.cross(inward, np.eye(3)[np.argmin(np.abs(inward))])
    side /= np.linalg.norm(side)
    return (side, inward) if view == "inline" else (side, np.cross(inward, side))


def jpeg(scan: SliceSampler, cut: Cut, window_hu: tuple[float, float]) -> bytes:
    """Draw ``cut`` through ``scan``; black where there is no voxel."""
    import cv2

    low, high = window_hu
    grey = np.clip((values_hu(scan, cut, low) - low) * (255.0 / (high - low)), 0.0, 255.0)
    return bytes(cv2.imencode(".jpg", grey.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])


def values_hu(scan: SliceSampler, cut: Cut, beyond_hu: float) -> NDArray[np.float32]:
    """Return the values (PIXELS, PIXELS) of the scan in a cut, ``beyond_hu`` where there is no voxel.

    Between two slices a value is interpolated along the way from a voxel to its like in the next slice.
    """
    from scipy.ndimage import map_coordinates

    steps = ((np.arange(PIXELS) + 0.5) / PIXELS - 0.5) * cut.field_mm
    (u0, v0, w0), right, down = (scan.axes @ vector for vector in (cut.center_mm, cut.right, cut.down))
    # Where rows of the picture run along the slices, one number stands for a whole row.
    w = w0 + steps[:, np.newaxis] * down[2] + (steps * right[2] if abs(right[2]) > LEAST_SLOPE else 0.0)
    k = np.interp(w, scan.w_mm, np.arange(len(scan.w_mm)), left=-1.0, right=-1.0)
    origins_u, origins_v = (np.interp(w, scan.w_mm, origin) for origin in scan.origins_uv_mm.T)
    places = np.empty((3, PIXELS, PIXELS))
    places[0] = k
    places[1] = (v0 - origins_v + steps[:, np.newaxis] * down[1] + steps * right[1]) / scan.steps_mm[1]
    places[2] = (u0 - origins_u + steps[:, np.newaxis] * down[0] + steps * right[0]) / scan.steps_mm[0]
    values: NDArray[np.float32] = map_coordinates(
        scan.voxels, places, output=np.float32, order=1, mode="constant", cval=beyond_hu
    )
    return values
