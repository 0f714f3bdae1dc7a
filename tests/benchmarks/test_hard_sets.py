"""The hard sets are sets that `match_points` takes, of any size."""

from __future__ import annotations

import pytest

from benchmarks.hard_sets import hard_sets
from ronnaplan.correspondence.inputs import checked_points


@pytest.mark.parametrize("count", [8, 24, 32, 200])
def test_every_set_is_one_of_points_in_millimetres(count: int) -> None:
    """Few points at one place spread over less than a millimetre: with 24 the run ended in a traceback."""
    for name, sets in hard_sets(count):
        for points in sets:
            assert checked_points(points, name).shape[1] == 3
