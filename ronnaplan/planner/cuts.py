"""Flat cuts through a scan as grey pictures, each voxel taken from where it is: tilt and uneven slices included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Trajectory
from ronnaplan.planning.sampling import Scan

PIXELS = 448
"""Width and height of a picture; the browser stretches it."""

JPEG_QUALITY = 92

WINDOWS_HU = {
    "bone": (-450.0, 1550.0),
    "brain": (0.0, 80.0),
    "wide": (-1024.0, 3071.0),
    "markers": (-1024.0, 600.0),
}
"""Window presets: the HU shown black and white."""


@dataclass(frozen=True, eq=False)
class Cut:
    """A plane seen from one side: unit vectors ``right`` and ``down`` (3,) on the screen, in LPS.

    ``centre_mm`` (3,) is in the middle of the picture, which is ``field_mm`` wide and high.
    """

    right: FloatArray
    down: FloatArray
    centre_mm: FloatArray
    field_mm: float

    @property
    def away(self) -> FloatArray:
        """Unit vector (3,) from the eye into the screen."""
        away: FloatArray = np.cross(self.right, self.down)
        return away

    def place_mm(self, across_mm: float, down_mm: float) -> FloatArray:
        """Return the place (3,) in LPS at a distance from the middle of the picture."""
        place: FloatArray = self.centre_mm + across_mm * self.right + down_mm * self.down
        return place

    def on_screen_mm(self, places_mm: FloatArray) -> FloatArray:
        """Return places (..., 3) as (..., 3): across and down from the middle, and away from the eye."""
        seen: FloatArray = (places_mm - self.centre_mm) @ np.stack([self.right, self.down, self.away]).T
        return seen


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


def jpeg(scan: Scan, cut: Cut, window_hu: tuple[float, float]) -> bytes:
    """Draw ``cut`` through ``scan``; black where there is no voxel."""
    import cv2

    step = cut.field_mm / PIXELS
    first = cut.place_mm(-(cut.field_mm - step) / 2, -(cut.field_mm - step) / 2)
    picture = np.zeros((PIXELS, PIXELS), dtype=np.uint8)
    axes = scan.axes
    low, high = window_hu
    _fill(
        scan.voxels,
        scan.origins_uv_mm,
        scan.w_mm,
        scan.steps_mm,
        axes @ first,
        axes @ (step * cut.right),
        axes @ (step * cut.down),
        low,
        255.0 / (high - low),
        picture,
    )
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _fill(voxels, origins, w_mm, steps, first, right, down, low, gain, picture):  # type: ignore[no-untyped-def]
    slices, rows, columns = voxels.shape
    k = 0
    for y in range(picture.shape[0]):
        for x in range(picture.shape[1]):
            w = first[2] + y * down[2] + x * right[2]
            if not w_mm[0] <= w <= w_mm[slices - 1]:
                continue
            while k > 0 and w < w_mm[k]:
                k -= 1
            while k < slices - 2 and w > w_mm[k + 1]:
                k += 1
            share = (w - w_mm[k]) / (w_mm[k + 1] - w_mm[k])
            u = first[0] + y * down[0] + x * right[0]
            v = first[1] + y * down[1] + x * right[1]
            value = 0.0
            for n in range(2):
                i = (u - origins[k + n, 0]) / steps[0]
                j = (v - origins[k + n, 1]) / steps[1]
                if not (0.0 <= i <= columns - 1 and 0.0 <= j <= rows - 1):
                    value = low
                    break
                a, b = min(int(i), columns - 2), min(int(j), rows - 2)
                p, q = i - a, j - b
                upper = (1.0 - p) * voxels[k + n, b, a] + p * voxels[k + n, b, a + 1]
                lower = (1.0 - p) * voxels[k + n, b + 1, a] + p * voxels[k + n, b + 1, a + 1]
                value += (share if n else 1.0 - share) * ((1.0 - q) * upper + q * lower)
            grey = (value - low) * gain
            picture[y, x] = min(max(grey, 0.0), 255.0)
