"""What is known before a ball is fitted: first guesses of the model's parameters, and how firmly they hold."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.descent import Prior
from ronnaplan.localization.directions import BACKGROUND_QUANTILE
from ronnaplan.localization.model import PARAMETERS, STREAK_PARAMETERS, has_streaks
from ronnaplan.localization.neighbourhood import Neighbourhood

TYPICAL_BLUR_MM = 0.5
"""Where the search for the in-plane blur begins; CT kernels lie between 0.25 and 0.9 mm."""

RADIUS_PRIOR = 0.1
"""Standard deviation of the radius about the stated one, as a share of it: the data decide unless they cannot."""

THICKNESS_PRIOR = 0.3
"""Standard deviation of the effective slice thickness about the nominal one, as a share of it."""

SLOPE_PRIOR_PER_MM = 0.01
"""Standard deviation of the background's slope, as a share of the contrast: streaks and cupping reach half of it."""

METAL_HU = 6000.0
"""A ball with more contrast is metal and has streaks; the densest ceramics reach some 5000 HU."""

STREAK_PRIOR = 0.1
"""Standard deviation of the streaks' brightness at the surface, as a share of the contrast."""

METAL_SLOPE_HOLD_MM2 = 1500.0
"""What slopes beside metal are its streaks, which never just slope, so the slope is held near none, as by one voxel at
39 mm or by 1500 at 1 mm."""

FROZEN_WEIGHT = 1e15
"""Weight (HU^2 per mm^2) against which no data move a parameter."""

CLIPPED_RADIUS_HOLD = 15.0
"""Where the inside is clipped, size and contrast look alike, and only the stated size tells them apart: a radius that
is off by this fraction of itself (a fifteenth) weighs as much as one voxel that is off by the contrast."""

CLIPPED_START = 2.0
"""Where the inside is clipped, the search for the true contrast begins at this many times the visible one."""


def margin_mm(thickness_mm: float, sigma_mm: float = TYPICAL_BLUR_MM) -> float:
    """How far beyond the ball's surface its blur can be seen."""
    return 3.0 * sigma_mm + 0.6 * thickness_mm


def first_guess(around: Neighbourhood, diameter_mm: float, thickness_mm: float, ceiling_hu: float) -> FloatArray:
    """First guess: the stated size, the candidate's centre, and levels read off the inside and the outside."""
    distance = np.linalg.norm(around.offsets_mm, axis=1)
    inside = around.values_hu[distance < 0.3 * diameter_mm]
    outside = around.values_hu[distance > 0.5 * diameter_mm + TYPICAL_BLUR_MM]
    high = float(np.median(inside)) if inside.size else float(around.values_hu.max())
    low = float(np.quantile(outside, BACKGROUND_QUANTILE)) if outside.size else float(around.values_hu.min())
    contrast = max(high - low, 1.0) * (CLIPPED_START if high >= ceiling_hu else 1.0)
    streaks = [0.0] * len(STREAK_PARAMETERS) if contrast > METAL_HU else []
    return np.array(
        [0, 0, 0, diameter_mm / 2, TYPICAL_BLUR_MM, thickness_mm, contrast, low, 0, 0, 0, *streaks], np.float64
    )


def ball_prior(start: FloatArray, *, is_clipped: bool) -> Prior:
    """How firmly the first guesses ``start`` hold; where the ball's inside ``is_clipped``, its size does."""
    spread = np.full(len(start), np.inf)
    spread[3], spread[5] = RADIUS_PRIOR * start[3], THICKNESS_PRIOR * start[5]
    spread[8:11] = SLOPE_PRIOR_PER_MM * start[6]
    spread[len(PARAMETERS) :] = STREAK_PRIOR * start[6]
    prior = Prior.of(np.where(np.isfinite(spread), start, 0.0), spread)
    if has_streaks(start):
        prior.weight[8:11] = METAL_SLOPE_HOLD_MM2
    if is_clipped:
        prior.weight[3] = (CLIPPED_RADIUS_HOLD * start[6] / start[3]) ** 2
    return prior


def frozen(prior: Prior, start: FloatArray) -> Prior:
    """Hold radius, blur and thickness at their first guesses, so that the centre finds its place first."""
    weight = prior.weight.copy()
    weight[3:6] = FROZEN_WEIGHT
    return Prior(np.where(weight == FROZEN_WEIGHT, start, prior.mean), weight)
