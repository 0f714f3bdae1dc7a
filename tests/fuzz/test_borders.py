from collections import Counter
from pathlib import Path

import pytest

from tests.fuzz.border import FAILED, try_one
from tests.fuzz.borders import BORDERS, made
from tests.long import few_or_all

SEED = 20
"""The figures of long runs of `scripts/fuzz` are of other seeds."""


@few_or_all("part", 3, 1)
@pytest.mark.parametrize("name", BORDERS)
def test_hostile_inputs_are_refused_or_read_as_they_say(name: str, part: int, tmp_path: Path) -> None:
    border = made(BORDERS[name])
    tried = border.inputs_in_tests // part
    border.check_seeds(tmp_path)
    outcomes: Counter[str] = Counter()
    for number in range(tried):
        kind, outcome = try_one(border, number, SEED, tmp_path)
        assert not outcome.startswith(FAILED), f"input {number} of {name} ({kind}): {outcome}"
        outcomes[outcome] += 1
    for expected in border.expected_outcomes:
        assert outcomes[expected] > tried // 10, outcomes
