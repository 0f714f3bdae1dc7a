"""The compiled tables of what a sphere's brightness is by the depth within its outline, blurred."""

from __future__ import annotations

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray

PROFILE = 4
"""Constants of the profile: the powers of the cosine to the line of sight, from none to the third."""
SHAPES = 2 + 2 * PROFILE + 2
"""Blurred functions of the depth: ground, its slope, the profile's powers, the same times the distance from the center
(in radii), and two for the waves."""
POWERS = 24
SHADOW = POWERS + 2 * PROFILE
COLUMNS = SHADOW + 3
"""Of the table: eight functions with two derivatives each, the profile's powers, and the light that casts shadows, with
two derivatives."""
STEEP_SDS, BEND = 6.0, 5
"""What lies deeper than so many blurs is blurred by its curvature, which is taken over so many steps to either side."""
SLANTS, MOST_SLANT = 31, 1.5
"""So many slants of a lamp aside against the line of sight are looked at, up to this (tangent of the angle)."""


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def blurred(radius: float, blur_px: float, first_px: float, step_px: float, count: int) -> FloatArray:
    """Return the shapes (SHAPES, N, 3) at depths from ``first_px`` on, blurred, with two derivatives."""
    reach = int(4 * blur_px / step_px) + 1
    wide = count + 2 * reach
    sharp = np.zeros((SHAPES, wide))
    for n in range(wide):
        depth, inside = within(first_px + (n - reach) * step_px, step_px)
        sharp[0, n], sharp[1, n] = 1.0 - inside, min(depth, 0.0)
        u = 1.0 - depth / radius
        z, power = np.sqrt(max(1.0 - u * u, 0.0)), inside
        for k in range(PROFILE):
            sharp[2 + k, n], sharp[2 + PROFILE + k, n] = power, u * power
            power *= z
        sharp[2 + 2 * PROFILE, n], sharp[3 + 2 * PROFILE, n] = inside * u * u, inside * u * u * z
    found = np.zeros((SHAPES, count, 3))
    for k in range(SHAPES):
        blur_one(sharp[k], radius, blur_px, first_px, step_px, False, found[k])
    return found


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def shadowed(
    radius: float, half_angle: float, blur_px: float, first_px: float, step_px: float, count: int
) -> FloatArray:
    """Return what a lamp lights at depths from ``first_px`` on, blurred, with two derivatives: (SLANTS, N, 3).

    That is the cosine to the axis plus the distance from the center (in radii) times the slant of the light, from
    `-MOST_SLANT` to none, and nothing where this is below nothing. At the limb, seen under ``half_angle`` (rad), the
    cosine to the axis is that, not nothing.
    """
    reach = int(4 * blur_px / step_px) + 1
    sharp, found = np.zeros(count + 2 * reach), np.zeros((SLANTS, count, 3))
    for k in range(SLANTS):
        slant = (k / (SLANTS - 1) - 1) * MOST_SLANT
        for n in range(len(sharp)):
            depth, inside = within(first_px + (n - reach) * step_px, step_px)
            u = 1.0 - depth / radius
            sharp[n] = inside * max(np.sqrt(max(1.0 - u * u, 0.0)) + (half_angle * u + slant) * u, 0.0)
        blur_one(sharp, radius, blur_px, first_px, step_px, True, found[k])
    return found


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def within(depth: float, step: float) -> tuple[float, float]:
    """Return the middle depth of what lies within the outline of a cell one ``step`` wide, and its share of the cell.

    Where nothing does, the depth is the cell's own. The outline itself, at no depth, halves a cell: else it would lie
    half a step too deep.
    """
    share = min(max(depth / step + 0.5, 0.0), 1.0)
    return (depth + (1.0 - share) * step / 2 if share > 0.0 else depth), share


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True, inline="always")
def blur_one(
    sharp: FloatArray,
    radius: float,
    blur_px: float,
    first_px: float,
    step_px: float,
    bent: bool,
    found: FloatArray,
) -> None:
    """Fill ``found`` (N, 3) with a ``sharp`` function of the depth, blurred, and its two derivatives.

    Unless it is ``bent`` there, what lies deep is blurred by its curvature alone. It is inlined: of code that may round
    as it is fastest there would be two copies, and the run that compiles them takes the other one than later runs.
    """
    count = len(found)
    reach = (len(sharp) - count) // 2
    weights = np.empty(2 * reach + 1)
    for n in range(2 * reach + 1):
        weights[n] = np.exp(-0.5 * ((n - reach) * step_px / blur_px) ** 2)
    weights /= weights.sum()
    smooth, slope = np.zeros(count), np.zeros(count)
    near = count if bent else min(int((STEEP_SDS * blur_px - first_px) / step_px), count)
    for n in range(2 * reach + 1):
        weight = weights[n]
        for m in range(near):
            smooth[m] += weight * sharp[m + n]
    for m in range(near, count):
        curved = sharp[m + reach + BEND] - 2 * sharp[m + reach] + sharp[m + reach - BEND]
        smooth[m] = sharp[m + reach] + (blur_px / (BEND * step_px)) ** 2 / 2 * curved
    derivative(smooth, step_px, slope)
    for m in range(count):  # the outline is bent, which the blur across it does not know
        smooth[m] -= blur_px**2 / 2 * slope[m] / max(radius - first_px - m * step_px, 5.0)
    for m in range(count):
        found[m, 0] = smooth[m]
    derivative(smooth, step_px, slope)
    for m in range(count):
        found[m, 1] = slope[m]
    derivative(slope, step_px, smooth)
    for m in range(count):
        found[m, 2] = smooth[m]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def derivative(values: FloatArray, step: float, found: FloatArray) -> None:
    """Fill ``found`` (N) with the derivative of ``values`` (N)."""
    last = len(values) - 1
    for n in range(1, last):
        found[n] = (values[n + 1] - values[n - 1]) / (2 * step)
    found[0], found[last] = (values[1] - values[0]) / step, (values[last] - values[last - 1]) / step


@njit(cache=True, nogil=True, error_model="numpy")
def table_of(shapes: FloatArray, light: FloatArray) -> FloatArray:
    """Return the table (N, COLUMNS) of the ``shapes`` in this ``light``."""
    count = shapes.shape[1]
    table = np.zeros((count, COLUMNS))
    plain, odd = 2, 2 + PROFILE
    for n in range(count):
        for d in range(3):
            table[n, d], table[n, 3 + d] = shapes[0, n, d], shapes[1, n, d]
            for k in range(PROFILE):
                table[n, 6 + d] += light[k] * shapes[plain + k, n, d]
                table[n, 9 + d] += light[k] * shapes[odd + k, n, d]
            table[n, 12 + d], table[n, 15 + d] = shapes[odd, n, d], shapes[odd + 1, n, d]
            table[n, 18 + d], table[n, 21 + d] = shapes[odd + PROFILE, n, d], shapes[odd + PROFILE + 1, n, d]
            table[n, SHADOW + d] = light[1] * shapes[plain + 1, n, d]
        for k in range(PROFILE):
            table[n, POWERS + k], table[n, POWERS + PROFILE + k] = shapes[plain + k, n, 0], shapes[odd + k, n, 0]
    return table
