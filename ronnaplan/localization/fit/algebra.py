"""Sums of products, small equations and quantiles for compiled functions.

Numba's own go through LAPACK, for which it loads SciPy: that takes longer than finding a scan's markers, and a dozen
megabytes.
"""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def add_products(told: FloatArray, seen: int, products: FloatArray) -> None:
    """Add to ``products`` (P, Q) those of the first P rows of ``told`` (Q, N) with all rows, as far as ``seen``."""
    count, size = products.shape
    for p in range(0, count, 2):
        for q in range(p, size, 2):  # two by two: what is loaded counts twice
            r, s = min(p + 1, count - 1), min(q + 1, size - 1)
            one, two, first, second = told[p], told[r], told[q], told[s]
            one_first = one_second = two_first = two_second = 0.0
            for n in range(seen):
                one_first += one[n] * first[n]
                one_second += one[n] * second[n]
                two_first += two[n] * first[n]
                two_second += two[n] * second[n]
            if s == q:  # the last row is taken twice where their number is odd
                one_second = two_second = 0.0
            if r == p:
                two_first = two_second = 0.0
            if q == p:  # the same as the one above the diagonal
                two_first = 0.0
            for i, j, total in ((p, q, one_first), (p, s, one_second), (r, q, two_first), (r, s, two_second)):
                products[i, j] += total
                if i != j and j < count:
                    products[j, i] += total


@njit(cache=True, nogil=True, error_model="numpy")
def solve(equations: FloatArray, solved: FloatArray) -> None:
    """Fill ``solved`` (P,) from normal equations with their right side (P, P + 1), which are eliminated in place.

    Equations that tell nothing have no solution: then all of it is not finite.
    """
    count = len(solved)
    for p in range(count):
        for q in range(p + 1, count):
            share = equations[q, p] / equations[p, p]
            for c in range(p, count + 1):
                equations[q, c] -= share * equations[p, c]
    for back in range(count):
        p = count - 1 - back
        left = equations[p, count]
        for c in range(p + 1, count):
            left -= equations[p, c] * solved[c]
        solved[p] = left / equations[p, p]


@njit(cache=True, nogil=True)
def expected_gain(information: FloatArray, slope: FloatArray, step: FloatArray) -> float:
    """Return by how much a ``step`` (P,) lessens half a sum of squares, by its normal equations (P, P) and (P,)."""
    gain = 0.0
    for p in range(len(step)):
        bend = 0.0
        for q in range(len(step)):
            bend += information[p, q] * step[q]
        gain += step[p] * (slope[p] - 0.5 * bend)
    return gain


LEAST_LEFT = 1e-12
"""What is left of a parameter's information beside the other parameters', as a share, if these do not tell it."""


@njit(cache=True, error_model="numpy")
def inverse(information: FloatArray) -> FloatArray:
    """Return the inverse of normal equations (P, P) whose parameters have any units.

    A parameter of which they tell nothing, or nothing beside those before it, is held: its row and column are zero
    (the sweep operator; J. Goodnight, The American Statistician 33:149, 1979).
    """
    count, swept = len(information), information.copy()
    for p in range(count):
        pivot = swept[p, p]
        if not pivot > LEAST_LEFT * information[p, p]:
            swept[p, :] = 0.0
            swept[:, p] = 0.0
            continue
        for c in range(count):
            swept[p, c] /= pivot
        for q in range(count):
            share = swept[q, p]
            if q != p and share != 0.0:
                for c in range(count):
                    swept[q, c] -= share * swept[p, c]
                swept[q, p] = -share / pivot
        swept[p, p] = 1.0 / pivot
    return swept


@njit(cache=True, nogil=True)
def quantile(values: FloatArray, share: float) -> float:
    """Return what this ``share`` of the known values (N,) reach at most; NaN where none is known."""
    known, count = np.empty(len(values)), 0
    for value in values:
        if not math.isnan(value):
            known[count] = value
            count += 1
    if count == 0:
        return math.nan
    place = share * (count - 1)
    below = int(place)
    low = ranked(known[:count], below)
    high = low if below + 1 == count else min(known[below + 1 : count])  # what ranks higher stands behind it now
    return float(low + (place - below) * (high - low))


@njit(cache=True, nogil=True)
def ranked(values: FloatArray, rank: int) -> float:
    """Return what would have the ``rank`` of ``values`` (M,) if they were sorted; puts them in another order.

    By Hoare's FIND, Comm. ACM 4:321, 1961.
    """
    low, high = 0, len(values) - 1
    while low < high:
        pivot, i, j = values[rank], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < rank:
            low = i
        if rank < i:
            high = j
    return float(values[rank])
