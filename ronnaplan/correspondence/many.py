"""Many sets of one kind matched in one compiled loop, for studies."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.correspondence.evidence import filled_volume, is_collinear
from ronnaplan.correspondence.exact import LISTED_NATS, best_of, search
from ronnaplan.correspondence.rivals import mirror_is_better, other_body, regular_odds
from ronnaplan.geometry import FloatArray

CLEAR_OF_OTHERS = 1e-5
"""A second body less probable than this changes no answer."""


@njit(cache=True, nogil=True, error_model="numpy")
def match_many(
    ct: FloatArray,
    ots: FloatArray,
    variance: float,
    sizes: tuple[FloatArray, float],
    residual: tuple[FloatArray, FloatArray],
    spread: float,
) -> tuple[NDArray[np.int16], FloatArray]:
    """Match T sets (T, n, 3), (T, m, 3) of one variance: partners (T, n) and probability (T,) of the best.

    ``sizes`` and ``residual``: what `priors.size_priors` and `priors.residual_priors` return.  A probability of 0
    marks what has to be looked at more closely: a search that gave up, points on a line, a set whose mirror image
    fits better, a second body, and regular markers.
    """
    tests, n, m = len(ct), ct.shape[1], ots.shape[1]
    weight, node_value = np.full((n, m), 1.0 / variance), np.full((n, m), -1.5 * math.log(variance))
    known = np.zeros((0, 2), np.int64)
    partners, probability = np.full((tests, n), -1, np.int16), np.zeros(tests)
    size_constants, background = sizes
    steps = np.arange(len(size_constants)) - 1.0
    for t in range(tests):
        volume = filled_volume(ct[t], ots[t])
        constants = size_constants + steps * math.log(volume)
        log_evidence, listed, complete = search(
            ct[t], ots[t], weight, node_value, constants, known, spread, LISTED_NATS, -np.inf
        )
        best, p = best_of(log_evidence, background)
        if best < 0:
            continue
        partners[t] = listed[best]
        paired, top = listed[best] >= 0, log_evidence[best]
        if not complete or is_collinear(ct[t][paired], math.sqrt(variance)):
            continue
        body = other_body(ct[t], ots[t], weight, node_value, residual[0], residual[1], volume, listed[best])
        regular = regular_odds(ct[t], ots[t], weight, spread, log_evidence, listed, best, background)
        if max(body[1], regular) > CLEAR_OF_OTHERS:
            continue
        size = paired.sum()
        if not mirror_is_better(ct[t], ots[t], weight, node_value, constants, known, spread, size, top):
            probability[t] = p
    return partners, probability
