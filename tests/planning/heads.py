"""Heads whose scalp, skull and brain are ellipsoids, and the closed forms of what a straight path meets there."""

from __future__ import annotations

from functools import cache
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from phantoms.fast import render
from phantoms.scene import Part, Scene
from phantoms.solids import cylinder, ellipsoid
from phantoms.stack import axial_stack
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Head
from tests.scans import on_grid
from tests.shared import once

SCALP, SKULL, BRAIN = np.array([68.0, 84.0, 80.0]), np.array([63.0, 79.0, 75.0]), np.array([57.0, 73.0, 69.0])
FOOT = np.array([0.0, -84.0, 0.0])

STACKS: dict[str, dict[str, object]] = {
    "plain": {"start_mm": -22, "stop_mm": 90, "spacing_mm": 1.0},
    "tilted": {"start_mm": -22, "stop_mm": 100, "spacing_mm": 2.0, "tilt_deg": 18.5},
    "uneven": {
        "start_mm": 0,
        "stop_mm": 0,
        "spacing_mm": 1.5,
        "positions_mm": -22 + np.cumsum(np.tile([1.5, 1.0, 1.5], 28)),
    },
    "oblique": {
        "start_mm": -35,
        "stop_mm": 95,
        "spacing_mm": 1.5,
        "orientation": Rotation.from_euler("xyz", [12, -15, 25], degrees=True).as_matrix(),
    },
}


def layered_head(*, post: bool = False, wire: bool = False) -> Scene:
    """A head of three ellipsoids about the origin; with a plastic post on the forehead, a metal wire inside."""
    parts = [
        Part(ellipsoid((0, 0, 0), SCALP), "skin"),
        Part(ellipsoid((0, 0, 0), SKULL), "skull"),
        Part(ellipsoid((0, 0, 0), BRAIN), "brain"),
    ]
    if post:
        parts.append(Part(cylinder(FOOT - [0, 9, 0], (0, 1, 0), 20.0, 9.0), "acrylic", "post", embedded=True))
    if wire:
        parts.append(Part(cylinder((20, 0, 10), (0, 1, 0), 20.0, 3.0), "titanium", "wire", embedded=True))
    return Scene(tuple(parts), name="layered head")


@cache
def scanned(stack: str, *, post: bool = False, wire: bool = False) -> Head:
    """The layered head as one of the scans in `STACKS` shows it: blurred, noisy."""
    settings = {"matrix": 256, "field_of_view_mm": 190.0, **STACKS[stack]}
    slices = axial_stack(**settings)  # type: ignore[arg-type]

    def images() -> NDArray[np.int16]:
        # A coarser raster does for surfaces as large as these, and tilted slices take a quarter of the time.
        with patch("phantoms.averages.RASTER_MM", 0.4):
            return render(layered_head(post=post, wire=wire), slices, blur_mm=0.5, noise_hu=10.0, seed=1)

    return Head.of(on_grid(once(f"head_{stack}_{post:d}{wire:d}", images), slices))


def reach(start_mm: FloatArray, outward: FloatArray, half_axes_mm: FloatArray) -> float:
    """Way from inside an ellipsoid to its surface: the positive root of the quadratic."""
    p, d = start_mm / half_axes_mm, outward / half_axes_mm
    a, b, c = d @ d, p @ d, p @ p - 1.0
    return float((-b + np.sqrt(b * b - a * c)) / a)


def normal(place_mm: FloatArray, half_axes_mm: FloatArray) -> FloatArray:
    """Outward unit normal of an ellipsoid at a place on it."""
    gradient = place_mm / half_axes_mm**2
    unit_normal: FloatArray = gradient / np.linalg.norm(gradient)
    return unit_normal


def paths(count: int, seed: int) -> list[tuple[FloatArray, FloatArray]]:
    """Targets in the brain, with unit directions outwards through the upper half of the head."""
    generator = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        outward = generator.normal(size=3)
        outward[2] = abs(outward[2]) + 0.2
        found.append((generator.uniform([-25, -30, 0], [25, 30, 30]), outward / np.linalg.norm(outward)))
    return found
