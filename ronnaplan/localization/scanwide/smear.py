"""Was the head in two places while the gantry turned about it? Then all its markers are smeared alike.

Where slices are made of one whole turn, each edge is seen twice, from either side. Of a head that jumped meanwhile most
edges are seen in both places, so that their middle is where it should be, and nothing is bent (`motion.py`); but they
are blurred along the jump, by p (1 - p) d^2 where it went by d after a share p of the turn. A gantry that turns while
it looks blurs, too, but across the line to its axis, and by the square of the distance from there.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from ronnaplan.geometry import SD_PER_DEVIATION, FloatArray

LEAST_MARKERS = 6
"""The five numbers that are fitted would suit fewer markers by chance."""

LIMIT = 4.0
"""Markers are smeared alike when that is so many standard errors large. Of 48 still scans none shows more than 2.7."""

USUAL_MM2, TURN_SHARE = 0.002, 0.3
"""Standard deviations of what still scans show beside noise: kernels are no circles; and what the turn blurs is told to
first order only, and grows as the square of the distance from the axis but for this share of itself."""

STEEPEST = 1.5
"""A blur that leads out of the slices more steeply than this is not the head's but of thicker slices, from which these
were computed obliquely."""

RIM_MM = 100.0
"""The rim of a head from its middle."""

LARGEST_OFFSET = 1.5
"""The axis of a gantry is no farther from the markers' middle, in rims of a head."""

DOUBTED, ROUNDS = 2.5, 20
"""A marker that is so many standard deviations unlike the others counts half; so often are all weighed anew."""

FITTED: Final = 5
LEAST_SCATTER_MM2: Final = 1e-4


def are_smeared(places_mm: FloatArray, blurs_mm2: FloatArray) -> bool:
    """Tell whether markers at ``places_mm`` (N, 3) along u, v, w are blurred (N, 3, 3) alike, within the slices.

    Markers whose blur is not known (NaN) do not count.
    """
    known = np.isfinite(blurs_mm2).all(axis=(1, 2))
    blurs_mm2 = blurs_mm2[known]
    if len(blurs_mm2) < LEAST_MARKERS:
        return False
    alike_mm2, error_mm2 = _alike(places_mm[known, :2] / RIM_MM, blurs_mm2)
    within_mm2 = 2.0 * math.hypot(*alike_mm2)
    across_mm2 = math.hypot(*np.median(blurs_mm2[:, 2, :2], axis=0))
    return within_mm2 > 2.0 * LIMIT * error_mm2 and across_mm2 < STEEPEST * within_mm2


def _alike(places: FloatArray, blurs_mm2: FloatArray) -> tuple[FloatArray, float]:
    """Return what stretches the blurs along u and along u = v (2,) in all ``places`` (N, 2) alike, and its error, mm^2.

    Fitted beside blur across the line to an axis: ``turn`` times the square of the distance from it, and by its
    products with the axis' place, so that all is linear; robustly, for what touches a marker may disturb its blur.
    """
    x, y = (places - places.mean(axis=0)).T
    none, one = np.zeros_like(x), np.ones_like(x)
    stretch, shear = [one, none, (y * y - x * x) / 2.0, x, -y], [none, one, -x * y, y, x]
    design = np.hstack([stretch, shear]).T
    told = np.concatenate([(blurs_mm2[:, 0, 0] - blurs_mm2[:, 1, 1]) / 2.0, blurs_mm2[:, 0, 1]])
    errors, weights, freedom = one, np.ones(len(told)), len(told) - FITTED
    for _ in range(ROUNDS):
        weighed = design * weights[:, np.newaxis]
        fitted = np.linalg.lstsq(weighed, told * weights)[0]
        left = np.abs(told - design @ fitted)
        turn = max(float(fitted[2]), 0.0)
        u, v = np.clip(fitted[3:] / turn, -LARGEST_OFFSET, LARGEST_OFFSET) if turn > 0.0 else np.zeros(2)
        scatter = SD_PER_DEVIATION * float(np.median(left / np.tile(errors, 2))) * math.sqrt(len(told) / freedom)
        scatter = max(scatter, LEAST_SCATTER_MM2)
        errors = np.hypot(1.0, TURN_SHARE * turn / 2.0 * ((x - u) ** 2 + (y - v) ** 2) / scatter)
        unlike = np.hypot(*left.reshape(2, -1)) / (DOUBTED * scatter * errors)
        weights = np.tile(1.0 / (errors * np.sqrt(1.0 + unlike**2)), 2)
    alike = fitted[:2] - turn * np.array([(v * v - u * u) / 2.0, -u * v])
    student = freedom / (freedom - 2.0)  # few markers tell their scatter badly
    covariance = np.linalg.pinv(weighed.T @ weighed, hermitian=True) * scatter**2 * student
    return alike, math.hypot(math.sqrt((covariance[0, 0] + covariance[1, 1]) / 2.0), USUAL_MM2)
