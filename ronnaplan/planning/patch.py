"""A small patch of surface, z(a, b) of third order, as a blurred step in the voxels about it: the model that is fitted.

Its parameters (13,): ten of the height, the levels inside and outside, and the logarithm of the blur.
"""

from __future__ import annotations

import math

import numpy as np

from ronnaplan.geometry import FloatArray

HEIGHTS, INNER, OUTER, BLUR = 10, 10, 11, 12
"""How many parameters describe the height, and which others are the levels and the blur."""

PARAMETERS = BLUR + 1

SLOPE_A, SLOPE_B = 1, 2
"""Those that say how fast the height grows at the patch's middle, with a and with b."""

ROOT = 1.0 / math.sqrt(2.0 * math.pi)


def polynomials(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return what each parameter of a patch's height is multiplied by (10, ...) at ``a``, ``b`` (...)."""
    one, aa, ab, bb = np.ones_like(a), a * a / 2, a * b, b * b / 2
    return np.stack([one, a, b, aa, ab, bb, a * aa / 3, b * aa, a * bb, b * bb / 3])


def heights(terms: FloatArray, h: FloatArray) -> FloatArray:
    """Return the heights (...) of the patch at the places of ``terms`` (10, ...)."""
    z: FloatArray = h[:HEIGHTS] @ terms
    return z


def slopes(terms: FloatArray, h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how fast the height grows with a and with b (...): polynomials in the first six terms."""
    return h[[1, 3, 4, 6, 7, 8]] @ terms[:6], h[[2, 4, 5, 7, 8, 9]] @ terms[:6]


def normal_equations(
    terms: FloatArray, c: FloatArray, values: FloatArray, h: FloatArray, box: float
) -> tuple[float, FloatArray, FloatArray]:
    """Return the squared misfit of ``values`` (N,), and the normal equations' right side and matrix (13, 13).

    ``c`` (N,) is each voxel's place along the third axis, ``terms`` (10, N) those of the other two.
    """
    from scipy.special import ndtr

    inner, outer, blur = h[INNER], h[OUTER], math.exp(min(max(h[BLUR], -3.0), 1.5))
    width = max(box, 0.1 * blur)
    by_a, by_b = slopes(terms, h)
    shrink = 1.0 / np.sqrt(1.0 + by_a**2 + by_b**2)
    distance = (c - heights(terms, h)) * shrink
    high, low = (distance + width / 2) / blur, (distance - width / 2) / blur
    bell_high, bell_low = np.exp(-(high**2) / 2) * ROOT, np.exp(-(low**2) / 2) * ROOT
    area_high, area_low = ndtr(high), ndtr(low)
    share = blur / width * (high * area_high + bell_high - low * area_low - bell_low)
    rate = -(outer - inner) * (area_high - area_low) / width * shrink
    design = np.empty((PARAMETERS, len(values)))
    design[:HEIGHTS] = rate * terms
    design[INNER], design[OUTER] = 1.0 - share, share
    design[BLUR] = (outer - inner) * (bell_high - bell_low) / width * blur
    misfit = values - inner - (outer - inner) * share
    return float(misfit @ misfit), design @ misfit, design @ design.T
