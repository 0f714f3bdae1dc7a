"""Three pairs have to stand against errors of the largest scale that is believed in, too."""

import numpy as np
import pytest

from ronnaplan.correspondence import match_points
from ronnaplan.correspondence.evidence import FEW_PAIRS, MOST_ODDS_IF_LARGER, SCALE_PRIORS, SCALES, log_misfit
from ronnaplan.correspondence.many import match_many
from ronnaplan.correspondence.pairing import LEAST_PROBABILITY
from ronnaplan.correspondence.priors import residual_priors, size_priors
from ronnaplan.correspondence.rivals import odds_if_larger
from ronnaplan.correspondence.told import Told
from ronnaplan.geometry import FloatArray
from ronnaplan.studies.heads import HEADS_MM
from ronnaplan.studies.scenes import simulate_scenes
from tests.correspondence.scenes import SIGMA_CT, SIGMA_OTS

REASON = "were the errors 4 times as large as stated"


def triangle(difference_mm: float) -> FloatArray:
    """Markers of which two sides differ so much, about."""
    return np.array([[-40.0, 0, 0], [40, 0, 0], [0.5 * difference_mm, 90, 0]])


def test_three_pairs_that_others_would_rival_were_errors_larger_are_refused_with_a_way_out() -> None:
    ct = triangle(7.0)
    ots = 1.01 * ct
    refused = match_points(ct, ots, expected=3)
    assert refused.status == "ambiguous"
    assert REASON in refused.reason
    assert len(refused.pairs) == 0
    assert refused.touch is not None
    touched = match_points(ct, ots, expected=3, known_pairs=[(refused.touch, refused.touch)])
    assert touched.status == "unique"
    clear = match_points(triangle(20.0), 1.01 * triangle(20.0), expected=3)
    assert clear.status == "unique"


def test_what_is_stated_of_them_stays_the_posterior() -> None:
    refused = match_points(triangle(7.0), 1.01 * triangle(7.0), expected=3)
    weights = [np.exp(-rival.log_evidence_below) for rival in refused.rivals]
    assert refused.probability == pytest.approx(1.0 / sum(weights), abs=1e-4)
    assert refused.probability > LEAST_PROBABILITY


def test_full_covariances_are_held_to_the_same() -> None:
    ct = triangle(7.0)
    covariances = [np.tile(sigma**2 * np.eye(3), (3, 1, 1)) for sigma in (SIGMA_CT, SIGMA_OTS)]
    full = match_points(
        ct, 1.01 * ct, expected=3, covariances_ct_mm2=covariances[0], covariances_ots_mm2=covariances[1]
    )
    assert REASON in full.reason


def test_the_odds_are_those_of_errors_of_the_largest_scale() -> None:
    """By hand: each pairing's evidence with its likelihood at that scale in place of that of all scales."""
    log_evidence, chi2 = np.array([5.0, 3.0, 1.0, 0.5]), np.array([4.0, 20.0, 60.0, 9.0])
    partners = np.array([[0, 1, 2, -1], [1, 0, 2, -1], [0, 1, -1, 3], [0, 1, 2, 3]])
    others = sum(
        np.exp(log_evidence[a] - log_misfit(chi2[a], 3))
        * SCALES[-1] ** -3
        * np.exp(-chi2[a] / 2 / SCALES[-1] ** 2)
        for a in (1, 2)
    )
    held = np.exp(5.0) + np.exp(0.5)
    assert odds_if_larger(log_evidence, chi2, partners, partners[0]) == pytest.approx(others / held)
    assert odds_if_larger(log_evidence, chi2, partners, partners[3]) == 0.0
    assert FEW_PAIRS == 3
    assert SCALE_PRIORS[-1] * MOST_ODDS_IF_LARGER < 1.0 - LEAST_PROBABILITY


def test_errors_four_times_as_large_give_fewer_wrong_answers() -> None:
    """Without the condition the posterior alone accepts twice as many."""
    scenes = simulate_scenes(np.random.default_rng([4, 0, 1]), HEADS_MM[1], 20_000, 3, 0, noise=4.0)
    priors = size_priors((3, 3), Told(expected=3)), residual_priors((3, 3))
    partner, probability, odds = match_many(scenes.ct, scenes.ots, SIGMA_CT**2 + SIGMA_OTS**2, *priors, 60.0)
    sure, stands = probability >= LEAST_PROBABILITY, odds <= MOST_ODDS_IF_LARGER
    wrong = (partner != scenes.partner).any(axis=1)
    assert 2 * (sure & stands & wrong).sum() <= (sure & wrong).sum()
    assert (sure & stands).sum() > 0.98 * sure.sum()
    for test in np.flatnonzero(sure & ~stands & wrong):
        assert REASON in match_points(scenes.ct[test], scenes.ots[test], expected=3).reason
    for test in np.flatnonzero(sure & stands)[:50]:
        assert match_points(scenes.ct[test], scenes.ots[test], expected=3).status == "unique"
