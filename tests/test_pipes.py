"""What goes from one process of the program to another."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import Frame
from ronnaplan.pipes import environment, receive, send
from ronnaplan.planning import Trajectory

GRID = SliceGrid(np.zeros((1, 3)), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))


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


class Meddling:
    """Has what holds it find another value while it is sent, as a thread that measures does."""

    def __init__(self, held_by: Any) -> None:
        self.held_by = held_by

    def __reduce__(self) -> tuple[Any, ...]:
        vars(self.held_by)["found meanwhile"] = 1
        return int, ()


@pytest.mark.parametrize(
    "thing",
    [
        GRID,
        CTVolume.from_array(np.zeros((2, 2, 2)), np.eye(4)),
        Trajectory("left", np.zeros(3), np.ones(3) * 40.0, Frame("CT")),
    ],
    ids=lambda thing: type(thing).__name__,
)
def test_what_a_thread_completes_while_it_is_sent_arrives_as_it_was(thing: Any) -> None:
    vars(thing)["held"] = Meddling(thing)
    pipe = io.BytesIO()
    send(pipe, thing)
    pipe.seek(0)
    assert "found meanwhile" in vars(thing)
    assert vars(receive(pipe))["held"] == 0
