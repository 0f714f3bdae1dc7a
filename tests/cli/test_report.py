"""``ronnaplan report`` writes one file or says why not."""

from __future__ import annotations

from pathlib import Path

import pytest

from ronnaplan.cli import main
from tests import cases


def test_a_case_becomes_a_page(tmp_path: Path) -> None:
    cases.write_case(tmp_path)
    out = tmp_path / "report.html"
    assert main(["report", str(tmp_path), "-o", str(out)]) == 0
    assert out.read_text().startswith("<!doctype html>")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("fiducials.json", "plan.json", "registration.json", "report.html")
    ]


def test_wrong_names_and_empty_folders_are_told_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(tmp_path), "-o", str(tmp_path / "report.doc")]) == 2
    assert main(["report", str(tmp_path), "-o", str(tmp_path / "report.html")]) == 1
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2
    assert list(tmp_path.iterdir()) == []
