"""The demonstration finds what is there, and says how the command is found."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.cli import demo
from ronnaplan.scene.portrait import head_picture
from tests.cli.calls import run

ROOT = Path(__file__).resolve().parents[2]
SMALL = (100, 100)
"""Pixels of the picture of the head: rows, columns."""


def test_the_demo_finds_every_marker_within_0_03_mm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("ronnaplan.report.picture.head_picture", partial(head_picture, shape=SMALL))
    status, out, _ = run(["demo", "--output-dir", str(tmp_path / "demo")], capsys)
    assert status == 0
    truth = json.loads((ROOT / "data" / "synthetic_ct" / "truth.json").read_text())["markers"]
    found = json.loads((tmp_path / "demo" / "fiducials.json").read_text())["fiducials"]
    assert len(found) == len(truth)
    centers = np.array([marker["center"] for marker in truth])
    for one in found:
        assert np.linalg.norm(centers - one["center"], axis=1).min() < 0.03
    assert (tmp_path / "demo" / "markers.png").read_bytes().startswith(b"\x89PNG")
    assert "markers.png" in out
    assert "not a medical device" in out


def test_the_demo_says_how_the_command_is_found_only_where_it_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.prefix", str(tmp_path / ".venv"))
    monkeypatch.setattr("shutil.which", lambda _: None)
    assert demo._first() == ""
    for folder, shown in (
        ("Scripts", " (after '.venv/Scripts/activate')"),
        ("bin", " (after '. .venv/bin/activate')"),
    ):
        (tmp_path / ".venv" / folder).mkdir(parents=True)
        (tmp_path / ".venv" / folder / "activate").touch()
        assert shown in demo._first()
    monkeypatch.setattr("shutil.which", lambda _: "/somewhere/ronnaplan")
    assert demo._first() == ""
