"""What a ball looks like in CT: a solid sphere seen through the scanner's blur.

The scanner blurs within the slice plane by a point-spread function that is nearly Gaussian (standard deviation
``blur``). Kernels that overshoot at edges, or have long tails, are the next term of its expansion: ``edge`` times
-blur dG/d(blur), so that the transfer function is the Gaussian's times 1 + edge (2 pi f blur)^2. Across the slices it
blurs by its slice profile. A slice through a ball is a pile of discs; each disc blurred by a circular Gaussian is a
non-central chi-square probability with two degrees of freedom (Marcum's Q function, J. Marcum, IRE Trans. IT-6, 1960),
and the average over the profile is a Gauss-Legendre sum over the discs. No voxel is resampled: the model is evaluated
at each voxel's true place.

Slice profiles range from the box of an axial scan to the bells of helical and cone-beam ones (W. Kalender, Computed
Tomography, 2011, section 3.3), and the header's thickness is not their width. The model takes them as (1 - x^2)^shape
on |x| < 1, the symmetric beta distribution: a box at shape 0, a parabola at 1, nearly a Gaussian from 4 on.

Coordinates here are those of the slices: u along the rows, v down the columns, w along the normal, in mm.

(What calls these compiled functions stands in this file, too: numba's cache on disk notices a change in the caller's
own file only.)
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.parameters import (
    BACKGROUND,
    BLUR,
    CONTRAST,
    EDGE,
    LAYER_PARAMETERS,
    PARAMETERS,
    RADIUS,
    SHAPE,
    SHAPED,
    SKIN_PARAMETERS,
    SLOPE_U,
    SLOPE_V,
    SLOPE_W,
    STREAK_PARAMETERS,
    WIDTH,
    U,
    V,
    W,
)

SKIN_CURVATURE_PER_MM = 1.0 / 85.0
"""The skin falls away beside the ball like a sphere of a head's size. A ball of metal is 2 um off where the skin is
fitted as if it were flat; a head of 70 instead of 100 mm makes 0.6 um."""

_LAYER_AT = len(PARAMETERS)
_LAYER_COUNT, _STREAK_COUNT, _SKIN_COUNT = len(LAYER_PARAMETERS), len(STREAK_PARAMETERS), len(SKIN_PARAMETERS)
"""One, two and four: how many parameters there are says which."""

DISC_NODES = (8, 16)
"""Discs that stand for one slice's profile: eight keep the error below 0.1 % of the contrast up to a width of 0.6 R,
sixteen beyond."""

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
    from scipy.special import ndtr
    from scipy.stats import ncx2

    t = np.arange(1, _CURVATURE_STEPS + 1)[:, np.newaxis] / _CURVATURE_STEPS
    distance = np.linspace(-EDGE_REACH, EDGE_REACH, _EDGE_STEPS + 1)[np.newaxis, :]
    position = 2.0 / t - 2.0
    disc_radius = np.maximum(position + distance, 0.0)
    curved = ncx2.cdf(disc_radius**2, 2, position**2)
    return np.ascontiguousarray(np.vstack([ndtr(distance), curved]))


Kernel = tuple[FloatArray, FloatArray, FloatArray]
"""What the compiled functions look up: the table of blurred discs, and the places and weights of a slice's discs."""


def kernel(theta: FloatArray) -> Kernel:
    """Return what evaluates a ball of these parameters (P,) accurately."""
    is_thin = bool(theta[WIDTH] <= THIN_SHARE * theta[RADIUS])
    return (disc_table(), *_disc_nodes(DISC_NODES[0] if is_thin else DISC_NODES[1]))


@cache
def _disc_nodes(count: int) -> tuple[FloatArray, FloatArray]:
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


@njit(cache=True, inline="always")
def _blurred_disc(r: float, a: float, table: FloatArray) -> float:
    """Blurred disc of radius ``a`` at distance ``r`` from its axis, both in units of sigma."""
    distance = a - r
    if distance >= EDGE_REACH:
        return 1.0
    if distance <= -EDGE_REACH:
        return 0.0
    x = (distance + EDGE_REACH) * (_EDGE_STEPS / (2.0 * EDGE_REACH))
    y = 2.0 / (r + 2.0) * _CURVATURE_STEPS
    n = min(int(x), _EDGE_STEPS - 1)
    m = min(int(y), _CURVATURE_STEPS - 1)
    x -= n
    y -= m
    low = table[m, n] * (1.0 - x) + table[m, n + 1] * x
    high = table[m + 1, n] * (1.0 - x) + table[m + 1, n + 1] * x
    return low * (1.0 - y) + high * y


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


@njit(cache=True, inline="always")
def _bessel_scaled(x: float) -> tuple[float, float]:
    """exp(-x) I0(x) and exp(-x) I1(x) for x >= 0."""
    if x < 3.75:
        t = (x / 3.75) ** 2
        decay = math.exp(-x)
        return _polynomial(_I0_NEAR, t) * decay, x * _polynomial(_I1_NEAR, t) * decay
    t = 3.75 / x
    root = math.sqrt(x)
    return _polynomial(_I0_FAR, t) / root, _polynomial(_I1_FAR, t) / root


@njit(cache=True, inline="always")
def _disc_slopes(r: float, a: float, inverse: float) -> tuple[float, float, float, float, float]:
    """Derivatives of the blurred disc by its radius ``a`` and by the distance ``r`` from its axis, in 1/mm.

    Then what ``edge`` adds to it, -blur d(disc)/d(blur), and the derivatives of that by ``a`` and ``r``.
    """
    apart = (a - r) * inverse
    if abs(apart) >= EDGE_REACH:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    square = inverse * inverse
    z = r * a * square
    i0, i1 = _bessel_scaled(z)
    density = a * square * math.exp(-0.5 * apart * apart)
    size = (a * a + r * r) * square
    by_a, by_r = density * i0, -density * i1
    added = a * by_a + r * by_r
    return by_a, by_r, added, density * ((2.0 - size) * i0 + 2.0 * z * i1), density * (size * i1 - 2.0 * z * i0)


@njit(cache=True, inline="always")
def ball(
    du: float,
    dv: float,
    dw: float,
    radius: float,
    theta: FloatArray,
    profile: tuple[float, float, float],
    table: FloatArray,
    nodes: FloatArray,
    weights: FloatArray,
    slope: FloatArray,
) -> float:
    """Blurred ball (0 outside, 1 inside) of ``radius`` mm at offset (du, dv, dw) from its centre.

    Blur and profile are those of ``theta``; ``profile`` is what `slice_profile` says of it, ``slope`` receives the
    derivatives by the first `SHAPED` parameters.
    The discs are summed over the latitude phi (w = R sin phi), in which even the polar cap is smooth.
    """
    slope[:SHAPED] = 0.0
    inverse, edge, shape = 1.0 / theta[BLUR], theta[EDGE], theta[SHAPE]
    half, height, mean_log = profile
    low, high = max(dw - half, -radius), min(dw + half, radius)
    if low >= high:
        return 0.0
    r = math.sqrt(du * du + dv * dv)
    south = math.asin(low / radius)
    span = math.asin(high / radius) - south
    value = by_r = by_radius = by_blur = by_edge = by_w = by_width = by_log = 0.0
    for q in range(len(nodes)):
        latitude = south + span * nodes[q]
        place = radius * math.sin(latitude)
        a = radius * math.cos(latitude)
        x = (place - dw) / half
        log = math.log(max(1.0 - x * x, 1e-12))
        weight = weights[q] * math.exp(shape * log)
        by_a, by_distance, added, added_by_a, added_by_distance = _disc_slopes(r, a, inverse)
        disc = weight * a * (_blurred_disc(r * inverse, a * inverse, table) + edge * added)
        by_a += edge * added_by_a
        by_distance += edge * added_by_distance
        value += disc
        by_edge += weight * a * added
        by_log += disc * log
        by_r += weight * a * by_distance
        by_radius += weight * radius * by_a
        by_blur -= weight * a * (r * by_distance + a * by_a) * inverse
        by_w -= weight * place * by_a
        by_width -= weight * place * by_a * (place - dw)
    scale = span * height
    value *= scale
    by_width *= scale / theta[WIDTH]
    if r > 0.0:
        slope[U] = -scale * by_r * du / r
        slope[V] = -scale * by_r * dv / r
    slope[W] = -scale * by_w
    slope[RADIUS] = scale * by_radius
    slope[BLUR] = scale * by_blur
    slope[EDGE] = scale * by_edge
    slope[WIDTH] = by_width
    slope[SHAPE] = scale * by_log - mean_log * value + by_width * theta[WIDTH] / (2.0 * shape + 3.0)
    return value


@njit(cache=True, inline="always")
def has_layer(theta: FloatArray) -> bool:
    """Whether ``theta`` (P,) holds `LAYER_PARAMETERS`."""
    return (len(theta) - _LAYER_AT) & _LAYER_COUNT != 0


@njit(cache=True, inline="always")
def has_streaks(theta: FloatArray) -> bool:
    """Whether ``theta`` (P,) holds `STREAK_PARAMETERS`."""
    return (len(theta) - _LAYER_AT) & _STREAK_COUNT != 0


@njit(cache=True, inline="always")
def has_skin(theta: FloatArray) -> bool:
    """Whether ``theta`` (P,) ends with `SKIN_PARAMETERS`."""
    return (len(theta) - _LAYER_AT) & _SKIN_COUNT != 0


@njit(cache=True, inline="always")
def metal_streaks(du: float, dv: float, dw: float, theta: FloatArray, gradient: FloatArray) -> float:
    """HU of the ball's own streaks at an offset from its centre; fills ``gradient`` for `STREAK_PARAMETERS`.

    Adds the derivatives by centre and radius. Beside something as large as a head, metal darkens the lines that pass
    through both and brightens those that pass through it alone (J. Barrett and N. Keat, RadioGraphics 24:1679, 2004):
    near the ball that is a pattern with two bright and two dark sides, which fades with the distance.
    """
    at = _LAYER_AT + ((len(theta) - _LAYER_AT) & _LAYER_COUNT)
    radius, streak, diagonal = theta[RADIUS], theta[at], theta[at + 1]
    spread = du * du + dv * dv + dw * dw + radius * radius
    envelope = 16.0 * radius**6 / spread**4
    gradient[at] = (du * du - dv * dv) * envelope
    gradient[at + 1] = 2.0 * du * dv * envelope
    value = streak * gradient[at] + diagonal * gradient[at + 1]
    fall = 8.0 * value / spread
    gradient[U] += fall * du - 2.0 * envelope * (streak * du + diagonal * dv)
    gradient[V] += fall * dv - 2.0 * envelope * (diagonal * du - streak * dv)
    gradient[W] += fall * dw
    gradient[RADIUS] += 6.0 * value / radius - fall * radius
    return value


@njit(cache=True, inline="always")
def skin(du: float, dv: float, dw: float, theta: FloatArray, gradient: FloatArray) -> float:
    """HU of the blurred skin at an offset from the ball's centre; fills ``gradient`` for `SKIN_PARAMETERS`.

    Adds the derivatives by the ball's centre, which carries the skin along, and by the blur.
    """
    at = len(theta) - _SKIN_COUNT
    gu, gv, gw = theta[at + 1], theta[at + 2], theta[at + 3]
    length = math.sqrt(gu * gu + gv * gv + gw * gw)
    across = 1.0 - (gw / length) ** 2
    blur = math.sqrt(theta[BLUR] ** 2 * across + (theta[WIDTH] ** 2 / 12.0 + 0.01) * (1.0 - across))
    nu, nv, nw = gu / length, gv / length, gw / length
    depth = nu * du + nv * dv + nw * dw
    beside_u, beside_v, beside_w = du - depth * nu, dv - depth * nv, dw - depth * nw
    sag = 0.5 * SKIN_CURVATURE_PER_MM * (beside_u**2 + beside_v**2 + beside_w**2)
    height = length * (depth - sag) - 1.0
    t = height / (length * blur)
    share = 0.5 * math.erfc(-t * math.sqrt(0.5))
    density = theta[at] * math.exp(-0.5 * t * t) / (math.sqrt(2.0 * math.pi) * length * blur)
    by_blur = -density * height / blur
    turn = 1.0 + SKIN_CURVATURE_PER_MM * depth
    gradient[at] = share
    gradient[at + 1] = density * (turn * beside_u + nu / length)
    gradient[at + 2] = density * (turn * beside_v + nv / length)
    gradient[at + 3] = density * (turn * beside_w + nw / length)
    gradient[U] -= density * length * (nu - SKIN_CURVATURE_PER_MM * beside_u)
    gradient[V] -= density * length * (nv - SKIN_CURVATURE_PER_MM * beside_v)
    gradient[W] -= density * length * (nw - SKIN_CURVATURE_PER_MM * beside_w)
    gradient[BLUR] += by_blur * theta[BLUR] * across / blur
    gradient[WIDTH] += by_blur * theta[WIDTH] * (1.0 - across) / (12.0 * blur)
    return theta[at] * share


@njit(cache=True, inline="always")
def voxel_model(
    du: float,
    dv: float,
    dw: float,
    theta: FloatArray,
    layer_mm: float,
    profile: tuple[float, float, float],
    table: FloatArray,
    nodes: FloatArray,
    weights: FloatArray,
    gradient: FloatArray,
    scratch: FloatArray,
) -> float:
    """Expected HU at an offset from the ball's centre; ``gradient`` (P,) receives d(HU)/d(``theta``).

    The second ball of a hollow or wrapped marker is larger by ``layer_mm`` in radius; ``scratch`` is for its
    derivatives.
    """
    share = ball(du, dv, dw, theta[RADIUS], theta, profile, table, nodes, weights, gradient)
    for p in range(SHAPED):
        gradient[p] *= theta[CONTRAST]
    gradient[U] -= theta[SLOPE_U]
    gradient[V] -= theta[SLOPE_V]
    gradient[W] -= theta[SLOPE_W]
    gradient[CONTRAST] = share
    gradient[BACKGROUND] = 1.0
    gradient[SLOPE_U] = du
    gradient[SLOPE_V] = dv
    gradient[SLOPE_W] = dw
    value = (
        theta[BACKGROUND]
        + theta[CONTRAST] * share
        + theta[SLOPE_U] * du
        + theta[SLOPE_V] * dv
        + theta[SLOPE_W] * dw
    )
    if has_layer(theta):
        level, radius = theta[_LAYER_AT], theta[RADIUS] + layer_mm
        gradient[_LAYER_AT] = ball(du, dv, dw, radius, theta, profile, table, nodes, weights, scratch)
        value += level * gradient[_LAYER_AT]
        for p in range(SHAPED):
            gradient[p] += level * scratch[p]
    if has_streaks(theta):
        value += metal_streaks(du, dv, dw, theta, gradient)
    if has_skin(theta):
        value += skin(du, dv, dw, theta, gradient)
    return value


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def evaluate(
    offsets: FloatArray,
    theta: FloatArray,
    layer_mm: float,
    table: FloatArray,
    nodes: FloatArray,
    weights: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Model (N,) and its Jacobian (N, P) for voxels at ``offsets`` (N, 3) from an origin near the centre."""
    profile, scratch = slice_profile(theta[WIDTH], theta[SHAPE]), np.empty(SHAPED)
    count = len(offsets)
    values = np.empty(count)
    jacobian = np.empty((count, len(theta)))
    for n in range(count):
        values[n] = voxel_model(
            offsets[n, 0] - theta[U],
            offsets[n, 1] - theta[V],
            offsets[n, 2] - theta[W],
            theta,
            layer_mm,
            profile,
            table,
            nodes,
            weights,
            jacobian[n],
            scratch,
        )
    return values, jacobian


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def normal_equations(
    offsets: FloatArray,
    values: FloatArray,
    used: NDArray[np.bool_],
    theta: FloatArray,
    layer_mm: float,
    floor: float,
    ceiling: float,
    table: FloatArray,
    nodes: FloatArray,
    weights: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:
    """Half the squared residuals, their gradient (P,) and Gauss-Newton matrix (P, P) over the used voxels."""
    profile, scratch = slice_profile(theta[WIDTH], theta[SHAPE]), np.empty(SHAPED)
    size = len(theta)
    cost = 0.0
    slope = np.zeros(size)
    matrix = np.zeros((size, size))
    gradient = np.empty(size)
    for n in range(len(values)):
        if not used[n]:
            continue
        du = offsets[n, 0] - theta[U]
        dv = offsets[n, 1] - theta[V]
        dw = offsets[n, 2] - theta[W]
        model = voxel_model(du, dv, dw, theta, layer_mm, profile, table, nodes, weights, gradient, scratch)
        if (values[n] >= ceiling and model >= ceiling) or (values[n] <= floor and model <= floor):
            continue
        residual = values[n] - model
        cost += 0.5 * residual * residual
        for p in range(size):
            slope[p] += gradient[p] * residual
            for q in range(p + 1):
                matrix[p, q] += gradient[p] * gradient[q]
    for p in range(size):
        for q in range(p):
            matrix[q, p] = matrix[p, q]
    return cost, slope, matrix
