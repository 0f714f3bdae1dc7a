"""Child processes of the program."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ronnaplan import __version__
from ronnaplan.jobs.processes import Child


def test_a_child_is_of_this_very_package_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Begun in a folder with another copy of the source it was of that one."""
    for folder in (tmp_path / "other", tmp_path / "here"):
        (folder / "ronnaplan").mkdir(parents=True)
        (folder / "ronnaplan" / "__init__.py").touch()
    monkeypatch.setenv("PYTHONPATH", os.fspath(tmp_path / "other"))
    monkeypatch.chdir(tmp_path / "here")
    said: list[str] = []
    child = Child("ronnaplan", ["--version"], said.append, {})
    child.end()
    assert (child.status, "".join(said).split()) == (0, ["ronnaplan", __version__])
