import tempfile
import warnings
from collections import Counter
from pathlib import Path

from tests.ct.fuzzing import read_all, seeds, try_one

INPUTS, SEED = 6000, 20
"""About 15 s; the figures of a run of 100,000 stand in docs/reading.md."""


def test_mutated_files_are_refused_or_read_where_their_headers_say() -> None:
    series = seeds()
    outcomes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        read_all(series, Path(folder))
        for number in range(INPUTS):
            kind, outcome = try_one(series, number, SEED, Path(folder))
            assert not outcome.startswith("FAILED"), f"input {number} ({kind}): {outcome}"
            outcomes[outcome] += 1
    assert outcomes["refused"] > INPUTS // 5
    assert outcomes["read"] > INPUTS // 5
