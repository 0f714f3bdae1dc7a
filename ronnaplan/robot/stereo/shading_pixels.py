"""The pixels of a sphere in one image, sector by sector, where its line of sight is the middle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from functools import cache

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.robot.stereo.circles import Image, box_about
from ronnaplan.robot.stereo.shading_compiled import Flags, Integers, gather

ARC_PX = 8.0
FEWEST_SECTORS, MOST_SECTORS = 36, 72
"""The outline is cut into sectors about so long, but no fewer and no more than these."""
OUTWARD_PX, EDGE_PX = 14.0, 6.0
"""How far outside the expected edge pixels are taken, and how far beside it one by one. The blur takes four of them
outside; the others tell the ground, each sector's own, on whose level the edge's place depends."""
MOST_INSIDE = 4000
"""Of those further inside, where brightness changes slowly, about so many are taken at most: means over squares, and
over such of the ground."""

MANY = 20
"""So many pixels share the largest value by no chance."""
RIM_PX, RIM = 12.0, 0.25
"""How deep a sphere's rim is, at least, and as a share of its radius: enough to tell brightness from blur, and not so
deep that what lies across the middle, or shines there, reaches into more than few sectors."""
LIMB_PX = 8.0
"""How far to either side of its edge a sphere's limb is: the blur's reach, and what a ring may be beside it."""


class Part(Enum):
    """What of a sphere is looked at."""

    WHOLE = "whole"
    RIM = "rim"
    """What is not in its middle, and the ground."""
    LIMB = "limb"
    """What is near its edge, inside and outside."""


@dataclass(frozen=True, eq=False)
class Pixels:
    """Places (B, 2), brightness (B) and weights (B), 1 being one pixel's, sector by sector.

    Also where each sector starts (S + 1), and the focal length (px).
    """

    places: FloatArray
    grey: FloatArray
    weights: FloatArray
    starts: Integers
    focal_px: float
    clipped_at: float
    """The brightness of the image's brightest pixels where many of the sphere's share it, as what is brighter reads the
    same; else infinite."""


def pixels_near(
    grey: Image, camera: Camera, axis: FloatArray, across: FloatArray, half_angle: float, part: Part = Part.WHOLE
) -> Pixels:
    """Return the pixels where a sphere of ``half_angle`` (rad) about ``axis`` (3,) is seen, along ``across`` (3, 2).

    Only those of a ``part`` of it are taken.
    """
    focal, radius = camera.focal_px, half_angle * camera.focal_px
    middle = camera.pixels(axis[None])[0]
    scale = 1.1 * radius + OUTWARD_PX + 6
    grid, inverse = _bend()
    rays = camera.rays(middle + scale * grid)
    bend = np.ascontiguousarray(inverse @ ((rays @ across) / (rays @ axis)[:, None] * focal))
    rows, columns = box_about(grey.shape, middle, scale)
    window = np.ascontiguousarray(grey[rows, columns], dtype=np.float64)
    count = int(np.clip(2 * np.pi * radius / ARC_PX, FEWEST_SECTORS, MOST_SECTORS))
    edge = min(EDGE_PX, radius)
    block = int(np.ceil((radius - edge) * np.sqrt(np.pi / MOST_INSIDE)))
    bounds, brightest = (OUTWARD_PX, edge), float(np.nanmax(grey))
    clipped_at = brightest if np.count_nonzero(window == brightest) >= MANY else np.inf
    middle = middle - [columns.start, rows.start]
    gathered = gather(window, bend, middle, scale, radius, bounds, count, max(block, 1), clipped_at)
    found = Pixels(*gathered, focal, clipped_at)
    if part is Part.RIM:
        return beyond(found, np.zeros(2), radius - max(RIM_PX, RIM * radius))
    if part is Part.LIMB:
        return within(beyond(found, np.zeros(2), radius - LIMB_PX), np.zeros(2), radius + LIMB_PX)
    return found


def beyond(pixels: Pixels, middle_px: FloatArray, least_px: float) -> Pixels:
    """Return those of the ``pixels`` that are farther from ``middle_px`` (2,) than ``least_px``."""
    return _those(pixels, np.hypot(*(pixels.places - middle_px).T) > least_px)


def within(pixels: Pixels, middle_px: FloatArray, most_px: float) -> Pixels:
    """Return those of the ``pixels`` that are no farther from ``middle_px`` (2,) than ``most_px``."""
    return _those(pixels, np.hypot(*(pixels.places - middle_px).T) < most_px)


def _those(pixels: Pixels, taken: Flags) -> Pixels:
    starts = np.concatenate([[0], np.cumsum(taken)])[pixels.starts]
    return replace(
        pixels, places=pixels.places[taken], grey=pixels.grey[taken], weights=pixels.weights[taken], starts=starts
    )


@cache
def _bend() -> tuple[FloatArray, FloatArray]:
    """Return a grid (64, 2) and the matrix (10, 64) that fits a cubic polynomial to values there."""
    a, b = (one.ravel() for one in np.meshgrid(*[np.array([-1, -0.9, -0.6, -0.2, 0.2, 0.6, 0.9, 1.0])] * 2))
    terms = [np.ones_like(a), a, a**2, a**3, b, b**2, b**3, a * b, a**2 * b, a * b**2]
    return np.column_stack([a, b]), np.linalg.pinv(np.column_stack(terms))
