"""A blurred ball: how much of a solid sphere each voxel sees, and how that changes with the ball and the scanner.

A slice through a ball is a pile of discs; each disc blurred by a circular Gaussian is a non-central chi-square
probability with two degrees of freedom (Marcum's Q function, J. Marcum, IRE Trans. IT-6, 1960), and the average over
the slice's profile is a Gauss sum over a few discs. No voxel is resampled: each is evaluated at its true place.

Slice profiles range from the box of an axial scan to the bells of helical and cone-beam ones (W. Kalender, Computed
Tomography, 2011, section 3.3), and the header's thickness is not their width. They are taken as (1 - x^2)^shape on
|x| < 1, the symmetric beta distribution: a box at shape 0, a parabola at 1, nearly a Gaussian from 4 on.

The loops over the voxels stand around everything that is compiled here, and what they call takes numbers only: arrays
handed from one compiled function to another cost more than what is computed of them.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.parameters import BLUR, EDGE, RADIUS, SHAPE, WIDTH, U, V, W

FEW_DISCS, SOME_DISCS = 3, 5
FEW_SPREAD, SOME_SPREAD = 1.0, 2.5
"""So many discs stand for one slice's profile where their radii differ by no more than this many times the blur, which
is everywhere but near the poles: they keep the error below 0.1 % of the contrast."""

POLE_DISCS = (8, 16)
"""Near the poles the discs are spread evenly over the latitude instead: eight up to a width of 0.6 R, sixteen
beyond."""

THIN_SHARE = 0.6
"""Slices are thin beside the ball up to this share of its radius."""

EDGE_REACH = 5.0
"""Distance from the edge, in units of sigma, beyond which a blurred disc is 0 or 1 to within 1e-6."""

_STEP = 1e-4
"""Step of the derivatives of log-gamma."""

_EDGE_STEPS = 200
_CURVATURE_STEPS = 128


@cache
def disc_table() -> FloatArray:
    """Tabulate the blurred unit disc over (curvature, signed edge distance), both in units of sigma.

    Row m holds radius position r = 2 / t - 2 with t = m / steps (so that row 0 is the straight edge), column n
    the distance a - r of the disc's edge from -`EDGE_REACH` to `EDGE_REACH`.
    """
    from scipy.special import chndtr, ndtr  # not scipy.stats, which takes longer to load than a scan

    t = np.arange(1, _CURVATURE_STEPS + 1)[:, np.newaxis] / _CURVATURE_STEPS
    distance = np.linspace(-EDGE_REACH, EDGE_REACH, _EDGE_STEPS + 1)[np.newaxis, :]
    position = 2.0 / t - 2.0
    disc_radius = np.maximum(position + distance, 0.0)
    curved = chndtr(disc_radius**2, 2, position**2)
    return np.ascontiguousarray(np.vstack([ndtr(distance), curved]))


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


@njit(cache=True)
def slice_profile(width: float, shape: float) -> tuple[float, float, float]:
    """Half the profile's support (mm), its height in the middle (1/mm), and its mean of log(1 - x^2)."""
    half = 0.5 * width * math.sqrt((2.0 * shape + 3.0) / 3.0)
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


# Abramowitz & Stegun, Handbook of Mathematical Functions, 9.8.1 to 9.8.4 (errors below 2e-7), highest power first.
_I0_NEAR = (0.0045813, 0.0360768, 0.2659732, 1.2067492, 3.0899424, 3.5156229, 1.0)
_I1_NEAR = (0.00032411, 0.00301532, 0.02658733, 0.15084934, 0.51498869, 0.87890594, 0.5)
_I0_FAR = (
    *(0.00392377, -0.01647633, 0.02635537, -0.02057706, 0.00916281),
    *(-0.00157565, 0.00225319, 0.01328592, 0.39894228),
)
_I1_FAR = (
    *(-0.00420059, 0.01787654, -0.02895312, 0.02282967, -0.01031555),
    *(0.00163801, -0.00362018, -0.03988024, 0.39894228),
)


@njit(cache=True, inline="always")
def _polynomial(coefficients: tuple[float, ...], x: float) -> float:
    total = 0.0
    for coefficient in coefficients:
        total = total * x + coefficient
    return total


@njit(cache=True, error_model="numpy", inline="always")
def _bessel_scaled(x: float) -> tuple[float, float]:
    """exp(-x) I0(x) and exp(-x) I1(x) for x >= 0."""
    if x < 3.75:
        t = (x / 3.75) ** 2
        decay = math.exp(-x)
        return _polynomial(_I0_NEAR, t) * decay, x * _polynomial(_I1_NEAR, t) * decay
    t = 3.75 / x
    root = math.sqrt(x)
    return _polynomial(_I0_FAR, t) / root, _polynomial(_I1_FAR, t) / root


@njit(cache=True, error_model="numpy", inline="always")
def _disc_slopes(r: float, a: float, inverse: float) -> tuple[float, float, float, float, float]:
    """Derivatives of the blurred disc by its radius ``a`` and by the distance ``r`` from its axis, in 1/mm.

    Then what ``edge`` adds to it, -blur d(disc)/d(blur), and the derivatives of that by ``a`` and ``r``.
    """
    apart = (a - r) * inverse
    square = inverse * inverse
    z = r * a * square
    i0, i1 = _bessel_scaled(z)
    density = a * square * math.exp(-0.5 * apart * apart)
    size = (a * a + r * r) * square
    by_a, by_r = density * i0, -density * i1
    added = a * by_a + r * by_r
    return by_a, by_r, added, density * ((2.0 - size) * i0 + 2.0 * z * i1), density * (size * i1 - 2.0 * z * i0)


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
    inverse, reach, support_by_shape = 1.0 / sigma, EDGE_REACH * sigma, 1.0 / (2.0 * shape + 3.0)
    square = radius * radius
    for n in range(len(offsets)):
        shares[n] = 0.0
        du, dv, dw = offsets[n, 0] - theta[U], offsets[n, 1] - theta[V], offsets[n, 2] - theta[W]
        if abs(dw) - half >= radius:
            continue
        r = math.sqrt(du * du + dv * dv)
        nearest, farthest = max(abs(dw) - half, 0.0), abs(dw) + half
        widest = math.sqrt(square - nearest * nearest)
        if r - widest >= reach:
            continue
        at_pole = farthest >= radius
        narrowest = 0.0 if at_pole else math.sqrt(square - farthest * farthest)
        if narrowest - r >= reach:
            shares[n] = 1.0
            continue
        spread = (widest - narrowest) * inverse
        at_pole |= spread > SOME_SPREAD
        south = span = 0.0
        first, count = (0, FEW_DISCS) if spread <= FEW_SPREAD else (FEW_DISCS, SOME_DISCS)
        if at_pole:  # the sum is over the latitude phi (w = R sin phi), in which even the polar cap is smooth
            south = math.asin(max(dw - half, -radius) / radius)
            span = math.asin(min(dw + half, radius) / radius) - south
            count = len(nodes)
        value = by_r = by_radius = by_blur = by_edge = by_w = by_width = by_shape = 0.0
        for q in range(count):
            if at_pole:
                latitude = south + span * nodes[q]
                place = radius * math.sin(latitude)
                a = radius * math.cos(latitude)
                x = (place - dw) / half
                log = math.log(max(1.0 - x * x, 1e-12))
                weight = weights[q] * span * height * a * math.exp(shape * log)
                weight_by_shape = weight * (log - mean_log)
            else:
                place = dw + half * rules[first + q, 0]
                a = math.sqrt(square - place * place)
                weight, weight_by_shape = rules[first + q, 1], rules[first + q, 2]
            distance = (a - r) * inverse
            if distance <= -EDGE_REACH:
                continue
            if distance >= EDGE_REACH:
                value += weight
                by_shape += weight_by_shape
                continue
            x = (distance + EDGE_REACH) * (_EDGE_STEPS / (2.0 * EDGE_REACH))
            y = 2.0 / (r * inverse + 2.0) * _CURVATURE_STEPS
            j = min(int(x), _EDGE_STEPS - 1)
            i = min(int(y), _CURVATURE_STEPS - 1)
            x -= j
            y -= i
            low = table[i, j] * (1.0 - x) + table[i, j + 1] * x
            high = table[i + 1, j] * (1.0 - x) + table[i + 1, j + 1] * x
            by_a, by_distance, added, added_by_a, added_by_distance = _disc_slopes(r, a, inverse)
            disc = low * (1.0 - y) + high * y + edge * added
            by_a = (by_a + edge * added_by_a) * weight / a
            by_distance = (by_distance + edge * added_by_distance) * weight
            value += weight * disc
            by_edge += weight * added
            by_shape += weight_by_shape * disc
            by_r += by_distance
            by_radius += by_a
            by_blur -= r * by_distance + a * a * by_a
            by_w += place * by_a
            by_width -= place * by_a * (place - dw)
        shares[n] = value
        along = -contrast * by_r / max(r, 1e-12)
        jacobian[n, U] += along * du
        jacobian[n, V] += along * dv
        jacobian[n, W] += contrast * by_w
        jacobian[n, RADIUS] += contrast * radius * by_radius
        jacobian[n, BLUR] += contrast * by_blur * inverse
        jacobian[n, EDGE] += contrast * by_edge
        jacobian[n, WIDTH] += contrast * by_width / width
        jacobian[n, SHAPE] += contrast * (by_shape + by_width * support_by_shape)
