"""What is believed about a pairing before the points are looked at: how many pairs, and how large the errors."""

from __future__ import annotations

import math
from functools import cache, lru_cache

import numpy as np

from kernelcache import njit
from ronnaplan.correspondence.evidence import FEW_PAIRS, GATE_CHI2, LOOSE_CHI2, SCALE_PRIORS, SCALES
from ronnaplan.correspondence.told import LEAST_PAIRS, Told
from ronnaplan.geometry import FloatArray
from ronnaplan.rigid import freedom

SPREAD_MM = 60.0
"""Standard deviation per axis of markers about their center: on a head."""


@njit(cache=True, nogil=True, error_model="numpy")
def log_pairings(ct_count: int, ots_count: int, size: int, known: int) -> float:
    """Return the log of the number of pairings of ``size`` pairs that contain ``known`` given ones."""
    n, m, k = ct_count - known, ots_count - known, size - known
    return (
        math.lgamma(n + 1)
        - math.lgamma(n - k + 1)
        + math.lgamma(m + 1)
        - math.lgamma(m - k + 1)
        - math.lgamma(k + 1)
    )


def size_constant(size: int) -> float:
    """Return the terms of log E that depend on the number of pairs only, but for (k-1) ln V."""
    return 1.5 * (size - 1) - math.log(8.0 * math.pi**2) + (3.0 - 1.5 * size) * math.log(2.0 * math.pi)


def size_priors(counts: tuple[int, int], told: Told, known: int = 0) -> tuple[FloatArray, float]:
    """Return the log prior and `size_constant` of each number of pairs, and the log weight of the background.

    ``counts``: number of CT and of OTS points.  The first result is indexed by the number of pairs, -inf where a
    pairing of that size is impossible.  The background is "nothing pairs" and the pairings outside the gate.
    Every pairing of one size is equally probable.
    """
    most = min(counts)
    sizes = range(max(LEAST_PAIRS, known), most + 1)
    prior = told.prior(sizes)
    constants = np.full(most + 1, -np.inf)
    background = prior[0]
    for size in sizes:
        if prior[size] > 0:
            constants[size] = math.log(prior[size]) - log_pairings(*counts, size, known) + size_constant(size)
        background += prior[size] * tail_beyond_gate(size)
    return constants, math.log(background)


@lru_cache(maxsize=64)
def residual_priors(counts: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return what `size_priors` does for the points that each number of pairs leaves, of which nothing is told.

    The first result is indexed by the number of pairs taken away and the number of pairs among the rest.
    """
    most = min(counts)
    constants, background = np.full((most + 1, most + 1), -np.inf), np.zeros(most + 1)
    for taken in range(most - LEAST_PAIRS + 1):
        own, background[taken] = size_priors((counts[0] - taken, counts[1] - taken), Told())
        constants[taken, : len(own)] = own
    return constants, background


@cache
def tail_beyond_gate(size: int) -> float:
    """Return the probability that the gate leaves a true pairing of ``size`` pairs out, at most.

    Of a true pairing, the difference of the two distances between two pairs is normal, so its chi^2 has one degree of
    freedom; a pairing is left out where any two of its pairs exceed the gate (Boole's inequality).  Of more than
    `FEW_PAIRS` pairs the bound is looser, see `LOOSE_CHI2`.
    """
    from scipy.special import gammaincc

    of_few = size <= FEW_PAIRS
    half_freedom, beyond = (0.5, GATE_CHI2) if of_few else (freedom(size) / 2.0, LOOSE_CHI2)
    tails = [gammaincc(half_freedom, 0.5 * beyond / scale**2) for scale in SCALES]
    return float(np.dot(SCALE_PRIORS, tails)) * (math.comb(size, 2) if of_few else 1)
