"""What a ball looks like in CT: a solid sphere seen through the scanner's blur, and what lies about it.

The scanner blurs within the slice plane by a point-spread function that is nearly Gaussian (standard deviation
``blur``). Kernels that overshoot at edges, or have long tails, are the next term of its expansion: ``edge`` times
-blur dG/d(blur), so that the transfer function is the Gaussian's times 1 + edge (2 pi f blur)^2. Across the slices it
blurs by its slice profile (`fit.ball`).

Coordinates here are those of the slices: u along the rows, v down the columns, w along the normal, in mm.
"""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.ball import add_ball
from ronnaplan.localization.fit.disc import share_below
from ronnaplan.localization.fit.parameters import (
    BACKGROUND,
    BLUR,
    CONTRAST,
    LAYER_PARAMETERS,
    LEAST_SPREAD_MM2,
    PARAMETERS,
    RADIUS,
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

METAL_CONTRAST_HU = 6000.0
"""A ball with more contrast is metal and has streaks; the densest ceramics reach some 5000 HU."""

BLOCK = 1016
"""So many voxels' derivatives stay in the processor's cache until they are summed up, in rows of an odd number of its
lines, which do not displace each other."""

_LAYER_AT = len(PARAMETERS)
_LAYER_COUNT, _STREAK_COUNT, _SKIN_COUNT = len(LAYER_PARAMETERS), len(STREAK_PARAMETERS), len(SKIN_PARAMETERS)
"""One, two and four: how many parameters there are says which."""


@njit(cache=True)
def has_layer(theta: FloatArray) -> bool:
    """Whether ``theta`` (P,) holds `LAYER_PARAMETERS`."""
    return (len(theta) - _LAYER_AT) & _LAYER_COUNT != 0


def spheres(theta: FloatArray, layer_mm: float) -> list[tuple[float, float]]:
    """Return radius (mm) and level (HU) of the ball, and of the second one of a hollow or wrapped marker."""
    ball = (float(theta[RADIUS]), float(theta[CONTRAST]))
    second = [(ball[0] + layer_mm, float(theta[_LAYER_AT]))] if has_layer(theta) else []
    return [ball, *second]


@njit(cache=True)
def has_streaks(theta: FloatArray) -> bool:
    """Whether ``theta`` (P,) holds `STREAK_PARAMETERS`."""
    return (len(theta) - _LAYER_AT) & _STREAK_COUNT != 0


@njit(cache=True)
def has_skin(theta: FloatArray) -> bool:
    """Whether ``theta`` (P,) ends with `SKIN_PARAMETERS`."""
    return (len(theta) - _LAYER_AT) & _SKIN_COUNT != 0


@njit(cache=True, nogil=True)
def evaluate(
    offsets: FloatArray,
    theta: FloatArray,
    layer_mm: float,
    table: FloatArray,
    nodes: FloatArray,
    weights: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Model (N,) and its Jacobian (N, P) for voxels at ``offsets`` (N, 3) from an origin near the center.

    The second ball of a hollow or wrapped marker is larger by ``layer_mm`` in radius; the last three are `ball.discs`.
    """
    values, jacobian = np.empty(len(offsets)), np.empty((len(offsets), len(theta)))
    fill_model(offsets, theta, layer_mm, table, nodes, weights, values, jacobian)
    return values, jacobian


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def fill_model(
    offsets: FloatArray,
    theta: FloatArray,
    layer_mm: float,
    table: FloatArray,
    nodes: FloatArray,
    weights: FloatArray,
    values: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Fill ``values`` and ``jacobian``, which may have room for more voxels, with what `evaluate` returns."""
    count = len(offsets)
    for n in range(count):
        for p in range(SHAPED):
            jacobian[n, p] = 0.0
    add_ball(offsets, theta, theta[RADIUS], theta[CONTRAST], table, nodes, weights, values, jacobian)
    for n in range(count):
        du, dv, dw = offsets[n, 0] - theta[U], offsets[n, 1] - theta[V], offsets[n, 2] - theta[W]
        jacobian[n, CONTRAST] = values[n]
        jacobian[n, BACKGROUND] = 1.0
        jacobian[n, SLOPE_U] = du
        jacobian[n, SLOPE_V] = dv
        jacobian[n, SLOPE_W] = dw
        jacobian[n, U] -= theta[SLOPE_U]
        jacobian[n, V] -= theta[SLOPE_V]
        jacobian[n, W] -= theta[SLOPE_W]
        slopes = theta[SLOPE_U] * du + theta[SLOPE_V] * dv + theta[SLOPE_W] * dw
        values[n] = theta[BACKGROUND] + theta[CONTRAST] * values[n] + slopes
    if has_layer(theta):
        level, radius, shares = theta[_LAYER_AT], theta[RADIUS] + layer_mm, np.empty(count)
        add_ball(offsets, theta, radius, level, table, nodes, weights, shares, jacobian)
        for n in range(count):
            jacobian[n, _LAYER_AT] = shares[n]
            values[n] += level * shares[n]
    if has_streaks(theta):
        _add_streaks(offsets, theta, values, jacobian)
    if has_skin(theta):
        _add_skin(offsets, theta, values, jacobian)


@njit(cache=True, error_model="numpy", nogil=True)
def _add_streaks(offsets: FloatArray, theta: FloatArray, values: FloatArray, jacobian: FloatArray) -> None:
    """Add a metal ball's own streaks, and their derivatives, at offsets from the origin.

    Beside something as large as a head, metal darkens the lines that pass
    through both and brightens those that pass through it alone (J. Barrett and N. Keat, RadioGraphics 24:1679, 2004):
    near the ball that is a pattern with two bright and two dark sides, which fades with the distance.
    """
    at = _LAYER_AT + ((len(theta) - _LAYER_AT) & _LAYER_COUNT)
    radius, streak, diagonal = theta[RADIUS], theta[at], theta[at + 1]
    for n in range(len(offsets)):
        du, dv, dw = offsets[n, 0] - theta[U], offsets[n, 1] - theta[V], offsets[n, 2] - theta[W]
        spread = du * du + dv * dv + dw * dw + radius * radius
        envelope = 16.0 * radius**6 / spread**4
        jacobian[n, at] = (du * du - dv * dv) * envelope
        jacobian[n, at + 1] = 2.0 * du * dv * envelope
        value = streak * jacobian[n, at] + diagonal * jacobian[n, at + 1]
        fall = 8.0 * value / spread
        jacobian[n, U] += fall * du - 2.0 * envelope * (streak * du + diagonal * dv)
        jacobian[n, V] += fall * dv - 2.0 * envelope * (diagonal * du - streak * dv)
        jacobian[n, W] += fall * dw
        jacobian[n, RADIUS] += 6.0 * value / radius - fall * radius
        values[n] += value


@njit(cache=True, error_model="numpy", nogil=True)
def _add_skin(offsets: FloatArray, theta: FloatArray, values: FloatArray, jacobian: FloatArray) -> None:
    """Add the blurred skin, which the ball's center carries along, and its derivatives, at offsets from the origin."""
    at = len(theta) - _SKIN_COUNT
    gu, gv, gw = theta[at + 1], theta[at + 2], theta[at + 3]
    length = math.sqrt(gu * gu + gv * gv + gw * gw)
    nu, nv, nw = gu / length, gv / length, gw / length
    across = 1.0 - nw * nw
    blur = math.sqrt(theta[BLUR] ** 2 * across + (theta[WIDTH] ** 2 / 12.0 + LEAST_SPREAD_MM2) * (1.0 - across))
    for n in range(len(offsets)):
        du, dv, dw = offsets[n, 0] - theta[U], offsets[n, 1] - theta[V], offsets[n, 2] - theta[W]
        depth = nu * du + nv * dv + nw * dw
        beside_u, beside_v, beside_w = du - depth * nu, dv - depth * nv, dw - depth * nw
        sag = 0.5 * SKIN_CURVATURE_PER_MM * (beside_u**2 + beside_v**2 + beside_w**2)
        height = length * (depth - sag) - 1.0
        t = height / (length * blur)
        share = share_below(t)
        density = theta[at] * math.exp(-0.5 * t * t) / (math.sqrt(2.0 * math.pi) * length * blur)
        by_blur = -density * height / blur
        turn = 1.0 + SKIN_CURVATURE_PER_MM * depth
        jacobian[n, at] = share
        jacobian[n, at + 1] = density * (turn * beside_u + nu / length)
        jacobian[n, at + 2] = density * (turn * beside_v + nv / length)
        jacobian[n, at + 3] = density * (turn * beside_w + nw / length)
        jacobian[n, U] -= density * length * (nu - SKIN_CURVATURE_PER_MM * beside_u)
        jacobian[n, V] -= density * length * (nv - SKIN_CURVATURE_PER_MM * beside_v)
        jacobian[n, W] -= density * length * (nw - SKIN_CURVATURE_PER_MM * beside_w)
        jacobian[n, BLUR] += by_blur * theta[BLUR] * across / blur
        jacobian[n, WIDTH] += by_blur * theta[WIDTH] * (1.0 - across) / (12.0 * blur)
        values[n] += theta[at] * share


@njit(cache=True, nogil=True)
def is_beyond_scale(value: float, model: float, floor: float, ceiling: float) -> bool:
    """Whether a voxel and its model agree that they lie where the scale has ended: that says nothing more."""
    return (value >= ceiling and model >= ceiling) or (value <= floor and model <= floor)


@njit(cache=True, nogil=True)
def shown_hu(theta: FloatArray, ceiling: float) -> float:
    """How much of the contrast of a ball ``theta`` (P,) a scale shows that ends at ``ceiling``."""
    return min(float(theta[CONTRAST]), ceiling - float(theta[BACKGROUND]))


@njit(cache=True, nogil=True)
def leave_over(
    values: FloatArray, floors: FloatArray, ceiling: float, jacobian: FloatArray, left_over: FloatArray
) -> None:
    """Turn the model ``left_over`` (N or more,) into what it leaves over of ``values`` (N,).

    That and the ``jacobian`` (N or more, P) are zero where values at or beyond their ``floors`` (N,) and the
    ``ceiling`` agree with a model that lies there, too: they inform only where it lies within.
    """
    for n in range(len(values)):
        if is_beyond_scale(values[n], left_over[n], floors[n], ceiling):
            left_over[n] = 0.0
            for p in range(jacobian.shape[1]):
                jacobian[n, p] = 0.0
        else:
            left_over[n] = values[n] - left_over[n]
