"""What is known before a ball is fitted: first guesses of the model's parameters, and how firmly they hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.fit.algebra import quantile
from ronnaplan.localization.fit.cells import BACKGROUND_QUANTILE
from ronnaplan.localization.fit.depth import TYPICAL_BLUR_MM
from ronnaplan.localization.fit.descent import Prior
from ronnaplan.localization.fit.model import METAL_CONTRAST_HU, has_layer, has_streaks
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.parameters import (
    BLUR,
    CONTRAST,
    EDGE,
    PARAMETERS,
    RADIUS,
    SHAPE,
    SHAPED,
    SLOPES,
    STREAK_PARAMETERS,
    WIDTH,
)

SHARP_BLUR_PIXELS = 1.5
"""Where pixels are so small that this many are less, it begins there as well: a photon counting detector's kernels, for
which pixels are made small, lie near 0.1 mm, and beside skin a small ball is not seen for what it is with 0.5."""

RADIUS_PRIOR = 0.1
"""Standard deviation of the radius about the stated one, as a share of it: the data decide unless they cannot."""

WIDTH_PRIOR = 0.5
"""Standard deviation of the slice profile's width about the nominal thickness, as a share of it."""

EDGE_PRIOR, METAL_EDGE_PRIOR = 0.5, 0.05
"""Standard deviation of the edge enhancement; where metal is clipped, it looks like size and contrast."""

SHAPE_PRIOR = (1.0, 1.5)
"""Mean and standard deviation of the profile's shape: between a box and a bell."""

SLOPE_PRIOR_PER_MM = 0.01
"""Standard deviation of the background's slope, as a share of the contrast: streaks and cupping reach half of it."""

LAYER_PRIOR = 0.5
"""Standard deviation of the level of a cavity or wrapping, as a share of the contrast."""

STREAK_PRIOR = 0.1
"""Standard deviation of the streaks' brightness at the surface, as a share of the contrast."""

METAL_SLOPE_HOLD_MM2 = 1500.0
"""What slopes beside metal are its streaks, which never just slope, so the slope is held near none, as by one voxel at
39 mm or by 1500 at 1 mm."""

MIDWAY = (0.2, 0.4)
"""The ball's own level is read off between these distances from the candidate, as shares of the diameter: nearer to it
there may be an insert, farther out there is the blurred edge."""

WALL_QUANTILE = 0.8
"""Where a candidate is aside by a shell's wall, half of what should be wall is not: its level is read off the rest."""

FROZEN_WEIGHT = 1e15
"""Weight (HU^2 per mm^2) against which no data move a parameter."""

CLIPPED_RADIUS_HOLD = 15.0
"""Where the inside is clipped, size and contrast look alike, and only the stated size tells them apart: a radius that
is off by this fraction of itself (a fifteenth) weighs as much as one voxel that is off by the contrast."""

CLIPPED_START = 2.0
"""Where the inside is clipped, the search for the true contrast begins at this many times the visible one."""


def first_guess(around: Neighbourhood, diameter_mm: float, build: Build, thickness_mm: float) -> FloatArray:
    """First guess (P,): the stated size, the candidate's center, and levels read off the inside and the outside."""
    high, low = _levels(around, diameter_mm, build)
    contrast = max(high - low, 1.0) * (CLIPPED_START if high >= around.ceiling_hu else 1.0)
    layer = [-contrast if build.wall_mm else 0.0] if build.layer_mm else []
    streaks = [0.0] * len(STREAK_PARAMETERS) if contrast > METAL_CONTRAST_HU else []
    ball = [0, 0, 0, diameter_mm / 2, TYPICAL_BLUR_MM, 0.0, thickness_mm, SHAPE_PRIOR[0], contrast, low]
    return np.array([*ball, 0, 0, 0, *layer, *streaks], np.float64)


def _levels(around: Neighbourhood, diameter_mm: float, build: Build) -> tuple[float, float]:
    """Return how bright (HU) the ball itself, or a hollow one's wall, is where it can be told, and the background."""
    distance = around.distances_mm
    shell_mm = np.array(MIDWAY) * diameter_mm
    if build.wall_mm:
        shell_mm = (
            diameter_mm / 2 - build.wall_mm / 2 + np.array([-0.5, 0.5]) * max(build.wall_mm, TYPICAL_BLUR_MM)
        )
    inside = around.values_hu[(distance > shell_mm[0]) & (distance < shell_mm[1])]
    outside = around.values_hu[distance > diameter_mm / 2 + max(build.layer_mm, 0.0) + TYPICAL_BLUR_MM]
    if not inside.size:
        high = float(around.values_hu.max())
    else:
        high = quantile(inside, WALL_QUANTILE if build.wall_mm else 0.5)
    low = quantile(outside, BACKGROUND_QUANTILE) if outside.size else float(around.values_hu.min())
    return high, low


def first_guesses(start: FloatArray, pixel_mm: float) -> list[FloatArray]:
    """Return the guesses (P,) to begin with, for pixels of this size: ``start``, and a sharper one for small ones."""
    sharp = start.copy()
    sharp[BLUR] = SHARP_BLUR_PIXELS * pixel_mm
    return [start, sharp] if sharp[BLUR] < start[BLUR] else [start]


def ball_prior(start: FloatArray, build: Build, *, is_clipped: bool) -> Prior:
    """How firmly the first guesses ``start`` (P,) hold; where the ball's inside ``is_clipped``, its size does."""
    spread = np.full(len(start), np.inf)
    spread[RADIUS], spread[WIDTH] = RADIUS_PRIOR * start[RADIUS], WIDTH_PRIOR * start[WIDTH]
    spread[SHAPE] = SHAPE_PRIOR[1]
    spread[EDGE] = METAL_EDGE_PRIOR if has_streaks(start) or is_clipped else EDGE_PRIOR
    spread[SLOPES] = SLOPE_PRIOR_PER_MM * start[CONTRAST]
    if has_layer(start):
        spread[len(PARAMETERS)] = LAYER_PRIOR * start[CONTRAST]
    if has_streaks(start):
        spread[-len(STREAK_PARAMETERS) :] = STREAK_PRIOR * start[CONTRAST]
    prior = Prior.of(np.where(np.isfinite(spread), start, 0.0), spread, build.layer_mm)
    if has_streaks(start):
        prior.weight[SLOPES] = METAL_SLOPE_HOLD_MM2
    if is_clipped:
        prior.weight[RADIUS] = (CLIPPED_RADIUS_HOLD * start[CONTRAST] / start[RADIUS]) ** 2
    return prior


def frozen(prior: Prior, start: FloatArray) -> Prior:
    """Hold radius, blur and the profile at their first guesses, so that the center finds its place first."""
    weight = prior.weight.copy()
    weight[RADIUS:SHAPED] = FROZEN_WEIGHT
    return replace(prior, mean=np.where(weight == FROZEN_WEIGHT, start, prior.mean), weight=weight)


def steady(prior: Prior, start: FloatArray) -> Prior:
    """Hold the background's slope besides, which what stands on one side of the ball would be taken for."""
    held = frozen(prior, start)
    weight = held.weight.copy()
    weight[SLOPES] = FROZEN_WEIGHT
    return replace(held, weight=weight)
