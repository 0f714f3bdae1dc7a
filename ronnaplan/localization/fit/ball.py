"""A blurred ball: how much of a solid sphere each voxel sees, and how that changes with the ball and the scanner.

A slice through a ball is a pile of blurred discs (`fit.disc`), and the average over the slice's
profile is a Gauss sum over a few of them. No voxel is resampled: each is evaluated at its true place.

Slice profiles range from the box of an axial scan to the bells of helical and cone-beam ones (W. Kalender, Computed
Tomography, 2011, section 3.3), and the header's thickness is not their width. They are taken as (1 - x^2)^shape on
|x| < 1, the symmetric beta distribution: a box at shape 0, a parabola at 1, nearly a Gaussian from 4 on.

All voxels of a slice see the same discs, so these are laid out once a slice (`fit.pile`); the blurred disc and its
derivatives are looked up in one table, for each disc and voxel, or, where these are many, for places between which the
voxels lie.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.disc import CURVATURE_STEPS, EDGE_REACH, EDGE_STEPS, disc_table
from ronnaplan.localization.fit.parameters import BLUR, EDGE, RADIUS, SHAPE, WIDTH, U, V, W
from ronnaplan.localization.fit.pile import SOME_DISCS, lay_out, profile_rules, slice_profile

POLE_DISCS = (8, 16)
"""Near the poles the discs are spread evenly over the latitude instead: eight up to a width of 0.6 R, sixteen
beyond."""

THIN_SHARE = 0.6
"""Slices are thin beside the ball up to this share of its radius."""

PLACES_PER_BLUR, PLACES_BETWEEN, FEWER_PLACES = 3, 6, 1.5
"""Voxels of a slice that are as far from the ball's axis see the same. Where a slice has more of them, by the last
factor, than there are places so many to a blur, these are looked at, and voxels are told by the six nearest. That is
off by 1e-4 of the contrast at worst where the ``edge`` is below 0, by 4e-4 up to 1, by 2e-3 where edges overshoot most;
by a fifth of that RMS at most."""

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
def _see(
    r: float, inverse: float, edge: float, dw: float, pile: FloatArray, table: FloatArray, told: FloatArray
) -> None:
    """Fill ``told`` (8,) with what a place ``r`` mm from the ball's axis sees of the discs of a ``pile`` (4, Q).

    That is its share, and what its derivatives by r, w, radius, blur, edge, width and shape are made of.
    """
    y = 2.0 * CURVATURE_STEPS / (r * inverse + 2.0)
    i = min(int(y), CURVATURE_STEPS - 1)
    y -= i
    value = by_r = by_radius = by_blur = by_edge = by_w = by_width = by_shape = 0.0
    for q in range(pile.shape[1]):
        place, a, weight, weight_by_shape = pile[0, q], pile[1, q], pile[2, q], pile[3, q]
        distance = (a - r) * inverse
        if distance <= -EDGE_REACH:
            continue
        if distance >= EDGE_REACH:
            value += weight
            by_shape += weight_by_shape
            continue
        disc, disc_by_a, disc_by_r, along, along_by_a, along_by_r, twice_along = _looked_up(table, i, y, distance)
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
    told[0], told[1], told[2], told[3] = value, by_r, by_w, by_radius
    told[4], told[5], told[6], told[7] = by_blur, by_edge, by_width, by_shape


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _see_between(places: FloatArray, at: float, told: FloatArray) -> None:
    """Fill ``told`` (8,) with what is seen ``at`` so many rows of ``places`` (M, 8), by the nearest six (Lagrange)."""
    m = min(max(int(at) - 2, 0), len(places) - PLACES_BETWEEN)
    a = at - m
    b, c, d, e, f = a - 1.0, a - 2.0, a - 3.0, a - 4.0, a - 5.0
    ab, cd, ef = a * b, c * d, e * f
    one, two, three = b * cd * ef / -120.0, a * cd * ef / 24.0, ab * d * ef / -12.0
    four, five, six = ab * c * ef / 12.0, ab * cd * f / -24.0, ab * cd * e / 120.0
    for p in range(8):
        left = one * places[m, p] + two * places[m + 1, p] + three * places[m + 2, p]
        told[p] = left + four * places[m + 3, p] + five * places[m + 4, p] + six * places[m + 5, p]


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def _fill_distances(offsets: FloatArray, theta: FloatArray, first: int, distances: FloatArray) -> int:
    """Fill the ``distances`` (N,) from the ball's axis, of the voxels of the slice that begins at the ``first``.

    Returns where the slice ends.
    """
    end = first
    while end < len(offsets) and offsets[end, 2] == offsets[first, 2]:
        du, dv = offsets[end, 0] - theta[U], offsets[end, 1] - theta[V]
        distances[end] = math.sqrt(du * du + dv * dv)
        end += 1
    return end


@njit(cache=True, error_model="numpy", nogil=True)
def _places_to_know(distances: FloatArray, low: float, high: float, step: float) -> tuple[float, int]:
    """Return where places a ``step`` apart begin, by which ``distances`` from ``low`` to ``high`` are told.

    And how many they are: none where that would not be fewer.
    """
    nearest, farthest, seen = high, low, 0
    for r in distances:
        if low < r < high:
            nearest, farthest, seen = min(nearest, r), max(farthest, r), seen + 1
    count = max(math.ceil((farthest - nearest) / step) + 1, PLACES_BETWEEN) if seen > 0 else 0
    return nearest, count if FEWER_PLACES * count < seen else 0


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
    profile, rules = (shape, half, height, mean_log), profile_rules(shape)
    pile, told, distances = np.empty((4, max(len(nodes), SOME_DISCS))), np.empty(8), np.empty(len(offsets))
    inverse, reach, step = 1.0 / sigma, EDGE_REACH * sigma, sigma / PLACES_PER_BLUR
    square_inverse, support_by_shape = contrast * inverse * inverse, 1.0 / (2.0 * shape + 3.0)
    first = 0
    while first < len(offsets):  # slice by slice
        dw, end = offsets[first, 2] - theta[W], _fill_distances(offsets, theta, first, distances)
        some, first = range(first, end), end
        shares[some.start : end] = 0.0
        if abs(dw) - half >= radius:
            continue
        count, narrowest, widest = lay_out(dw, radius, sigma, profile, rules, nodes, weights, pile)
        low, high = narrowest - reach, widest + reach
        begin, known = _places_to_know(distances[some.start : end], low, high, step)
        discs_seen, places = pile[:, :count], np.empty((known, 8))
        for m in range(known):
            _see(begin + m * step, inverse, edge, dw, discs_seen, table, places[m])
        for n in some:
            r = distances[n]
            if not low < r < high:
                shares[n] = 1.0 if r <= low else 0.0
                continue
            if known > 0:
                _see_between(places, (r - begin) / step, told)
            else:
                _see(r, inverse, edge, dw, discs_seen, table, told)
            shares[n] = told[0]
            beside = -contrast * inverse * told[1] / max(r, 1e-12)
            jacobian[n, U] += beside * (offsets[n, 0] - theta[U])
            jacobian[n, V] += beside * (offsets[n, 1] - theta[V])
            jacobian[n, W] += square_inverse * told[2]
            jacobian[n, RADIUS] += square_inverse * radius * told[3]
            jacobian[n, BLUR] += contrast * told[4] * inverse
            jacobian[n, EDGE] += contrast * told[5]
            jacobian[n, WIDTH] += square_inverse * told[6] / width
            jacobian[n, SHAPE] += contrast * told[7] + square_inverse * told[6] * support_by_shape
