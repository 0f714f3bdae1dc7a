"""The compiled kernels of the shaded sphere: its pixels by sector, and what each unknown does to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.profiles_compiled import COLUMNS, MOST_SLANT, POWERS, PROFILE, SHADOW, SLANTS

BLUR, LIGHT = 3, 4
TILT = LIGHT + PROFILE
ASIDE = TILT + 2
FALLING = ASIDE + 2
OVAL = FALLING + 2
COMMON = OVAL + 4
"""Unknowns of the whole sphere, by where they stand: its place and radius (3), the blur, the light: the profile, its
tilt (2), light from aside (2), such as falls off to the limb (2), and waves of two periods (4)."""
OWN_GROUND, OWN_LIGHT = 2, 2
"""And of each sector: the ground and its slope; where it has a light of its own, light from aside, even and falling
off."""
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
    block: int,
    clipped_at: float,
) -> tuple[FloatArray, FloatArray, FloatArray, Integers]:
    """Return places (B, 2), brightness (B) and weights (B) of pixels of ``grey``, by sector, and each's start (S + 1).

    ``bend`` (10, 2) makes places (px, in a plane square to the line of sight) of columns and rows less ``middle`` (2),
    over ``scale``. Pixels are taken up to the first of ``bounds`` outside the ``radius``; those further beside it than
    the second are averaged over squares of ``block`` pixels a side, where they fill one and none has the brightness
    ``clipped_at``. Those that are NaN are left out.
    """
    size = grey.size
    places, values, sector = np.empty((size, 2)), np.empty(size), np.empty(size, np.int64)
    weights, starts = np.empty(size), np.zeros(sectors + 1, np.int64)
    count, half, at = 0, (block - 1) / 2, np.empty(2)
    reach = np.sqrt(2) * half
    for top in range(0, grey.shape[0], block):
        for left in range(0, grey.shape[1], block):
            low, right = min(top + block, grey.shape[0]), min(left + block, grey.shape[1])
            bent(left + half, top + half, bend, middle, scale, at)
            away = np.hypot(at[0], at[1]) - radius
            whole = -away > bounds[1] + reach or bounds[1] + reach < away < bounds[0] - reach
            whole = whole and low - top == right - left == block and grey[top:low, left:right].max() < clipped_at
            step = block if whole else 1
            for row in range(top, low, step):
                for column in range(left, right, step):
                    if not whole and not bent(column, row, bend, middle, scale, at):
                        continue
                    if np.hypot(at[0], at[1]) > radius + bounds[0] or np.isnan(grey[row, column]):
                        continue
                    places[count, 0], places[count, 1] = at[0], at[1]
                    values[count] = grey[row : row + step, column : column + step].mean()
                    weights[count] = step
                    sector[count] = int((np.arctan2(at[1], at[0]) / (2 * np.pi) + 0.5) * sectors) % sectors
                    starts[sector[count] + 1] += 1
                    count += 1
    starts = np.cumsum(starts)
    order, following = np.empty(count, np.int64), starts.copy()
    for n in range(count):
        order[following[sector[n]]] = n
        following[sector[n]] += 1
    return places[order], values[order], weights[order], starts


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def bent(column: float, row: float, bend: FloatArray, middle: FloatArray, scale: float, found: FloatArray) -> bool:
    """Fill ``found`` (2,) with the place of a pixel, as `gather` takes it; tell whether the bend is known there."""
    a, b = (column - middle[0]) / scale, (row - middle[1]) / scale
    for k in range(2):
        found[k] = bend[0, k] + a * (bend[1, k] + a * (bend[2, k] + a * bend[3, k]))
        found[k] += b * (bend[4, k] + b * (bend[5, k] + b * bend[6, k]))
        found[k] += a * b * (bend[7, k] + a * bend[8, k] + b * bend[9, k])
    return bool(a * a + b * b <= 1.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def model_rows(
    places: FloatArray,
    grey: FloatArray,
    weights: FloatArray,
    clipped_at: float,
    geometry: FloatArray,
    table: FloatArray,
    first_px: float,
    step_px: float,
    light: FloatArray,
    own: FloatArray,
    shadows: FloatArray,
    rows: FloatArray,
    sums: FloatArray,
) -> None:
    """Fill ``rows`` (B, K) with what each unknown does to the pixels of a sector, and what the model leaves of them.

    One as bright as a pixel gets, ``clipped_at``, tells nothing where the model is as bright or brighter. ``sums`` (3)
    are how many tell something, how much they tell of the edge, and what the model leaves of them, squared, as far as
    they do.
    ``geometry`` (5): where the axis meets the plane (2, px), the radius, the focal length and the blur (px); ``light``
    is that of the profile, its tilt, from aside (even, and falling off) and the waves; ``own`` (2 or 4) is the ground's
    level and slope, and light from aside (even, and falling off) of this sector alone. With ``shadows`` (SLANTS, N, 3)
    light from aside and what darkens as the cosine are of one lamp, which lights no place that it does not see.
    """
    casts = len(shadows) > 0 and light[1] > 0.0
    columns = COLUMNS if casts else SHADOW
    cast, half_angle = np.zeros(5), geometry[2] / geometry[3]
    f, ax, ay = geometry[3], geometry[0] / geometry[3], geometry[1] / geometry[3]
    of_axis, at, left_at = 1 + ax * ax + ay * ay, np.empty(COLUMNS), COMMON + len(own)
    own_aside, own_falling = (own[OWN_GROUND], own[OWN_GROUND + 1]) if len(own) > OWN_GROUND else (0.0, 0.0)
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
        falling = light[PROFILE + 4] * c + light[PROFILE + 5] * d
        wave = light[PROFILE + 6] * cc + light[PROFILE + 7] * dd
        other = light[PROFILE + 8] * cc + light[PROFILE + 9] * dd
        if casts:
            cast_by(shadows, light[1], aside, half_angle, whole, share, at, cast)
        for k in range(3):
            told = cast[k] + own[0] * at[k] + own[1] * at[3 + k] + at[6 + k] + tilt * at[9 + k]
            told += (
                (aside + own_aside) * at[12 + k]
                + (falling + own_falling) * at[15 + k]
                + wave * at[18 + k]
                + other * at[21 + k]
            )
            row[k] = told
        if grey[n] >= clipped_at and row[0] >= clipped_at:
            row[:] = 0.0
            continue
        left, edge, blur = grey[n] - row[0], row[1], row[2]
        sums[0] += 1.0
        sums[1] += edge * edge
        sums[2] += edge * edge * left * left
        row[0], row[1], row[2], row[BLUR] = edge * c, edge * d, edge, geometry[4] * blur
        for k in range(PROFILE):
            row[LIGHT + k] = at[POWERS + k] + tilt * at[POWERS + PROFILE + k]
        row[LIGHT + 1] += cast[3]
        row[TILT], row[TILT + 1] = at[9] * c, at[9] * d
        row[ASIDE], row[ASIDE + 1] = (at[12] + cast[4]) * c, (at[12] + cast[4]) * d
        row[FALLING], row[FALLING + 1] = at[15] * c, at[15] * d
        row[OVAL], row[OVAL + 1], row[OVAL + 2], row[OVAL + 3] = at[18] * cc, at[18] * dd, at[21] * cc, at[21] * dd
        row[COMMON], row[COMMON + 1], row[left_at] = at[0], at[3], left
        if len(own) > OWN_GROUND:
            row[COMMON + OWN_GROUND], row[COMMON + OWN_GROUND + 1] = at[12], at[15]
        if weights[n] != 1.0:
            row *= weights[n]


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
            cast[k] = facing * half_angle * at[18 + k]
        cast[3], cast[4] = half_angle * at[18], 0.0
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
            cast[3], cast[4] = lit - aside / facing * by_slant - at[POWERS + 1], by_slant - at[12]


@njit(cache=True, nogil=True, error_model="numpy")
def equations(
    places: FloatArray,
    grey: FloatArray,
    weights: FloatArray,
    starts: Integers,
    every: int,
    clipped_at: float,
    geometry: FloatArray,
    table: FloatArray,
    first_px: float,
    step_px: float,
    light: FloatArray,
    owns: FloatArray,
    held: FloatArray,
    shadows: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return each sector's normal matrix (S, K, K) without its own unknowns (S, P), and the answer (S, P, K) of these.

    The last row and column are of what the model leaves. ``owns`` are held at nothing by the weights ``held`` (P).
    Also what `model_rows` tells of the sector's pixels (S, 3), of which one of ``every`` so many is taken.
    """
    count, own = owns.shape
    sums = np.zeros((count, 3))
    reduced, answers = np.zeros((count, COMMON + 1, COMMON + 1)), np.zeros((count, own, COMMON + 1))
    rows = np.empty(((starts[1:] - starts[:-1]).max() // every + 1, COMMON + own + 1))
    for s in range(count):
        of = rows[: (starts[s + 1] - starts[s] + every - 1) // every]
        taken = slice(starts[s], starts[s + 1], every)
        fit = geometry, table, first_px, step_px, light, owns[s], shadows
        model_rows(places[taken], grey[taken], weights[taken], clipped_at, *fit, of, sums[s])
        normal, last = of.T @ of, COMMON + own
        for k in range(own):
            at = COMMON + k
            normal[at, at] = (normal[at, at] + held[k]) * (1 + 1e-6) + 1e-6
            normal[at, last] -= held[k] * owns[s, k]
            normal[last, at] = normal[at, last]
            normal[last, last] += held[k] * owns[s, k] ** 2
        for k in range(own):  # Gauss and Jordan
            at = COMMON + k
            normal[at] /= normal[at, at]
            for m in range(last + 1):
                if m != at:
                    normal[m] -= normal[m, at] * normal[at]
        for k in range(COMMON + 1):
            column = k if k < COMMON else last
            for m in range(own):
                answers[s, m, k] = normal[COMMON + m, column]
            for m in range(COMMON + 1):
                reduced[s, m, k] = normal[m if m < COMMON else last, column]
    return reduced, answers, sums
