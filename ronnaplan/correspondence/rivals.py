"""What else may be the patient than the most probable pairing: its mirror image, another body, another order.

Numba kernels over what `exact.search` lists.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.correspondence.evidence import FEW_PAIRS, GATE_CHI2, SCALES, fits_as_well, log_misfit, log_misfit_at
from ronnaplan.correspondence.exact import in_volume, not_by_chance, search
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.refining import lie_beside
from ronnaplan.correspondence.told import LEAST_PAIRS
from ronnaplan.geometry import FloatArray

LOG_ODDS_PER_PAIR = 1.6
"""Of two bodies that both sets hold, the one with more pairs is the patient, by these log odds for each pair more:
three pairs more are needed for 0.99, and equal bodies are always refused."""

LOG_ODDS_OF_MIRROR = math.log(100.0)
"""A mirror image is believed where it is so much more probable. Noise makes that of flat markers so in fewer than one
of a hundred cases: it fits them as well on average (Markov's inequality)."""

BODY_GATE_CHI2 = 200.0
"""Pairs of a second body exceed this chi^2 nowhere: a wider gate finds more of them among outliers by chance."""

RIGID_GATE_CHI2 = 12.0
"""Nor those of a body that is part of what seemed one with larger errors: 3.5 standard deviations as stated. A wider
gate takes markers for a body that moved each by itself."""

LEAST_REGULAR = 5
"""Fewer pairs fit otherwise, too, by chance; of so many it shows that the markers are laid out regularly."""

BODY_NATS = 1.0
"""Of another body the most probable pairings tell enough: those this near to the best."""


class Left(NamedTuple):
    """The points that a pairing leaves, and what pairs them: L pairings of a second body, or of what met by chance."""

    i: IntArray
    """The CT points (n,), by their place in the whole set."""
    j: IntArray
    """The OTS points (m,)."""
    constants: FloatArray
    """See `exact.in_volume`, of so many points."""
    background: float
    log_evidence: FloatArray
    """(L,)."""
    partners: NDArray[np.int16]
    """The place in ``j`` of what each of ``i`` is paired with (L, n), -1 for none."""
    complete: bool
    """Whether none was given up."""


@njit(cache=True, nogil=True, error_model="numpy")
def mirror_is_better(
    ct: FloatArray,
    ots: FloatArray,
    weight: FloatArray,
    node_value: FloatArray,
    constants: FloatArray,
    known: IntArray,
    spread: float,
    size: int,
    log_evidence: float,
) -> bool:
    """Tell whether the mirror image of the CT points pairs ``size`` or more points far better than ``log_evidence``.

    Then one of the sets is left-handed, and what fits without a reflection is a flat part of it, or nearly flat.  The
    arguments are those of `exact.search`.
    """
    mirrored, as_large = ct.copy(), constants.copy()
    for i in range(len(mirrored)):
        mirrored[i, 0] = -mirrored[i, 0]
    as_large[:size] = -np.inf
    better = log_evidence + LOG_ODDS_OF_MIRROR
    found = search(mirrored, ots, weight, node_value, as_large, known, spread, 1.0, better, GATE_CHI2)[0]
    return len(found) > 0 and bool(found.max() > better)


@njit(cache=True, nogil=True, error_model="numpy")
def pairings_left(
    ct: FloatArray,
    ots: FloatArray,
    weight: FloatArray,
    node_value: FloatArray,
    constants: FloatArray,
    backgrounds: FloatArray,
    volume: float,
    partner: NDArray[np.int16],
    nats: float,
    gate_chi2: float,
) -> Left:
    """List the pairings, within ``nats`` of the best, of the points that ``partner`` (n,) leaves.

    ``weight`` and ``node_value`` (n, m): as `exact.search` takes them, of all points; ``constants`` and
    ``backgrounds``: of `residual_priors`.  None is listed where fewer than three points of a set are left.
    """
    taken = np.zeros(len(ots), np.bool_)
    for j in partner:
        if j >= 0:
            taken[j] = True
    i, j = np.flatnonzero(partner < 0), np.flatnonzero(~taken)
    size, most = len(ct) - len(i), min(len(i), len(j))
    own, background = in_volume(constants[size, : most + 1], volume), backgrounds[size]
    if most < LEAST_PAIRS:
        return Left(i, j, own, background, np.empty(0), np.empty((0, len(i)), np.int16), True)
    log_evidence, _, partners, complete = search(
        ct[i],
        ots[j],
        weight[i][:, j],
        node_value[i][:, j],
        own,
        np.zeros((0, 2), np.int64),
        np.inf,
        nats,
        background - 5.0,
        gate_chi2,
    )
    return Left(i, j, own, background, log_evidence, partners, complete)


@njit(cache=True, nogil=True, error_model="numpy")
def second_readings(
    ct: FloatArray, ots: FloatArray, weight: FloatArray, partner: IntArray, other: IntArray
) -> tuple[int, int]:
    """Return how many pairs of ``other`` (n,) have a second reading in place of a point of ``partner`` (n,): CT, OTS.

    The two `lie_beside` each other.  ``weight`` (n, m): of each possible pair.
    """
    of_ct, of_ots = 0, 0
    for b in range(len(partner)):
        if partner[b] < 0 or other[b] == partner[b]:
            continue
        if other[b] >= 0:
            variance = 1.0 / max(weight[b, other[b]], weight[b, partner[b]])
            of_ots += lie_beside(ots, other[b], partner[b], variance)
        for a in np.flatnonzero(other == partner[b]):
            of_ct += lie_beside(ct, a, b, 1.0 / max(weight[a, partner[b]], weight[b, partner[b]]))
    return of_ct, of_ots


@njit(cache=True, nogil=True, error_model="numpy")
def regular_odds(
    ct: FloatArray,
    ots: FloatArray,
    weight: FloatArray,
    log_evidence: FloatArray,
    chi2: FloatArray,
    partners: IntArray,
    best: int,
    background: float,
) -> float:
    """Return the odds, to the ``best`` of L listed pairings, of one that pairs the points otherwise and fits as well.

    Such points are laid out regularly, and the noise of many makes evidences differ by more than is told apart: only
    pairs more count, by `LOG_ODDS_PER_PAIR` each.  0 where nothing fits as well.  One that has `second_readings` of one
    set in place of some points is no other order, if the pairs that agree hold the pose; where both sets hold some,
    these may pair with each other.
    """
    size, odds, of_ct, of_ots = (partners[best] >= 0).sum(), 0.0, 0.0, 0.0
    if size < LEAST_REGULAR:
        return 0.0
    for a in range(len(partners)):
        other = (partners[a] >= 0).sum()
        agree = ((partners[a] >= 0) & (partners[a] == partners[best])).sum()
        if other < LEAST_REGULAR or 2 * agree > other:
            continue
        real = not_by_chance(log_evidence[a], background)
        here = real * math.exp(-LOG_ODDS_PER_PAIR * max(size - other, 0))
        if here <= odds or not fits_as_well(chi2[best], size, chi2[a], other):
            continue
        ct_seconds, ots_seconds = second_readings(ct, ots, weight, partners[best], partners[a])
        if agree < LEAST_PAIRS:
            odds = here
        elif ct_seconds == 0 and 2 * (agree + ots_seconds) > other:
            of_ots = max(of_ots, here)
        elif ots_seconds == 0 and 2 * (agree + ct_seconds) > other:
            of_ct = max(of_ct, here)
        else:
            odds = here
    return max(odds, min(of_ct, of_ots))


@njit(cache=True, nogil=True, error_model="numpy")
def odds_if_larger(
    log_evidence: FloatArray,
    chi2: FloatArray,
    partners: IntArray,
    core: IntArray,
) -> float:
    """Return the odds, to the pairs of ``core`` (n,), of what pairs otherwise were its errors the largest of `SCALES`.

    ``log_evidence`` and ``chi2`` (L,) and ``partners`` (L, n): what `exact.search` lists.  0 for more than `FEW_PAIRS`.
    """
    top, held, others = log_evidence.max(), 0.0, 0.0
    if (core >= 0).sum() > FEW_PAIRS:
        return 0.0
    for a in range(len(partners)):
        if ((core < 0) | (partners[a] == core)).all():
            held += math.exp(log_evidence[a] - top)
        else:
            size = (partners[a] >= 0).sum()
            larger = log_misfit_at(chi2[a], size, SCALES[-1]) - log_misfit(chi2[a], size)
            others += math.exp(log_evidence[a] + larger - top)
    return others / held
