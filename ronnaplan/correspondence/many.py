"""Many sets of one kind matched in one compiled loop, for studies."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.correspondence.collinear import is_collinear
from ronnaplan.correspondence.evidence import GATE_CHI2, filled_volume
from ronnaplan.correspondence.exact import LISTED_NATS, best_of, in_volume, search
from ronnaplan.correspondence.rivals import (
    BODY_GATE_CHI2,
    BODY_NATS,
    mirror_is_better,
    odds_if_larger,
    pairings_left,
    regular_odds,
)
from ronnaplan.correspondence.strays import side_by_side
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
) -> tuple[NDArray[np.int16], FloatArray, FloatArray]:
    """Match T sets (T, n, 3), (T, m, 3) of one variance: partners (T, n) of the best, and how sure it is.

    ``sizes`` and ``residual``: what `priors.size_priors` and `priors.residual_priors` return.  Of the best, the others
    are the probability (T,) and `rivals.odds_if_larger` (T,).  A probability of 0 marks what has to be looked at more
    closely: a search that gave up, points on a line, pairs side by side, a set whose mirror image fits better, a second
    body, and regular markers.
    """
    tests, n, m = len(ct), ct.shape[1], ots.shape[1]
    weight, node_value = np.full((n, m), 1.0 / variance), np.full((n, m), -1.5 * math.log(variance))
    known = np.zeros((0, 2), np.int64)
    partners, probability, larger = np.full((tests, n), -1, np.int16), np.zeros(tests), np.zeros(tests)
    size_constants, background = sizes
    for t in range(tests):
        volume = filled_volume(ct[t], ots[t])
        constants = in_volume(size_constants, volume)
        log_evidence, chi2, listed, complete = search(
            ct[t], ots[t], weight, node_value, constants, known, spread, LISTED_NATS, -np.inf, GATE_CHI2
        )
        best, p = best_of(log_evidence, background)
        if best < 0:
            continue
        partners[t] = listed[best]
        paired, to_beat = listed[best] >= 0, max(log_evidence[best], background)
        of_pairs, partner = np.full(paired.sum(), variance), listed[best][paired]
        if not complete or is_collinear(ct[t][paired], of_pairs):
            continue
        if side_by_side(ct[t][paired], ots[t][partner], of_pairs).any():
            continue
        left = pairings_left(
            ct[t],
            ots[t],
            weight,
            node_value,
            residual[0],
            residual[1],
            volume,
            listed[best],
            BODY_NATS,
            BODY_GATE_CHI2,
        )
        _, body = best_of(left.log_evidence, left.background)
        wide = listed.astype(np.int64)  # as `small` hands them on: compiled once
        regular = regular_odds(ct[t], ots[t], weight, log_evidence, chi2, wide, best, background)
        if max(body, regular) > CLEAR_OF_OTHERS:
            continue
        size = paired.sum()
        if not mirror_is_better(ct[t], ots[t], weight, node_value, constants, known, spread, size, to_beat):
            probability[t] = p
            larger[t] = odds_if_larger(log_evidence, chi2, wide, wide[best])
    return partners, probability, larger
