"""What holds a ball, a post or a screw: sought in nearest voxels, beyond what touches it."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.bounds import METAL_HU
from ronnaplan.ct.volume import CTVolume, Voxels
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.cells import CELL_COUNT, cell_directions
from ronnaplan.localization.fit.depth import margin_mm
from ronnaplan.localization.fit.parameters import RADIUS, WIDTH, W
from ronnaplan.localization.search.nearest import fill_nearest, lookup_of

SCREW_REACH_MM, SCREW_MM, SCREW_STEP_MM = 25.0, 2.0, 0.5
"""A screw is looked for so far beyond the ball, so far beside each direction in every way, in these steps."""

LEAST_HELD = 0.05
"""What touches fewer of a ball's directions than this share does not hold it: noise leaves out single ones."""


@dataclass(frozen=True)
class Beyond:
    """What was found beyond a ball in some ``directions`` (N, 3) in LPS."""

    directions: FloatArray
    of_metal: NDArray[np.bool_]
    """In which of them (N,) metal lies."""
    metal_mm: FloatArray
    """Where it lies (K, 3), from the ball's center."""


def held_by(touching: Beyond) -> tuple[FloatArray, bool]:
    """Return the unit vector (3,) in LPS towards what holds a ball, and whether there is metal in it.

    It is the mean of those directions ``touching`` it in which metal lies, or else of all of them; zero where these are
    too few.
    """
    is_metal = bool(touching.of_metal.any())
    toward = touching.directions[touching.of_metal if is_metal else slice(None)].sum(axis=0)
    length = float(np.linalg.norm(toward))
    holds = length > 0.0 if is_metal else length > LEAST_HELD * CELL_COUNT
    axis: FloatArray = toward / length if holds else np.zeros(3)
    return axis, is_metal


def what_touches(volume: CTVolume, fit: BallFit) -> Beyond:
    """Return what lies beyond a ball in the directions in which something touches it."""
    return metal_beyond(volume, fit, cell_directions()[fit.verdict.state == 0] @ fit.neighbourhood.axes)


def metal_beyond(volume: CTVolume, fit: BallFit, directions: FloatArray) -> Beyond:
    """Look for metal in ``directions`` (N, 3) in LPS beyond a ball; what lies nearer is the ball, or its blur.

    Where the scale ends below metal, what reaches its end may be metal.
    """
    clear_mm, axes, least_hu = _clear_mm(fit), volume.grid.axes, min(METAL_HU, fit.ceiling_hu)
    along = clear_mm + np.arange(0.0, SCREW_REACH_MM, SCREW_STEP_MM)
    beside = SCREW_MM * np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
    towards, beside = (np.ascontiguousarray(some @ axes.T) for some in (directions, beside))
    places, of_metal = _metal_beyond(
        axes @ fit.center_mm, towards, along, beside, clear_mm, least_hu, *lookup_of(volume)
    )
    return Beyond(directions, of_metal, places @ axes)


def is_metal_beyond(volume: CTVolume, fit: BallFit, directions: FloatArray) -> bool:
    """Whether `metal_beyond` finds any in ``directions`` (N, 3) that lie in few slices.

    Most often there is none in the box about all of these, which takes a tenth of the time to tell.
    """
    grid = volume.grid
    farthest_mm = (_clear_mm(fit) + SCREW_REACH_MM) * directions @ grid.axes.T
    steps_mm = np.append(grid.steps_mm, grid.spacings_mm.max())
    beside_mm = math.sqrt(3.0) * SCREW_MM + steps_mm  # to a corner of what is looked at beside each direction
    low_mm = np.minimum(farthest_mm.min(axis=0), 0.0) - beside_mm
    high_mm = np.maximum(farthest_mm.max(axis=0), 0.0) + beside_mm
    first, end = np.searchsorted(grid.slice_positions_mm - fit.center_mm @ grid.normal, [low_mm[W], high_mm[W]])
    if first == end:
        return False
    corners_mm = (grid.origins_mm[first:end] - fit.center_mm) @ grid.axes[:W].T
    begin = np.floor((low_mm[:W] - corners_mm.max(axis=0)) / steps_mm[:W]).astype(np.intp)
    stop = np.ceil((high_mm[:W] - corners_mm.min(axis=0)) / steps_mm[:W]).astype(np.intp)
    columns, rows = (slice(max(one, 0), max(other, 0)) for one, other in zip(begin, stop, strict=True))
    box_hu = volume.voxels_hu[first:end, rows, columns]
    is_metal_there = box_hu.size > 0 and box_hu.max() >= min(METAL_HU, fit.ceiling_hu)
    return bool(is_metal_there and metal_beyond(volume, fit, directions).of_metal.any())


def _clear_mm(fit: BallFit) -> float:
    """How far from a ball's center nothing is the ball, or its blur."""
    return float(fit.theta[RADIUS]) + margin_mm(float(fit.theta[WIDTH]), fit.sigma_mm)


@njit(cache=True, nogil=True)
def _metal_beyond(
    place: FloatArray,
    towards: FloatArray,
    along: FloatArray,
    beside: FloatArray,
    clear: float,
    least: float,
    voxels: Voxels,
    origins: FloatArray,
    steps: FloatArray,
    padding: float,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return offsets (K, 3) from a place with ``least`` HU, and whether any (N,) lies ``towards`` (N, 3) it.

    They are looked for ``along`` each of them, in mm, and ``beside`` (M, 3) that, farther than ``clear`` away.
    """
    room = len(along) * len(beside)
    found, of_metal = np.empty((len(towards) * room, 3)), np.zeros(len(towards), dtype=np.bool_)
    apart, values, total = np.empty((room, 3)), np.empty(room), 0
    for n in range(len(towards)):
        count = 0
        for far in along:
            for b in range(len(beside)):
                square = 0.0
                for a in range(3):
                    apart[count, a] = far * towards[n, a] + beside[b, a]
                    square += apart[count, a] ** 2
                count += square > clear * clear
        fill_nearest(place, apart[:count], voxels, origins, steps, padding, values[:count])
        for m in range(count):
            if values[m] >= least:
                found[total], of_metal[n] = apart[m], True
                total += 1
    return found[:total].copy(), of_metal
