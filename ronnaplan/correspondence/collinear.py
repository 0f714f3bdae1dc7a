"""Whether points lie on one line within their errors, so that the turn about it is undetermined, in numba kernels."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.correspondence.evidence import cofactors, determinant
from ronnaplan.geometry import FloatArray

COLLINEAR_SIGMAS = 3.0
"""Paired points closer to a line than this many standard deviations (root mean square) are collinear."""

LEAST_OFF_LINE = 3
"""So many pairs that lie off the line of all others determine a pose by themselves."""


@njit(cache=True, nogil=True, error_model="numpy")
def beyond_line(points: FloatArray, variances: FloatArray, off: NDArray[np.bool_]) -> float:
    """Return the sum of squares, in variances, by which points (k, 3) lie farther from one line than collinear ones.

    Of those but the ones that are ``off`` (k,); ``variances`` (k,) are per axis.  Negative where they are collinear.
    """
    total, count, mean, m = 0.0, 0, np.zeros(3), np.zeros((3, 3))
    for a in range(len(points)):
        if not off[a]:
            total, count = total + 1.0 / variances[a], count + 1
            for c in range(3):
                mean[c] += points[a, c] / variances[a]
    for a in range(len(points)):
        if not off[a]:
            for c in range(3):
                for d in range(3):
                    m[c, d] += (points[a, c] - mean[c] / total) * (points[a, d] - mean[d] / total) / variances[a]
    beyond: float = m[0, 0] + m[1, 1] + m[2, 2] - largest_eigenvalue(m) - count * COLLINEAR_SIGMAS**2
    return beyond


@njit(cache=True, nogil=True, error_model="numpy")
def off_one_line(points: FloatArray, variances: FloatArray) -> NDArray[np.bool_]:
    """Return which of points (k, 3) the turn about a line rests on, within their errors, on which all others lie.

    Three where it rests on three or more: these determine a pose by themselves.
    """
    off = np.zeros(len(points), np.bool_)
    for _ in range(LEAST_OFF_LINE):
        if beyond_line(points, variances, off) < 0.0:
            break
        nearest, least = 0, math.inf
        for a in range(len(points)):
            if not off[a]:
                off[a] = True
                beyond = beyond_line(points, variances, off)
                off[a] = False
                if beyond < least:
                    nearest, least = a, beyond
        off[nearest] = True
    return off


@njit(cache=True, nogil=True, error_model="numpy")
def is_collinear(points: FloatArray, variances: FloatArray) -> bool:
    """Tell whether points (k, 3) lie on a line within their errors, so that the turn about it is undetermined.

    ``variances`` (k,) are per axis: how far off a line a point lies counts in units of its own error.
    """
    return beyond_line(points, variances, np.zeros(len(points), np.bool_)) < 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def largest_eigenvalue(m: FloatArray) -> float:
    """Return the largest eigenvalue of a symmetric 3x3 matrix (Smith 1961); to load LAPACK takes 10 ms."""
    third: float = (m[0, 0] + m[1, 1] + m[2, 2]) / 3.0
    rest = m.copy()
    square = 0.0
    for c in range(3):
        rest[c, c] -= third
        for d in range(3):
            square += rest[c, d] * rest[c, d]
    size = math.sqrt(square / 6.0)
    if size == 0.0:
        return third
    for c in range(3):
        for d in range(3):
            rest[c, d] /= size
    turn = min(max(0.5 * determinant(rest, cofactors(rest)), -1.0), 1.0)
    largest: float = third + 2.0 * size * math.cos(math.acos(turn) / 3.0)
    return largest
