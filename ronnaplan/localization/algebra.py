"""Sums of products and small equations for compiled functions.

Numba's own go through LAPACK, for which it loads SciPy: that takes longer than finding a scan's markers, and a dozen
megabytes.
"""

from __future__ import annotations

from kernelcache import njit
from ronnaplan.geometry import FloatArray


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def add_products(told: FloatArray, products: FloatArray) -> None:
    """Add to ``products`` (P, Q) those of the first P rows of ``told`` (Q, N) with all of its rows."""
    count, size = products.shape
    for p in range(count):
        one = told[p]
        for q in range(p, size):
            other, total = told[q], 0.0
            for n in range(len(one)):
                total += one[n] * other[n]
            products[p, q] += total
            if p < q < count:
                products[q, p] += total


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
