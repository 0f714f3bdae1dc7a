"""A verb whose packages are not installed says so in a sentence, before it begins anything."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from ronnaplan.cli import main
from tests import cases


@pytest.mark.parametrize(
    ("verb", "missing", "extra"),
    [
        (["view", str(cases.CT)], "aiohttp", "planner"),
        (["view", "--root", "."], "trame", "planner"),
        (["view", "--peer", "A@127.0.0.1:1"], "pynetdicom", "node"),
        (["cohort", ".", "-o", "out"], "distributed", "cohort"),
        (["cohort", ".", "-o", "out"], "pyarrow", "cohort"),
        (["node", "--config", "node.toml"], "pynetdicom", "node"),
        (["node", "--config", "node.toml"], "highdicom", "node"),
        (["pull", "--from", "A@127.0.0.1:1", "--study", "1.2", "-o", "out"], "pynetdicom", "node"),
        (["pull", "--from", "http://127.0.0.1:1/", "--study", "1.2", "-o", "out"], "dicomweb_client", "node"),
    ],
)
def test_a_missing_extra_is_told_with_what_installs_it(
    verb: list[str],
    missing: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("node.toml").write_text("")
    loaded = [name for name in sys.modules if name.split(".")[0] == missing]
    for name in {missing, *loaded}:
        monkeypatch.setitem(sys.modules, name, None)
    assert main(verb) == 1
    (told,) = capsys.readouterr().err.splitlines()
    assert f"needs {missing}; install ronnaplan[{extra}]" in told
    assert [path.name for path in tmp_path.iterdir()] == ["node.toml"]
