"""The planner is killed while a page changes its plan: what the page was told is in the file."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests import faults
from tests.long import few_or_all

ROOT = Path(__file__).resolve().parents[2]
KILL = (
    "import json, random, sys; from pathlib import Path; from tests.endurance import kill_planners; "
    "print(json.dumps(kill_planners(int(sys.argv[2]), Path(sys.argv[1]), random.Random(7))))"
)


@pytest.mark.skipif(not faults.available, reason="a loaded planner can be split off on Linux only")
@few_or_all("kills", 1, 3)
def test_a_planner_killed_at_any_time_loses_no_acknowledged_change(tmp_path: Path, kills: int) -> None:
    command = [sys.executable, "-c", KILL, str(tmp_path), str(kills)]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr
    counts = json.loads(ended.stdout)
    assert counts["killed"] == kills
    assert counts["acknowledged"] >= kills
    assert counts["lost"] == 0
