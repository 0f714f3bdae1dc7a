"""Child processes of the program."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ronnaplan import __version__
from ronnaplan.jobs.processes import Child


def test_a_child_is_of_this_very_package_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "other" / "ronnaplan"
    other.mkdir(parents=True)
    (other / "__init__.py").touch()
    monkeypatch.setenv("PYTHONPATH", os.fspath(other.parent))
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    child = Child("ronnaplan", ["--version"], said.append, {})
    child.end()
    assert (child.status, "".join(said).split()) == (0, ["ronnaplan", __version__])
