"""How a value and its limit are written, so that nobody takes the one for the other."""

from __future__ import annotations

import numpy as np

from ronnaplan.planning.limits import Verdict
from ronnaplan.planning.rows import value_and_limit


def test_a_value_beyond_its_limit_is_never_written_like_the_limit() -> None:
    def written(value: float, limit: float) -> tuple[str, str]:
        return value_and_limit(Verdict("T", "error", value, "mm", limit, value <= limit))

    assert written(0.5, 0.75) == ("0.50", "0.75")
    assert written(0.75, 0.75) == ("0.75", "0.75")
    assert written(0.7504, 0.75) == ("0.7504", "0.7500")
    assert written(np.nextafter(0.75, 1.0), 0.75) == ("0.75", "0.75")


def test_a_limit_is_written_as_it_was_stated() -> None:
    """One of 0.485 was told as 0.48, and one of 0.996 as 1.00."""
    for value, limit, told in ((0.487, 0.485, ("0.487", "0.485")), (0.991, 0.996, ("0.991", "0.996"))):
        assert value_and_limit(Verdict("T", "error", value, "mm", limit, passes=False)) == told
    summed = Verdict("T", "error", 0.31, "mm", 0.1 + 0.2, passes=False)
    assert value_and_limit(summed) == ("0.31", "0.30"), "a sum's last binary digit is nobody's statement"
