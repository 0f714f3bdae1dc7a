"""The compiled kernels of the limb: pixels by sector, normal equations of the sectors, and the light within."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray

SHADES = 5
"""Unknown brightnesses of a sector: the ground, its slope, and the sphere's three."""
UNKNOWNS = SHADES + 2
"""And the place of the edge, and the blur."""
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@njit(cache=True, nogil=True, error_model="numpy")
def between(at: float, places: FloatArray) -> tuple[int, float]:
    """Return after which of the rising ``places`` (N) ``at`` lies, and by what share of the way to the next."""
    low, high = 0, len(places) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if places[middle] <= at:
            low = middle
        else:
            high = middle
    return low, (at - places[low]) / (places[low + 1] - places[low])


@njit(cache=True, nogil=True, error_model="numpy")
def lay_out(
    grey: FloatArray,
    center: FloatArray,
    outline: FloatArray,
    bounds: tuple[float, float, float],
    seen: Flags,
) -> tuple[FloatArray, FloatArray, Integers, FloatArray, FloatArray, Integers]:
    """Tell the pixels of ``grey`` (rows, columns) apart by their depth in an outline.

    ``outline`` (3, N) holds angles about ``center`` (2), once around and one more at either end, the radii there and
    the cosines between normal and radius. Depths (px) between the first two ``bounds`` are beside the edge; deeper
    than the third, in a sector that is ``seen`` (S), within. Returns grey (B) and depth (B) beside the edge, sector by
    sector, where each sector starts (S + 1), and grey (L), offset (L, 2; in radii) and sector (L) of those within.
    """
    count = len(seen)
    size = grey.size
    reach = outline[1].max() - bounds[0]
    depths, pixels, sectors = np.empty(size), np.empty((size, 2), np.int64), np.empty(size, np.int64)
    light, offsets, of_light = np.empty(size), np.empty((size, 2)), np.empty(size, np.int64)
    starts = np.zeros(count + 1, np.int64)
    beside = within = 0
    for row in range(grey.shape[0]):
        for column in range(grey.shape[1]):
            x, y = column - center[0], row - center[1]
            distance = np.sqrt(x * x + y * y)
            if distance >= reach:
                continue
            angle = np.arctan2(y, x)
            k, share = between(angle, outline[0])
            radius = outline[1, k] + share * (outline[1, k + 1] - outline[1, k])
            depth = (radius - distance) * (outline[2, k] + share * (outline[2, k + 1] - outline[2, k]))
            sector = int((angle / (2 * np.pi) + 0.5) * count) % count
            if bounds[0] < depth < bounds[1]:
                depths[beside], pixels[beside, 0], pixels[beside, 1] = depth, row, column
                sectors[beside] = sector
                starts[sector + 1] += 1
                beside += 1
            if depth > bounds[2] and seen[sector]:
                light[within], of_light[within] = grey[row, column], sector
                offsets[within, 0], offsets[within, 1] = x / radius, y / radius
                within += 1
    starts = np.cumsum(starts)
    free = starts.copy()
    sorted_grey, sorted_depth = np.empty(beside), np.empty(beside)
    for n in range(beside):
        place = free[sectors[n]]
        free[sectors[n]] += 1
        sorted_grey[place], sorted_depth[place] = grey[pixels[n, 0], pixels[n, 1]], depths[n]
    return sorted_grey, sorted_depth, starts, light[:within], offsets[:within], of_light[:within]


@njit(cache=True, nogil=True, error_model="numpy")
def with_derivatives(blurred: FloatArray, step_px: float) -> FloatArray:
    """Return ``blurred`` (5, N) and its first two derivatives as a table (N, 15)."""
    rows, length = blurred.shape
    table = np.empty((length, 3 * rows))
    table[:, :rows] = blurred.T
    for k in range(rows, 3 * rows):
        for n in range(length):
            low, high = max(n - 1, 0), min(n + 1, length - 1)
            table[n, k] = (table[high, k - rows] - table[low, k - rows]) / ((high - low) * step_px)
    return table


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def model_row(at: float, table: FloatArray, shades: FloatArray, blur_px: float, row: FloatArray) -> None:
    """Fill ``row`` (7) with what each unknown does to a pixel whose depth is ``at`` steps of the ``table``."""
    at = min(max(at, 0.0), len(table) - 2.0)
    n = int(at)
    share = at - n
    edge = blur = 0.0
    for k in range(SHADES):
        row[k] = table[n, k] + share * (table[n + 1, k] - table[n, k])
        first = table[n, SHADES + k] + share * (table[n + 1, SHADES + k] - table[n, SHADES + k])
        second = table[n, 2 * SHADES + k] + share * (table[n + 1, 2 * SHADES + k] - table[n, 2 * SHADES + k])
        edge += first * shades[k]
        blur += second * shades[k]
    row[SHADES] = edge
    row[SHADES + 1] = blur_px * blur


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(
    grey: FloatArray, steps: FloatArray, starts: Integers, table: FloatArray, shades: FloatArray, blur_px: float
) -> tuple[FloatArray, FloatArray]:
    """Return normal matrix (S, 7, 7) and right side (S, 7) of each sector, with the ``shades`` (S, 5) that it has.

    Its pixels' ``grey`` (B) and depth, in ``steps`` (B) of the ``table``, stand from ``starts`` (S + 1) on.
    """
    normal, goal = np.zeros((len(shades), UNKNOWNS, UNKNOWNS)), np.zeros((len(shades), UNKNOWNS))
    row = np.empty(UNKNOWNS)
    for s in range(len(shades)):
        for n in range(starts[s], starts[s + 1]):
            model_row(steps[n], table, shades[s], blur_px, row)
            for a in range(UNKNOWNS):
                goal[s, a] += row[a] * grey[n]
                for b in range(a + 1):
                    normal[s, a, b] += row[a] * row[b]
        mirror(normal[s])
    return normal, goal


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def mirror(square: FloatArray) -> None:
    """Fill what is above the diagonal of ``square`` (K, K) by what is below."""
    for a in range(len(square)):
        for b in range(a):
            square[b, a] = square[a, b]


@njit(cache=True, nogil=True, error_model="numpy")
def squares_left(
    grey: FloatArray,
    steps: FloatArray,
    starts: Integers,
    table: FloatArray,
    shades: FloatArray,
    blur_px: float,
    found: FloatArray,
) -> FloatArray:
    """Return each sector's sum of squares (S) that the unknowns ``found`` (S, 7) leave; else as above."""
    squares = np.zeros(len(shades))
    row = np.empty(UNKNOWNS)
    for s in range(len(shades)):
        for n in range(starts[s], starts[s + 1]):
            model_row(steps[n], table, shades[s], blur_px, row)
            left = grey[n]
            for a in range(UNKNOWNS):
                left -= row[a] * found[s, a]
            squares[s] += left * left
    return squares


@njit(cache=True, nogil=True, error_model="numpy")
def least_deviations(design: FloatArray, grey: FloatArray, rounds: int) -> tuple[FloatArray, FloatArray, float]:
    """Fit ``grey`` (L) by ``design`` (L, K) towards least absolute deviations: part of a ball may be hidden or glare.

    Returns what was found (K), the absolute deviations (L) and their noise.
    """
    weights = np.ones(len(design))
    found = np.zeros(design.shape[1])
    left, noise = np.empty(len(design)), 0.0
    size = design.shape[1]
    for _ in range(rounds):
        normal, goal = 1e-6 * np.eye(size), np.zeros(size)
        for n in range(len(design)):
            for a in range(size):
                turned = weights[n] * design[n, a]
                goal[a] += turned * grey[n]
                for b in range(a + 1):
                    normal[a, b] += turned * design[n, b]
        mirror(normal)
        found[:] = np.linalg.solve(normal, goal)
        for n in range(len(design)):
            model = 0.0
            for a in range(size):
                model += design[n, a] * found[a]
            left[n] = abs(grey[n] - model)
        noise = 1.4826 * float(np.median(left)) + 1e-3
        for n in range(len(design)):
            weights[n] = 1 / max(left[n], noise)
    return found, left, noise
