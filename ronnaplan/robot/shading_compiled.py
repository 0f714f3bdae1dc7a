"""The compiled kernels of the shaded sphere: its pixels by sector, its blurred profile, and what each unknown does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray

PROFILE = 4
"""Constants of the profile: the powers of the cosine to the line of sight, from none to the third."""
PLACE, BLUR, LIGHT = 0, 3, 4
TILT = LIGHT + PROFILE
ASIDE = TILT + 2
OVAL = ASIDE + 2
COMMON = OVAL + 4
"""Unknowns of the whole sphere, by where they stand: its place and radius (3), the blur, the light: the profile, its
tilt (2), light from aside (2), and waves of two periods (4)."""
OWN = 2
"""And of each sector: the ground, and its slope."""
SHAPES = 2 + 2 * PROFILE + 2
"""Blurred functions of the depth: ground, its slope, the profile's powers, the same times the distance from the center
(in radii), and two for the waves."""
COLUMNS = 21 + 2 * PROFILE
"""Of the table: seven functions with two derivatives each, and the profile's powers."""
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@njit(cache=True, nogil=True, error_model="numpy")
def gather(
    grey: FloatArray,
    bend: FloatArray,
    middle: FloatArray,
    scale: float,
    radius: float,
    bounds: tuple[float, float],
    sectors: int,
    every: tuple[float, float],
) -> tuple[FloatArray, FloatArray, Integers]:
    """Return places (B, 2) and brightness (B) of pixels of ``grey``, sector by sector, and each's start (S + 1).

    ``bend`` (10, 2) makes places (px, in a plane square to the line of sight) of columns and rows less ``middle`` (2),
    over ``scale``. Of the pixels between the ``bounds`` about the ``radius`` one of the first of ``every`` is taken,
    of those further inside one of the second.
    """
    size = grey.size
    places, values, sector = np.empty((size, 2)), np.empty(size), np.empty(size, np.int64)
    starts = np.zeros(sectors + 1, np.int64)
    count = 0
    passed = np.zeros(2)
    for row in range(grey.shape[0]):
        for column in range(grey.shape[1]):
            a, b = (column - middle[0]) / scale, (row - middle[1]) / scale
            if a * a + b * b > 1.0:
                continue
            x = bend[0, 0] + a * (bend[1, 0] + a * (bend[2, 0] + a * bend[3, 0]))
            x += b * (bend[4, 0] + b * (bend[5, 0] + b * bend[6, 0])) + a * b * (
                bend[7, 0] + a * bend[8, 0] + b * bend[9, 0]
            )
            y = bend[0, 1] + a * (bend[1, 1] + a * (bend[2, 1] + a * bend[3, 1]))
            y += b * (bend[4, 1] + b * (bend[5, 1] + b * bend[6, 1])) + a * b * (
                bend[7, 1] + a * bend[8, 1] + b * bend[9, 1]
            )
            far = np.hypot(x, y)
            if far > radius + bounds[0]:
                continue
            which = int(far < radius - bounds[1])
            passed[which] += 1.0
            if passed[which] < every[which]:
                continue
            passed[which] -= every[which]
            places[count, 0], places[count, 1], values[count] = x, y, grey[row, column]
            sector[count] = int((np.arctan2(y, x) / (2 * np.pi) + 0.5) * sectors) % sectors
            starts[sector[count] + 1] += 1
            count += 1
    starts = np.cumsum(starts)
    free = starts.copy()
    sorted_places, sorted_values = np.empty((count, 2)), np.empty(count)
    for n in range(count):
        at = free[sector[n]]
        free[sector[n]] += 1
        sorted_places[at], sorted_values[at] = places[n], values[n]
    return sorted_places, sorted_values, starts


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def blurred(radius: float, blur_px: float, first_px: float, step_px: float, count: int) -> FloatArray:
    """Return the shapes (SHAPES, N, 3) at depths from ``first_px`` on, blurred, with two derivatives."""
    reach = int(4 * blur_px / step_px) + 1
    wide = count + 2 * reach
    sharp = np.zeros((SHAPES, wide))
    for n in range(wide):
        depth = first_px + (n - reach) * step_px
        if depth <= 0.0:
            sharp[0, n], sharp[1, n] = 1.0, depth
            continue
        u = 1.0 - depth / radius
        z, power = np.sqrt(max(1.0 - u * u, 0.0)), 1.0
        for k in range(PROFILE):
            sharp[2 + k, n], sharp[2 + PROFILE + k, n] = power, u * power
            power *= z
        sharp[2 + 2 * PROFILE, n], sharp[3 + 2 * PROFILE, n] = u * u, u * u * z
    weights = np.empty(2 * reach + 1)
    for n in range(2 * reach + 1):
        weights[n] = np.exp(-0.5 * ((n - reach) * step_px / blur_px) ** 2)
    weights /= weights.sum()
    found = np.zeros((SHAPES, count, 3))
    smooth, slope = np.zeros(count), np.zeros(count)
    for k in range(SHAPES):
        smooth[:] = 0.0
        for n in range(2 * reach + 1):
            weight = weights[n]
            for m in range(count):
                smooth[m] += weight * sharp[k, m + n]
        derivative(smooth, step_px, slope)
        for m in range(count):  # the outline is bent, which the blur across it does not know
            smooth[m] -= blur_px**2 / 2 * slope[m] / max(radius - first_px - m * step_px, 5.0)
        found[k, :, 0] = smooth
        derivative(smooth, step_px, slope)
        found[k, :, 1] = slope
        derivative(slope, step_px, smooth)
        found[k, :, 2] = smooth
    return found


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
            table[n, 12 + d] = shapes[odd, n, d]
            table[n, 15 + d], table[n, 18 + d] = shapes[odd + PROFILE, n, d], shapes[odd + PROFILE + 1, n, d]
        for k in range(PROFILE):
            table[n, 21 + k], table[n, 21 + PROFILE + k] = shapes[plain + k, n, 0], shapes[odd + k, n, 0]
    return table


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def model_rows(
    places: FloatArray,
    grey: FloatArray,
    geometry: FloatArray,
    table: FloatArray,
    first_px: float,
    step_px: float,
    light: FloatArray,
    ground: FloatArray,
    rows: FloatArray,
) -> None:
    """Fill ``rows`` (B, K) with what each unknown does to the pixels of a sector, and what the model leaves of them.

    ``geometry`` (5): where the axis meets the plane (2, px), the radius, the focal length and the blur (px); ``light``
    is that of the profile, its tilt, from aside and the waves; ``ground`` (2) is level and slope.
    """
    f, ax, ay = geometry[3], geometry[0] / geometry[3], geometry[1] / geometry[3]
    of_axis, at = 1 + ax * ax + ay * ay, np.empty(COLUMNS)
    for n in range(len(places)):
        px, py, row = places[n, 0] / f, places[n, 1] / f, rows[n]
        cx, cy, cz = py - ay, ax - px, px * ay - py * ax
        sine = np.sqrt((cx * cx + cy * cy + cz * cz) / ((1 + px * px + py * py) * of_axis))
        place = (geometry[2] - np.arcsin(sine) * f - first_px) / step_px
        place = min(max(place, 0.0), len(table) - 2.0)
        whole = int(place)
        share = place - whole
        for k in range(COLUMNS):
            at[k] = table[whole, k] + share * (table[whole + 1, k] - table[whole, k])
        away = np.sqrt(cx * cx + cy * cy) + 1e-15
        c, d = -cy / away, cx / away
        cc, dd = c * c - d * d, 2 * c * d
        tilt = light[PROFILE] * c + light[PROFILE + 1] * d
        aside = light[PROFILE + 2] * c + light[PROFILE + 3] * d
        wave = light[PROFILE + 4] * cc + light[PROFILE + 5] * dd
        other = light[PROFILE + 6] * cc + light[PROFILE + 7] * dd
        for k in range(3):
            told = ground[0] * at[k] + ground[1] * at[3 + k] + at[6 + k] + tilt * at[9 + k]
            told += aside * at[12 + k] + wave * at[15 + k] + other * at[18 + k]
            row[k] = told
        left, edge, blur = grey[n] - row[0], row[1], row[2]
        row[0], row[1], row[2], row[BLUR] = edge * c, edge * d, edge, geometry[4] * blur
        for k in range(PROFILE):
            row[LIGHT + k] = at[21 + k] + tilt * at[21 + PROFILE + k]
        row[TILT], row[TILT + 1], row[ASIDE], row[ASIDE + 1] = at[9] * c, at[9] * d, at[12] * c, at[12] * d
        row[OVAL], row[OVAL + 1], row[OVAL + 2], row[OVAL + 3] = at[15] * cc, at[15] * dd, at[18] * cc, at[18] * dd
        row[COMMON], row[COMMON + 1], row[COMMON + OWN] = at[0], at[3], left


@njit(cache=True, nogil=True, error_model="numpy")
def equations(
    places: FloatArray,
    grey: FloatArray,
    starts: Integers,
    every: int,
    geometry: FloatArray,
    table: FloatArray,
    first_px: float,
    step_px: float,
    light: FloatArray,
    grounds: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return each sector's normal matrix (S, K, K) without its own ground, and that ground's answer (S, 2, K).

    One of ``every`` so many pixels is taken. The last row and column are of what the model leaves.
    """
    count = len(starts) - 1
    reduced, answers = np.zeros((count, COMMON + 1, COMMON + 1)), np.zeros((count, OWN, COMMON + 1))
    rows = np.empty(((starts[1:] - starts[:-1]).max() // every + 1, COMMON + OWN + 1))
    for s in range(count):
        of = rows[: (starts[s + 1] - starts[s] + every - 1) // every]
        taken = slice(starts[s], starts[s + 1], every)
        model_rows(places[taken], grey[taken], geometry, table, first_px, step_px, light, grounds[s], of)
        normal = of.T @ of
        a, b, c = normal[COMMON, COMMON], normal[COMMON, COMMON + 1], normal[COMMON + 1, COMMON + 1]
        a, c = a * (1 + 1e-6) + 1e-6, c * (1 + 1e-6) + 1e-6
        det = a * c - b * b
        for k in range(COMMON + 1):
            column = k if k < COMMON else COMMON + OWN
            u, v = normal[COMMON, column], normal[COMMON + 1, column]
            answers[s, 0, k], answers[s, 1, k] = (c * u - b * v) / det, (a * v - b * u) / det
            for m in range(COMMON + 1):
                row = m if m < COMMON else COMMON + OWN
                reduced[s, m, k] = normal[row, column]
                reduced[s, m, k] -= (
                    normal[row, COMMON] * answers[s, 0, k] + normal[row, COMMON + 1] * answers[s, 1, k]
                )
    return reduced, answers
