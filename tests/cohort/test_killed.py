"""Scheduler, workers, their children and the client are killed in the midst of a run: its tables lack nothing."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest

from ronnaplan.cohort.cohort import run_cohort
from ronnaplan.cohort.rules import CohortRule, Limits, Rules
from tests.cohort.runs import FAKE, parquet
from tests.cohort.scans import tiny
from tests.cohort.under_fire import UnderFire

SEED = 5
EVERY = 2
"""Series that are begun from one kill to the next."""
MOST_S = 300.0
RULES = Rules(rule=(CohortRule(name="all", diameters=(11.5,)),), limits=Limits(attempts=1000))


def client(folder: str, scheduler: str) -> None:
    """What the client's process runs."""
    run_cohort([f"{folder}/in"], Path(folder) / "killed", RULES, scheduler=scheduler, module=FAKE)


@pytest.mark.parametrize(
    ("killed", "series"),
    [
        pytest.param(("worker 1",), 6, id="few"),
        pytest.param(
            ("scheduler", "worker 1", "worker 2", "client", "child"), 20, id="all", marks=pytest.mark.long
        ),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="children are found in /proc")
def test_whoever_is_killed_the_tables_are_those_of_a_run_in_peace(
    tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch, killed: tuple[str, ...], series: int
) -> None:
    """Of the client, of the children and of a lost scheduler there are tests of their own in `test_run`."""
    for number in range(100, 100 + series):
        tiny(tmp_path / "in", str(number))
    run_cohort([str(tmp_path / "in")], tmp_path / "peace", RULES, workers=2, module=FAKE)
    monkeypatch.setenv("FAKE_SECONDS", "0.2")
    log.write_text("")
    command = ["-c", f"from {__name__} import client; import sys; client(*sys.argv[1:])", str(tmp_path)]
    fire, draws, next_kill = UnderFire(tmp_path, command), random.Random(SEED), EVERY
    to_kill = list(killed)
    draws.shuffle(to_kill)
    try:
        for _ in range(int(MOST_S / 0.2)):
            fire.tend()
            fire.pause(0.2)
            if fire.is_done:
                break
            if to_kill and len(log.read_text().split()) >= next_kill:
                fire.kill(to_kill.pop(), draws)
                next_kill = len(log.read_text().split()) + EVERY
    finally:
        fire.close()
    told = (tmp_path / "log of processes").read_text()
    assert fire.is_done, told
    assert fire.killed.total() >= min(4, len(killed)), told
    for name in ("series.parquet", "markers.parquet"):
        ours, theirs = (parquet.read_table(tmp_path / out / name) for out in ("peace", "killed"))
        assert ours.num_rows == series
        assert ours.equals(theirs)
