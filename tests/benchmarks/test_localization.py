"""The localization study, small: the markers of rendered patients are found within the goals, their decoys are not."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.cases import CONDITIONS, surroundings
from benchmarks.localization import Score

TUNED = 8000
"""The first seed of the rendered patients that the fit was tuned on: the study's own patients stay unseen."""


@pytest.mark.parametrize("name", ["thick", "titanium"])
def test_a_patients_markers_are_found_within_the_goals_and_his_decoys_are_not(name: str) -> None:
    condition = next(one for one in CONDITIONS if one.name == name)
    score = Score()
    for case in surroundings(condition, TUNED, 0):
        score.add(case)
    assert (score.markers, score.missed, score.false) == (condition.markers, 0, 0)
    assert np.mean(score.errors_mm) < condition.mean_mm
    assert max(score.errors_mm) < condition.worst_mm
    assert 0.25 < np.mean(score.normalized) / 3 < 4.0  # one patient's dozen scatters widely
