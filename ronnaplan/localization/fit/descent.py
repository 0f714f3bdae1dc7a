"""The descent of least squares: from a first guess of the model's parameters to the best ones near it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import add_products, expected_gain, solve
from ronnaplan.localization.fit.ball import Discs, discs
from ronnaplan.localization.fit.model import BLOCK, fill_model, leave_over
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.parameters import (
    BLUR,
    CONTRAST,
    EDGE,
    RADIUS,
    SHAPE,
    WIDTH,
    U,
    V,
    W,
)

BLUR_BOUNDS_MM = (0.03, 2.5)
"""In-plane blur of any CT at all, of which photon counting detectors come near 0.06 mm; a fit that ends here is no ball
seen by a scanner."""

BLUR_STEP = 1.5
"""One step changes the blur by no more than this factor: edge enhancement and blur look alike, and from a blur of
nearly nothing no step leads back."""

EDGE_BOUNDS = (-0.45, 5.0)
"""Edge enhancement: from tails that double the blur to an overshoot of half the contrast."""

SHAPE_BOUNDS = (0.0, 5.0)
"""A profile's shape: from a box to what no image can tell from a Gaussian."""

LEAST_RADIUS_MM, LEAST_WIDTH_MM = 0.2, 0.02
"""No ball is smaller, no slice profile narrower: a step beyond would divide by nearly nothing."""

MAX_CONTRAST_HU = 50000.0
"""No marker absorbs more: balls of zirconia of 3 to 6 mm show 35,000 to 44,000 HU, less where they are larger. Where
clipping hides a ball's true contrast, it cannot run away."""

_BOUNDED = {SHAPE: SHAPE_BOUNDS, EDGE: EDGE_BOUNDS, CONTRAST: (-math.inf, MAX_CONTRAST_HU)}
BOUNDS = tuple(_BOUNDED.get(p, (-math.inf, math.inf)) for p in range(CONTRAST + 1))
"""Those of the first parameters, of which some may end at one."""

PRIOR_NOISE_HU = 10.0
"""Noise of a voxel at which the spreads of priors (`guess`, `skin`) are meant: it sets their weight against voxels."""

MAX_STEPS = 40
"""Steps of one descent; a ball needs five to ten, clipped metal up to thirty."""

STEP_TOLERANCE_MM, REST_GAIN = 2e-5, 1e-4
"""A descent ends with a step that moves the center by less than this and gains less than this share of the squared
residuals: a center may be right long before blur and edge are. One that is expected to is not taken."""

LAST_STEP_MM = 1e-3
"""Blur, edge enhancement and profile may look so alike that they never come to rest; the center is told if the last of
all the steps moved it by less than this."""

LOOK_STEPS, LOOK_GAIN = 12, 0.001
"""A look, after which the fit goes on or is given up, ends after so many steps or with one that gains less than this
share of the squared residuals: what is no ball never comes to rest."""


class Effort(NamedTuple):
    """How far a descent goes: so many steps at most, or to one that gains less than this share."""

    steps: int
    least_gain: float
    last_step_mm: float
    """It came to rest, too, if the last of all its steps moved the center by less than this."""


LOOK: Final = Effort(LOOK_STEPS, LOOK_GAIN, LAST_STEP_MM)
WHOLE: Final = Effort(MAX_STEPS, 0.0, LAST_STEP_MM)
BEGIN: Final = Effort(LOOK_STEPS, 0.0, 0.0)
REST: Final = Effort(MAX_STEPS - LOOK_STEPS, 0.0, LAST_STEP_MM)
"""The first steps of the whole, with which most balls come to rest, and what is left of it then."""

FIRST_DAMPING, LEAST_DAMPING, AGAIN_DAMPING = 1e-5, 1e-9, 1e-4
"""Levenberg-Marquardt damping as a share of the matrix's diagonal: at the start of a descent, at least, and at least
after a step that made things worse, for with less the next one is hardly shorter."""

MAX_WANDER = 0.5
"""A fit that moves by more than this share of the radius has left its candidate, and is not pursued."""

MAX_WIDTH_RATIO, MAX_WIDTH_SHARE = 3.0, 0.3
"""The fitted profile stays within this factor of the nominal thickness and this share of the diameter, which a post
along the slices' normal needs before it is left out: no ball explains more."""

HOPELESS_SIZE, HOPELESS_SIZE_MM = 0.15, 0.6
"""A fit whose diameter is off by more than this share of the stated one, and by more than this, is not pursued: on the
way, markers keep to 5 % of it, and are accepted within 6 % or 0.25 mm at most."""


@dataclass(frozen=True)
class Prior:
    """What is known before the voxels are read: ``mean`` (P,) and ``weight`` (P,) in HU^2 per parameter^2.

    ``layer_mm`` says how the marker is made, as in `ronnaplan.localization.build.Build`.
    """

    mean: FloatArray
    weight: FloatArray
    layer_mm: float

    @classmethod
    def of(cls, mean: FloatArray, spread: FloatArray, layer_mm: float) -> Prior:
        """Prior with standard deviations ``spread`` (P,); infinite ones know nothing."""
        return cls(mean, (PRIOR_NOISE_HU / spread) ** 2, layer_mm)

    def extended(self, more: Prior) -> Prior:
        """Add further parameters."""
        mean, weight = np.concatenate([self.mean, more.mean]), np.concatenate([self.weight, more.weight])
        return replace(self, mean=mean, weight=weight)


def descend(
    used: Neighbourhood, theta: FloatArray, prior: Prior, effort: Effort = WHOLE
) -> tuple[FloatArray, bool]:
    """Levenberg-Marquardt from ``theta`` (P,); returns the best parameters (P,) and whether the steps came to rest."""
    return go_on(used, theta, FIRST_DAMPING, prior, effort)[:2]


def go_on(
    used: Neighbourhood, theta: FloatArray, damping: float, prior: Prior, effort: Effort
) -> tuple[FloatArray, bool, float]:
    """Descend from ``theta`` (P,) with the ``damping`` of its last step; returns that of the next one as well."""
    voxels, held = (used.offsets_mm, used.values_hu, used.floors_hu), (prior.mean, prior.weight)
    steps, gain, last_mm = effort
    end_hu = used.ceiling_hu
    return _descend(*voxels, theta, damping, *held, prior.layer_mm, discs(theta), end_hu, steps, gain, last_mm)


@njit(cache=True, nogil=True)
def _descend(
    offsets: FloatArray,
    values: FloatArray,
    floors: FloatArray,
    theta: FloatArray,
    damping: float,
    mean: FloatArray,
    weight: FloatArray,
    layer_mm: float,
    looked_up: Discs,
    ceiling: float,
    steps: int,
    least_gain: float,
    last_step_mm: float,
) -> tuple[FloatArray, bool, float]:
    moved_mm = np.inf
    cost, slope, matrix = _equations(offsets, values, floors, theta, mean, weight, layer_mm, looked_up, ceiling)
    for _ in range(steps):
        trial = theta + _step(matrix, slope, damping, theta)
        if not math.isfinite(trial[U]):  # the equations told nothing
            return theta, False, damping
        _bind(trial, theta)
        moved_mm = max(abs(trial[U] - theta[U]), abs(trial[V] - theta[V]), abs(trial[W] - theta[W]))
        is_still = moved_mm < STEP_TOLERANCE_MM
        if math.sqrt(trial[U] ** 2 + trial[V] ** 2 + trial[W] ** 2) > 2.0 * MAX_WANDER * theta[RADIUS]:
            return trial, False, damping
        if is_still and expected_gain(matrix, slope, trial - theta) < REST_GAIN * cost:
            return theta, True, damping
        new = _equations(offsets, values, floors, trial, mean, weight, layer_mm, looked_up, ceiling)
        if new[0] < cost:
            is_at_rest = cost - new[0] < (REST_GAIN if is_still else least_gain) * cost
            theta = trial
            if is_no_marker(theta, mean):
                return theta, False, damping
            cost, slope, matrix = new
            damping = max(damping / 10.0, LEAST_DAMPING)
        else:
            is_at_rest = is_still
            damping = max(damping * 10.0, AGAIN_DAMPING)
        if is_at_rest:
            return theta, True, damping
    return theta, moved_mm < last_step_mm, damping


@njit(cache=True)
def is_no_marker(theta: FloatArray, stated: FloatArray) -> bool:
    """Whether size or slice profile are farther from what is ``stated`` (P,) than a marker's are, on the way, too."""
    diameter_mm, apart_mm = 2.0 * stated[RADIUS], 2.0 * abs(theta[RADIUS] - stated[RADIUS])
    widest_mm = MAX_WIDTH_RATIO * stated[WIDTH] + MAX_WIDTH_SHARE * diameter_mm
    return bool(theta[WIDTH] > widest_mm or apart_mm > max(HOPELESS_SIZE * diameter_mm, HOPELESS_SIZE_MM))


@njit(cache=True, nogil=True)
def _equations(
    offsets: FloatArray,
    values: FloatArray,
    floors: FloatArray,
    theta: FloatArray,
    mean: FloatArray,
    weight: FloatArray,
    layer_mm: float,
    looked_up: Discs,
    ceiling: float,
) -> tuple[float, FloatArray, FloatArray]:
    """Half the squared residuals of voxels and prior, their gradient (P,) and Gauss-Newton matrix (P, P)."""
    count = len(theta)
    # The last row is what is left over.
    told, products = np.empty((count + 1, BLOCK)), np.zeros((count + 1, count + 1))
    for first in range(0, len(values), BLOCK):
        end = min(first + BLOCK, len(values))
        fill_model(offsets[first:end], theta, layer_mm, *looked_up, told[count], told[:count].T)
        leave_over(values[first:end], floors[first:end], ceiling, told[:count].T, told[count])
        add_products(told, end - first, products)
    slope, cost = weight * (mean - theta), 0.5 * products[count, count]
    for p in range(count):
        cost += 0.5 * slope[p] * (mean[p] - theta[p])
        slope[p] += products[count, p]
    return cost, slope, products[:count, :count] + np.diag(weight)


@njit(cache=True, nogil=True)
def _step(matrix: FloatArray, slope: FloatArray, damping: float, theta: FloatArray) -> FloatArray:
    count = len(slope)
    damped, step = np.empty((count, count + 1)), np.empty(count)
    for p in range(count):
        for q in range(count):
            damped[p, q] = matrix[p, q]
        damped[p, count] = slope[p]
    for p in range(count):
        damped[p, p] += damping * (matrix[p, p] + 1e-9)
        low, high = BOUNDS[p] if p < len(BOUNDS) else (-np.inf, np.inf)
        # What is at its bound and pushes against it stands still; the others move without it.
        if (theta[p] <= low and slope[p] < 0.0) or (theta[p] >= high and slope[p] > 0.0):
            damped[p, :] = 0.0
            damped[:, p] = 0.0
            damped[p, p] = 1.0
    solve(damped, step)
    return step


@njit(cache=True, nogil=True)
def _bind(theta: FloatArray, before: FloatArray) -> None:
    """Keep a step within what a scanner can do, and the blur within reach of what it was: it may not overshoot."""
    blur_mm = min(max(theta[BLUR], before[BLUR] / BLUR_STEP), before[BLUR] * BLUR_STEP)
    theta[BLUR] = min(max(blur_mm, BLUR_BOUNDS_MM[0]), BLUR_BOUNDS_MM[1])
    theta[RADIUS] = max(theta[RADIUS], LEAST_RADIUS_MM)
    theta[WIDTH] = max(theta[WIDTH], LEAST_WIDTH_MM)
    for p in range(len(BOUNDS)):
        theta[p] = min(max(theta[p], BOUNDS[p][0]), BOUNDS[p][1])
