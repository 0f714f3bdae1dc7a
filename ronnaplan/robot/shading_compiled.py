"""The compiled kernels of the shaded sphere: its pixels by sector, and what each unknown does to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.profiles_compiled import COLUMNS, MOST_SLANT, PROFILE, SHADOW, SLANTS

PLACE, BLUR, LIGHT = 0, 3, 4
TILT = LIGHT + PROFILE
ASIDE = TILT + 2
OVAL = ASIDE + 2
COMMON = OVAL + 4
"""Unknowns of the whole sphere, by where they stand: its place and radius (3), the blur, the light: the profile, its
tilt (2), light from aside (2), and waves of two periods (4)."""
OWN = 2
"""And of each sector: the ground, and its slope."""
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
def model_rows(
    places: FloatArray,
    grey: FloatArray,
    geometry: FloatArray,
    table: FloatArray,
    first_px: float,
    step_px: float,
    light: FloatArray,
    ground: FloatArray,
    shadows: FloatArray,
    rows: FloatArray,
) -> None:
    """Fill ``rows`` (B, K) with what each unknown does to the pixels of a sector, and what the model leaves of them.

    ``geometry`` (5): where the axis meets the plane (2, px), the radius, the focal length and the blur (px); ``light``
    is that of the profile, its tilt, from aside and the waves; ``ground`` (2) is level and slope. With ``shadows``
    (SLANTS, N, 3) light from aside and what darkens as the cosine are of one lamp, which lights no place that it does
    not see.
    """
    casts = len(shadows) > 0 and light[1] > 0.0
    columns = COLUMNS if casts else SHADOW
    cast, half_angle = np.zeros(5), geometry[2] / geometry[3]
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
        for k in range(columns):
            at[k] = table[whole, k] + share * (table[whole + 1, k] - table[whole, k])
        away = np.sqrt(cx * cx + cy * cy) + 1e-15
        c, d = -cy / away, cx / away
        cc, dd = c * c - d * d, 2 * c * d
        tilt = light[PROFILE] * c + light[PROFILE + 1] * d
        aside = light[PROFILE + 2] * c + light[PROFILE + 3] * d
        wave = light[PROFILE + 4] * cc + light[PROFILE + 5] * dd
        other = light[PROFILE + 6] * cc + light[PROFILE + 7] * dd
        if casts:
            cast_by(shadows, light[1], aside, half_angle, whole, share, at, cast)
        for k in range(3):
            told = cast[k] + ground[0] * at[k] + ground[1] * at[3 + k] + at[6 + k] + tilt * at[9 + k]
            told += aside * at[12 + k] + wave * at[15 + k] + other * at[18 + k]
            row[k] = told
        left, edge, blur = grey[n] - row[0], row[1], row[2]
        row[0], row[1], row[2], row[BLUR] = edge * c, edge * d, edge, geometry[4] * blur
        for k in range(PROFILE):
            row[LIGHT + k] = at[21 + k] + tilt * at[21 + PROFILE + k]
        row[LIGHT + 1] += cast[3]
        row[TILT], row[TILT + 1] = at[9] * c, at[9] * d
        row[ASIDE], row[ASIDE + 1] = (at[12] + cast[4]) * c, (at[12] + cast[4]) * d
        row[OVAL], row[OVAL + 1], row[OVAL + 2], row[OVAL + 3] = at[15] * cc, at[15] * dd, at[18] * cc, at[18] * dd
        row[COMMON], row[COMMON + 1], row[COMMON + OWN] = at[0], at[3], left


@njit(cache=True, nogil=True, error_model="numpy")
def cast_by(
    shadows: FloatArray,
    facing: float,
    aside: float,
    half_angle: float,
    whole: int,
    share: float,
    at: FloatArray,
    cast: FloatArray,
) -> None:
    """Fill ``cast`` (5) with what a lamp's shadows change at a depth: the brightness, two derivatives, two unknowns.

    The lamp's light is ``facing`` and ``aside``, at this side of the sphere. ``at`` (COLUMNS) is the table there.
    """
    if aside >= 0.0:
        for k in range(3):
            cast[k] = facing * half_angle * at[15 + k]
        cast[3], cast[4] = half_angle * at[15], 0.0
        return
    step = MOST_SLANT / (SLANTS - 1)
    place = max((aside / facing + MOST_SLANT) / step, 0.0)
    k = min(int(place), SLANTS - 2)
    between = place - k
    for n in range(3):
        low = shadows[k, whole, n] + share * (shadows[k, whole + 1, n] - shadows[k, whole, n])
        high = shadows[k + 1, whole, n] + share * (shadows[k + 1, whole + 1, n] - shadows[k + 1, whole, n])
        lit = low + between * (high - low)
        cast[n] = facing * lit - at[SHADOW + n] - aside * at[12 + n]
        if n == 0:
            by_slant = (high - low) / step
            cast[3], cast[4] = lit - aside / facing * by_slant - at[22], by_slant - at[12]


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
    shadows: FloatArray,
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
        model_rows(places[taken], grey[taken], geometry, table, first_px, step_px, light, grounds[s], shadows, of)
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
