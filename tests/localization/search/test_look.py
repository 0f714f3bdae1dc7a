"""The quick look tells what sorting all that it sees would tell."""

from __future__ import annotations

import numpy as np

from ronnaplan.localization.build import SOLID
from ronnaplan.localization.fit.cells import BACKGROUND_QUANTILE
from ronnaplan.localization.search.detect import MIN_CONTRAST_HU
from ronnaplan.localization.search.look import _share, surface_shares
from tests.scans import balls, scan, small_stack


def test_shares_are_those_of_sorted_values_and_what_is_unknown_counts_for_neither() -> None:
    draws = np.random.default_rng(1)
    for unknown in (0.0, 0.3, 1.0):
        for _ in range(20):
            inside, outside = draws.normal(800.0, 300.0, 24), draws.normal(100.0, 400.0, 24)
            inside[draws.random(24) < unknown] = np.nan
            bright, dark = np.sort(inside[np.isfinite(inside)]), np.sort(outside)
            told = 0.0
            if len(bright):
                high, low = bright[len(bright) // 2], dark[int(BACKGROUND_QUANTILE * 23)]
                middle = (high + low) / 2.0
                told = float(np.mean((inside > middle) & (outside < middle))) * bool(high - low >= MIN_CONTRAST_HU)
            assert _share(inside, outside, np.empty(24)) == told


def test_a_glance_turns_down_only_what_all_directions_would() -> None:
    seed, least = 20261128, 0.6
    volume = scan(balls([(0.0, 0.0, 0.0), (8.0, 0.0, 0.0)], 9.0), small_stack(), noise_hu=40.0)
    places = np.random.default_rng(seed).normal(0.0, 2.0, (400, 3))
    seen, in_all = (
        surface_shares(volume, places, 9.0, SOLID, np.ones(len(places)), wanted) for wanted in (least, 0.0)
    )
    np.testing.assert_array_equal(seen >= least, in_all >= least, err_msg=str(seed))
    assert (seen < in_all).any(), seed  # some were left at a glance
    assert 10 < np.count_nonzero(seen >= least) < 390, seed
