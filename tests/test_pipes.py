"""What goes from one process of the program to another."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ronnaplan.pipes import environment


def test_another_process_finds_this_very_package_from_any_folder_before_what_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "other" / "ronnaplan"
    other.mkdir(parents=True)
    (other / "__init__.py").touch()
    monkeypatch.setenv("PYTHONPATH", os.fspath(other.parent))
    command = [sys.executable, "-c", "import ronnaplan, sys; print(ronnaplan.__file__, *sys.path, sep='\\n')"]
    told = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True)
    file, *paths = told.stdout.splitlines()
    assert Path(file) == Path(__file__).resolve().parents[1] / "ronnaplan" / "__init__.py"
    assert os.fspath(other.parent) in paths


def test_no_path_is_empty_where_none_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty one would be the folder that the process is begun in."""
    monkeypatch.delenv("PYTHONPATH", raising=False)
    assert environment()["PYTHONPATH"] == os.fspath(Path(__file__).resolve().parents[1])


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_letters_that_another_process_says_arrive_whatever_those_of_a_region_are(
    monkeypatch: pytest.MonkeyPatch, stream: str
) -> None:
    monkeypatch.setenv("PYTHONIOENCODING", "cp1252")  # what Windows takes by itself for a pipe
    command = [sys.executable, "-c", f"import sys; print('M\\xfcller \\u03c3', file=sys.{stream})"]
    told = subprocess.run(command, env=environment(), capture_output=True, check=True)
    assert (told.stdout + told.stderr).decode().strip() == "Müller σ"
