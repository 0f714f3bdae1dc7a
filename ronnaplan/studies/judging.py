"""How one block of tests is judged: the outcomes of the matchers, and the calibration of what they state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.correspondence.told import Told
from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM
from ronnaplan.studies.blocks import Record
from ronnaplan.studies.scenes import Scenes

STRICT_PROBABILITY = 0.9999
"""The second level of acceptance that is judged: `match_points` names it for a guarantee on each answer."""
PROBABILITY_EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999, 0.9999, 0.99999, 1.0)
"""Bins of stated probability for the calibration table."""


def judge_exact(scenes: Scenes, told: Told) -> Record:
    """Return the outcomes of the exact matcher at both levels of acceptance, and its calibration.

    The best pairings come from one kernel for all tests; what is not clear at once is asked of `match_points`.
    """
    from ronnaplan.correspondence.evidence import MOST_ODDS_IF_LARGER
    from ronnaplan.correspondence.many import match_many
    from ronnaplan.correspondence.pairing import LEAST_PROBABILITY
    from ronnaplan.correspondence.priors import SPREAD_MM, residual_priors, size_priors

    counts = (scenes.ct.shape[1], scenes.ots.shape[1])
    variance = SIGMA_CT_MM**2 + SIGMA_OTS_MM**2
    partner, probability, larger = match_many(
        scenes.ct, scenes.ots, variance, size_priors(counts, told), residual_priors(counts), SPREAD_MM
    )
    allowed = np.array([told.allows(size) for size in range(min(counts) + 1)])[(partner >= 0).sum(axis=1)]
    stands = allowed & (larger <= MOST_ODDS_IF_LARGER)
    record: Record = {}
    for name, level in (("exact", LEAST_PROBABILITY), ("strict", STRICT_PROBABILITY)):
        given = np.where((stands & (probability >= level))[:, None], partner, -1)
        for test in np.flatnonzero((given < 0).all(axis=1)):
            given[test] = pairing_of(scenes, int(test), told, level)
        record[name] = outcomes(given, scenes.partner)
    stated = probability > 0
    record["calibration"] = calibration(probability[stated], (partner == scenes.partner).all(axis=1)[stated])
    return record


def pairing_of(scenes: Scenes, test: int, told: Told, level: float) -> NDArray[np.int64]:
    """Return the OTS partner of each CT point (n,) that `match_points` gives in one test."""
    from ronnaplan.correspondence import match_points

    answer = match_points(
        scenes.ct[test], scenes.ots[test], told.expected, at_least=told.at_least, least_probability=level
    )
    partner = np.full(scenes.ct.shape[1], -1)
    partner[answer.pairs[:, 0]] = answer.pairs[:, 1]
    return partner


def judge_published(scenes: Scenes, expected: int, one_to_one: bool) -> list[int]:
    """Return the outcomes of the published algorithm, e from 1 to 6 mm by 0.1 mm."""
    from ronnaplan.correspondence.similarity import similarity_match_many

    partner = similarity_match_many(scenes.ct, scenes.ots, expected, 1.0, 6.0, 0.1, one_to_one)
    return outcomes(partner, scenes.partner)


def outcomes(given: NDArray[np.int64], true: NDArray[np.int64]) -> list[int]:
    """Return the numbers of right, unsuccessful and wrong answers, partners (T, n) given and true.

    Wrong is an answer that holds a false pair; unsuccessful one that is refused or leaves a marker out.
    """
    wrong = ((given >= 0) & (given != true)).any(axis=1)
    right = (given == true).all(axis=1)
    return [int(right.sum()), int((~right & ~wrong).sum()), int(wrong.sum())]


def calibration(probability: FloatArray, right: NDArray[np.bool_]) -> list[list[float]]:
    """Return of answers (N,) for each bin of stated probability: how many, right ones, sum of the probabilities."""
    bins = np.digitize(probability, PROBABILITY_EDGES[1:-1])
    count = len(PROBABILITY_EDGES) - 1
    sums = [np.bincount(bins, weights, count) for weights in (np.ones(len(bins)), right, probability)]
    return [[float(value) for value in row] for row in np.column_stack(sums)]
