"""The discs that stand for a slice through a ball, piled up within the slice's profile.

Their places and weights are Gauss sums over the profile, or, near the poles, over the latitude.
"""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.parameters import profile_half_mm

FEW_DISCS, SOME_DISCS = 3, 5
FEW_SPREAD, SOME_SPREAD = 1.0, 2.5
"""So many discs stand for one slice's profile where their radii differ by no more than this many times the blur, which
is everywhere but near the poles: they keep the error below 0.1 % of the contrast."""

_STEP = 1e-4
"""Step of the derivatives of log-gamma."""

_half_mm = njit(cache=True)(profile_half_mm)
"""Compiled here: whoever reads parameters only, as what draws answers does, loads no compiler."""


@njit(cache=True)
def slice_profile(width: float, shape: float) -> tuple[float, float, float]:
    """Half the profile's support (mm), its height in the middle (1/mm), and its mean of log(1 - x^2)."""
    half = _half_mm(width, shape)
    mass = math.lgamma(shape + 1.0) - math.lgamma(shape + 1.5)
    above = math.lgamma(shape + 1.0 + _STEP) - math.lgamma(shape + 1.5 + _STEP)
    below = math.lgamma(shape + 1.0 - _STEP) - math.lgamma(shape + 1.5 - _STEP)
    return half, math.exp(-mass) / (math.sqrt(math.pi) * half), (above - below) / (2.0 * _STEP)


@njit(cache=True)
def profile_rules(shape: float) -> FloatArray:
    """Gauss's quadratures for the weight (1 - x^2)^shape on (-1, 1), normalized: `FEW_DISCS` rows, then `SOME_DISCS`.

    Each row (of 8) is a place, its weight, and the weight's derivative by the shape. The nodes are the roots of the
    weight's orthogonal polynomials, in closed form; the weights give the moments of x^2 and x^4 (W. Gautschi,
    Orthogonal Polynomials, 2004, section 1.4).
    """
    rules = np.zeros((FEW_DISCS + SOME_DISCS, 3))
    single = 3.0 / (2.0 * shape + 5.0)
    total = 10.0 / (2.0 * shape + 9.0)
    product = 15.0 / ((2.0 * shape + 7.0) * (2.0 * shape + 9.0))
    root = math.sqrt(0.25 * total * total - product)
    outer, inner = 0.5 * total + root, 0.5 * total - root
    second = 1.0 / (2.0 * shape + 3.0)
    fourth = second * single
    fourth_by_shape = -2.0 * fourth * (second + 1.0 / (2.0 * shape + 5.0))
    moments = ((1.0, second, fourth), (0.0, -2.0 * second * second, fourth_by_shape))
    for column in range(2):
        whole, by_second, by_fourth = moments[column]
        few = 0.5 * by_second / single
        far = 0.5 * (by_fourth - inner * by_second) / (outer * (outer - inner))
        near = 0.5 * (outer * by_second - by_fourth) / (inner * (outer - inner))
        weights = (few, whole - 2.0 * few, few, far, near, whole - 2.0 * (far + near), near, far)
        for row in range(len(weights)):
            rules[row, column + 1] = weights[row]
    rules[0, 0], rules[2, 0] = -math.sqrt(single), math.sqrt(single)
    rules[3, 0], rules[7, 0] = -math.sqrt(outer), math.sqrt(outer)
    rules[4, 0], rules[6, 0] = -math.sqrt(inner), math.sqrt(inner)
    return rules


@njit(cache=True, error_model="numpy", nogil=True)
def lay_out(
    dw: float,
    radius: float,
    sigma: float,
    profile: tuple[float, float, float, float],
    rules: FloatArray,
    nodes: FloatArray,
    weights: FloatArray,
    pile: FloatArray,
) -> tuple[int, float, float]:
    """Fill ``pile`` (4, Q) with the discs that a slice at ``dw`` (mm from the center) sees.

    Their places (mm), radii (mm), weights, and the weights' derivatives by the profile's shape. Returns how many
    they are, and the least and the largest radius within the slice. ``profile``: shape, and what `slice_profile` tells.
    """
    shape, half, height, mean_log = profile
    square = radius * radius
    nearest, farthest = max(abs(dw) - half, 0.0), abs(dw) + half
    widest = math.sqrt(square - nearest * nearest)
    narrowest = 0.0 if farthest >= radius else math.sqrt(square - farthest * farthest)
    spread = (widest - narrowest) / sigma
    if farthest < radius and spread <= SOME_SPREAD:
        first, count = (0, FEW_DISCS) if spread <= FEW_SPREAD else (FEW_DISCS, SOME_DISCS)
        for q in range(count):
            place = dw + half * rules[first + q, 0]
            pile[0, q], pile[1, q] = place, math.sqrt(square - place * place)
            pile[2, q], pile[3, q] = rules[first + q, 1], rules[first + q, 2]
        return count, narrowest, widest
    # The sum is over the latitude phi (w = R sin phi), in which even the polar cap is smooth.
    south = math.asin(max(dw - half, -radius) / radius)
    span = math.asin(min(dw + half, radius) / radius) - south
    for q in range(len(nodes)):
        latitude = south + span * nodes[q]
        place, a = radius * math.sin(latitude), radius * math.cos(latitude)
        x = (place - dw) / half
        log = math.log(max(1.0 - x * x, 1e-12))
        weight = weights[q] * span * height * a * math.exp(shape * log)
        pile[0, q], pile[1, q], pile[2, q], pile[3, q] = place, a, weight, weight * (log - mean_log)
    return len(nodes), narrowest, widest
