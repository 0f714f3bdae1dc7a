"""Runs of a cohort by the fake child: what it began, and what the tables say."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.cohort.cohort import Counts, run_cohort
from ronnaplan.cohort.rules import CohortRule, Limits, Rules

pytest.importorskip("distributed")
parquet = pytest.importorskip("pyarrow.parquet")

FAKE = "tests.cohort.fake_work"
RULE = CohortRule(name="all", diameters=(11.5,))


def begun(log: Path) -> Counter[str]:
    found = Counter(line.rpartition(".")[2] for line in log.read_text().split())
    log.write_text("")
    return found


def cohort(tmp_path: Path, rule: CohortRule = RULE, limits: Limits | None = None, **given: Any) -> Counts:
    rules = Rules(rule=(rule,), limits=limits or Limits())
    return run_cohort([str(tmp_path / "in")], tmp_path / "out", rules, module=FAKE, workers=1, **given)


def table(tmp_path: Path, name: str = "series", out: str = "out") -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = parquet.read_table(tmp_path / out / f"{name}.parquet").to_pylist()
    return rows
