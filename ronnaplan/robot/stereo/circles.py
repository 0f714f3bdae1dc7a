"""Where an image may show a bright sphere: circles that edges, dark outside and bright inside, agree on.

Every edge votes for the centers that lie up its gradient; a center is offered when edges all around it support one
radius. Nothing is thresholded by brightness, so that a dim sphere beside bright reflections, one on a sloping ground
and one that merges with its bright base are found as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import SD_PER_DEVIATION, FloatArray
from ronnaplan.robot.stereo.circles_compiled import halved, supporters, votes

SMALLEST_RADIUS_PX = 8.0
"""Smaller circles are stray reflections, or too coarse to measure."""
LARGEST_RADIUS = 0.3
"""As a share of the image's shorter side."""
SMOOTHING_PX = 1.5
"""Standard deviation of the blur under which edges are sought."""
EDGE_SDS = 8.0
"""An edge's gradient is so many standard deviations of the image's noise; half of that where it goes on from one."""
LEAST_NOISE = 1e-3
"""Of the image's range of brightness: parts without noise, as drawn ones, have no edges but drawn ones."""
UNITS = 100
"""The edge detector takes whole numbers: gradients in this part of a standard deviation."""
MOST_EDGES = 4000
"""More edge pixels than these are thinned out evenly."""
CELL_PX = 4
"""Votes are counted in cells of this size, and radii in such steps."""
MOST_CENTERS = 40
"""Places that are looked at closely, those with most votes."""
ANGLES = 48
"""Directions about a center in which its edges are counted."""
LARGEST_ASKEW = 0.2
"""An edge supports a center when its gradient points past it by less than this share of the radius: ellipses do too."""
NEAR = 0.08
"""Edges support one radius when they lie within this share of it (at least a cell)."""
SMALLEST_SUPPORT = 0.5
"""Share of the directions about a center in which edges support its radius, and of its circumference that they are."""

Image = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float64]
"""Grey values (rows, columns)."""


def box_about(shape: tuple[int, ...], middle_px: FloatArray, reach_px: float) -> tuple[slice, slice]:
    """Return which rows and columns of an image of this ``shape`` are within reach of ``middle_px``, column and row."""
    low = np.clip(np.floor(middle_px - reach_px), 0, shape[::-1]).astype(int).tolist()
    high = np.clip(np.ceil(middle_px + reach_px) + 1, low, shape[::-1]).astype(int).tolist()
    return slice(low[1], high[1]), slice(low[0], high[0])


@dataclass(frozen=True, eq=False)
class Circle:
    """A circle that edges support."""

    center_px: FloatArray
    """(2,) column and row."""
    radius_px: float
    support: float
    """Share of the directions about the center in which there are edges."""
    edges_px: FloatArray
    """The edges (N, 2) that support it."""


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edge pixels (N, 2) of the image at half its size, in the whole one's pixels, and the gradients (N, 2) there."""

    places: FloatArray
    gradients: FloatArray
    per_pixel: int
    """Edge pixels that one of these stands for."""
    shape: tuple[int, int]

    @property
    def radii(self) -> FloatArray:
        """The radii that are tried."""
        return np.arange(SMALLEST_RADIUS_PX, LARGEST_RADIUS * min(self.shape), CELL_PX)


def find_circles(grey: Image) -> list[Circle]:
    """Return the circles in ``grey`` (rows, columns), best supported first; no two have about the same center."""
    edges = _edges(grey)
    if len(edges.places) == 0:
        return []
    offered = [_supported(center, edges) for center in _centers(edges)]
    kept: list[Circle] = []
    for circle in sorted((one for one in offered if one), key=lambda one: -one.support):
        if all(np.linalg.norm(circle.center_px - one.center_px) > one.radius_px / 2 for one in kept):
            kept.append(circle)
    return kept


def _edges(grey: Image) -> _Edges:
    import cv2

    half = halved(grey)
    smooth = cv2.GaussianBlur(half, (0, 0), SMOOTHING_PX / 2, dst=half)
    across, down = (cv2.Sobel(smooth, cv2.CV_32F, *which, scale=1 / 8) for which in ((1, 0), (0, 1)))
    noise = SD_PER_DEVIATION * float(np.median(np.abs(across[::4, ::4])))
    noise = max(noise, LEAST_NOISE * float(np.ptp(smooth[::4, ::4])), 1e-12)
    in_sds = [cv2.addWeighted(one, UNITS / noise, one, 0, 0, dtype=cv2.CV_16S) for one in (across, down)]
    mask = cv2.Canny(in_sds[0], in_sds[1], UNITS * EDGE_SDS / 2, UNITS * EDGE_SDS, L2gradient=True)
    shown = cv2.findNonZero(mask)
    x, y = np.empty((2, 0), np.int64) if shown is None else shown.reshape(-1, 2).T
    step = max(-(-len(y) // MOST_EDGES), 1)
    y, x = y[::step], x[::step]
    gradients = np.column_stack([across[y, x], down[y, x]]).astype(np.float64)
    places = np.column_stack([x, y]) * 2 + 0.5
    return _Edges(places.astype(np.float64), gradients, step, (grey.shape[0], grey.shape[1]))


def _centers(edges: _Edges) -> FloatArray:
    """Return the places (N, 2) with most votes in their surroundings, most first."""
    import cv2

    columns, rows = edges.shape[1] // CELL_PX + 1, edges.shape[0] // CELL_PX + 1
    found = votes(edges.places, edges.gradients, edges.radii, rows, columns, CELL_PX)
    smooth = cv2.GaussianBlur(found.astype(np.float32), (0, 0), 1.0)
    peaks = (smooth >= cv2.dilate(smooth, np.ones((3, 3), np.uint8))) & (smooth > 0)
    best = np.argwhere(peaks)[np.argsort(-smooth[peaks])[:MOST_CENTERS]]
    centers: FloatArray = (best[:, ::-1].astype(np.float64) + 0.5) * CELL_PX
    return centers


def _supported(center: FloatArray, edges: _Edges) -> Circle | None:
    """Return the circle about ``center`` that edges in most directions support, if there is one."""
    radii = edges.radii
    facing, distance, supporting, support = supporters(
        center, edges.places, edges.gradients, radii, ANGLES, LARGEST_ASKEW, NEAR, CELL_PX
    )
    circumference = 2 * np.sqrt(2) * radii  # pixels of a circle at half the size that touch at edge or corner
    long = supporting * edges.per_pixel > 0.8 * SMALLEST_SUPPORT * circumference
    enough = np.flatnonzero((support >= SMALLEST_SUPPORT) & long).tolist()
    if not enough:
        return None
    near = {k: facing[np.abs(distance - radii[k]) < max(NEAR * radii[k], CELL_PX)] for k in enough}
    # the limb is sharper than shades within
    best = max(enough, key=lambda k: support[k] * float(np.median(np.hypot(*edges.gradients[near[k]].T))))
    return Circle(center, float(radii[best]), float(support[best]), edges.places[near[best]])
