"""A blurred ball: how much of a solid sphere each voxel sees, and how that changes with the ball and the scanner.

A slice through a ball is a pile of blurred discs (`fit.disc`), and the average over the slice's
profile is a Gauss sum over a few of them. No voxel is resampled: each is evaluated at its true place.

Slice profiles range from the box of an axial scan to the bells of helical and cone-beam ones (W. Kalender, Computed
Tomography, 2011, section 3.3), and the header's thickness is not their width. They are taken as (1 - x^2)^shape on
|x| < 1, the symmetric beta distribution: a box at shape 0, a parabola at 1, nearly a Gaussian from 4 on.

All voxels of a slice see the same discs, so these are laid out once a slice; the blurred disc and its derivatives are
looked up, for each voxel and disc, in one table.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.disc import CURVATURE_STEPS, EDGE_REACH, EDGE_STEPS, disc_table
from ronnaplan.localization.fit.parameters import BLUR, EDGE, RADIUS, SHAPE, WIDTH, U, V, W, profile_half_mm

FEW_DISCS, SOME_DISCS = 3, 5
FEW_SPREAD, SOME_SPREAD = 1.0, 2.5
"""So many discs stand for one slice's profile where their radii differ by no more than this many times the blur, which
is everywhere but near the poles: they keep the error below 0.1 % of the contrast."""

POLE_DISCS = (8, 16)
"""Near the poles the discs are spread evenly over the latitude instead: eight up to a width of 0.6 R, sixteen
beyond."""

THIN_SHARE = 0.6
"""Slices are thin beside the ball up to this share of its radius."""

_STEP = 1e-4
"""Step of the derivatives of log-gamma."""

Discs = tuple[FloatArray, FloatArray, FloatArray]
"""What the compiled functions look up: the table of blurred discs, and places and weights of the discs at the poles."""


def discs(theta: FloatArray) -> Discs:
    """Return what evaluates a ball of these parameters (P,) accurately."""
    is_thin = bool(theta[WIDTH] <= THIN_SHARE * theta[RADIUS])
    return (disc_table(), *_pole_nodes(POLE_DISCS[0] if is_thin else POLE_DISCS[1]))


@cache
def _pole_nodes(count: int) -> tuple[FloatArray, FloatArray]:
    """Positions (as a share of the latitudes within the slice, 0 to 1) and weights of a slice's discs."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (nodes + 1.0) / 2.0, weights / 2.0


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
def _lay_out(
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


@njit(cache=True, error_model="numpy", nogil=True, inline="always")  # a call would take a tenth longer
def _looked_up(
    table: FloatArray, i: int, y: float, distance: float
) -> tuple[float, float, float, float, float, float, float]:
    """Return the figures of a disc from the ``table``, beyond its row ``i`` by ``y``, so many blurs inside its edge."""
    x = (distance + EDGE_REACH) * (EDGE_STEPS / (2.0 * EDGE_REACH))
    j = min(int(x), EDGE_STEPS - 1)
    x -= j
    low, high, far_low, far_high = table[i, j], table[i, j + 1], table[i + 1, j], table[i + 1, j + 1]
    c00, c01, c10, c11 = (1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y
    return (
        c00 * low[0] + c01 * high[0] + c10 * far_low[0] + c11 * far_high[0],
        c00 * low[1] + c01 * high[1] + c10 * far_low[1] + c11 * far_high[1],
        c00 * low[2] + c01 * high[2] + c10 * far_low[2] + c11 * far_high[2],
        c00 * low[3] + c01 * high[3] + c10 * far_low[3] + c11 * far_high[3],
        c00 * low[4] + c01 * high[4] + c10 * far_low[4] + c11 * far_high[4],
        c00 * low[5] + c01 * high[5] + c10 * far_low[5] + c11 * far_high[5],
        c00 * low[6] + c01 * high[6] + c10 * far_low[6] + c11 * far_high[6],
    )


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def add_ball(
    offsets: FloatArray,
    theta: FloatArray,
    radius: float,
    contrast: float,
    table: FloatArray,
    nodes: FloatArray,
    weights: FloatArray,
    shares: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Fill ``shares`` (N,) with a blurred ball (0 outside, 1 inside) of ``radius`` mm about ``theta``'s center.

    Its derivatives by the first `SHAPED` parameters, times ``contrast``, are added to ``jacobian`` (N, P).
    """
    sigma, edge, width, shape = theta[BLUR], theta[EDGE], theta[WIDTH], theta[SHAPE]
    half, height, mean_log = slice_profile(width, shape)
    rules = profile_rules(shape)
    pile = np.empty((4, max(len(nodes), SOME_DISCS)))
    inverse, reach, support_by_shape = 1.0 / sigma, EDGE_REACH * sigma, 1.0 / (2.0 * shape + 3.0)
    latest_w, count, narrowest, widest = math.nan, 0, 0.0, 0.0
    for n in range(len(offsets)):
        shares[n] = 0.0
        du, dv, dw = offsets[n, 0] - theta[U], offsets[n, 1] - theta[V], offsets[n, 2] - theta[W]
        if abs(dw) - half >= radius:
            continue
        if dw != latest_w:
            profile = (shape, half, height, mean_log)
            count, narrowest, widest = _lay_out(dw, radius, sigma, profile, rules, nodes, weights, pile)
            latest_w = dw
        r = math.sqrt(du * du + dv * dv)
        if r - widest >= reach:
            continue
        if narrowest - r >= reach:
            shares[n] = 1.0
            continue
        y = 2.0 * CURVATURE_STEPS / (r * inverse + 2.0)
        i = min(int(y), CURVATURE_STEPS - 1)
        y -= i
        value = by_r = by_radius = by_blur = by_edge = by_w = by_width = by_shape = 0.0
        for q in range(count):
            place, a, weight, weight_by_shape = pile[0, q], pile[1, q], pile[2, q], pile[3, q]
            distance = (a - r) * inverse
            if distance <= -EDGE_REACH:
                continue
            if distance >= EDGE_REACH:
                value += weight
                by_shape += weight_by_shape
                continue
            disc, disc_by_a, disc_by_r, along, along_by_a, along_by_r, twice_along = _looked_up(
                table, i, y, distance
            )
            disc += edge * along
            by_a = weight * (disc_by_a + edge * along_by_a)
            value += weight * disc
            by_edge += weight * along
            by_shape += weight_by_shape * disc
            by_r += weight * (disc_by_r + edge * along_by_r)
            by_radius += by_a
            by_blur -= weight * (along + edge * twice_along)
            by_w += place * by_a
            by_width -= place * by_a * (place - dw)
        shares[n] = value
        beside = -contrast * inverse * by_r / max(r, 1e-12)
        square_inverse = contrast * inverse * inverse
        jacobian[n, U] += beside * du
        jacobian[n, V] += beside * dv
        jacobian[n, W] += square_inverse * by_w
        jacobian[n, RADIUS] += square_inverse * radius * by_radius
        jacobian[n, BLUR] += contrast * by_blur * inverse
        jacobian[n, EDGE] += contrast * by_edge
        jacobian[n, WIDTH] += square_inverse * by_width / width
        jacobian[n, SHAPE] += contrast * by_shape + square_inverse * by_width * support_by_shape
