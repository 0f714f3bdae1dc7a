from collections import Counter
from pathlib import Path

import pytest

from tests.fuzz.border import FAILED, try_one
from tests.fuzz.borders import BORDERS, made

SEED = 20
"""The figures of long runs of `scripts/fuzz` are of other seeds."""


@pytest.mark.parametrize("name", BORDERS)
def test_hostile_inputs_are_refused_or_read_as_they_say(name: str, tmp_path: Path) -> None:
    border = made(BORDERS[name])
    border.check_seeds(tmp_path)
    outcomes: Counter[str] = Counter()
    for number in range(border.inputs_in_tests):
        kind, outcome = try_one(border, number, SEED, tmp_path)
        assert not outcome.startswith(FAILED), f"input {number} of {name} ({kind}): {outcome}"
        outcomes[outcome] += 1
    for expected in border.expected_outcomes:
        assert outcomes[expected] > border.inputs_in_tests // 10, outcomes
