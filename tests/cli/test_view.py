"""``ronnaplan view`` refuses what it cannot open before anything is served."""

from __future__ import annotations

from pathlib import Path

import pytest

from ronnaplan.cli import main
from ronnaplan.cli.view import _address
from ronnaplan.errors import UsageError
from tests import cases


def test_what_cannot_be_opened_is_told_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(tmp_path / "nowhere"), "--plan", str(tmp_path / "plan.json")]) == 1
    assert main(["view", str(cases.CT), "--plan", str(tmp_path / "no" / "plan.json")]) == 1
    assert main(["view", str(cases.CT), "--tracker", "here"]) == 2
    assert main(["view", str(cases.CT), "--plan", str(tmp_path / "plan.json"), "--host", "0.0.0.0"]) == 2
    (tmp_path / "plan.json").write_text("{}")
    assert main(["view", str(cases.CT), "--plan", str(tmp_path / "plan.json")]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 5
    assert (tmp_path / "plan.json").read_text() == "{}"


def test_a_trackers_address_is_host_and_port() -> None:
    assert _address("localhost:18944") == ("localhost", 18944)
    for bad in ("localhost", ":1", "h:0", "h:99999", "h:x"):
        with pytest.raises(UsageError, match="HOST:PORT"):
            _address(bad)
