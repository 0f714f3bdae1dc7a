"""Whatever is killed whenever: nothing acknowledged is lost and no series is answered twice or never."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.long import few_or_all


@pytest.mark.skipif(sys.platform != "linux", reason="children are found in /proc")
@few_or_all("kills", 1, 2)
def test_a_node_killed_amid_traffic_loses_nothing_and_answers_each_series_once(kills: int) -> None:
    command = [sys.executable, "-m", "tests.node.killing", "--kills", str(kills), "--seed", "3"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = json.loads(done.stdout)
    assert found["wrong"] == []
    assert found["acknowledged"] == 3 * found["series"]
