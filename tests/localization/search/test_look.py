"""The quick look tells what sorting all that it sees would tell."""

from __future__ import annotations

import numpy as np

from ronnaplan.localization.fit.directions import BACKGROUND_QUANTILE
from ronnaplan.localization.search.detect import MIN_CONTRAST_HU
from ronnaplan.localization.search.look import _share


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
