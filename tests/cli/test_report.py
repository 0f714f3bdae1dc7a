"""``ronnaplan report`` writes one file or says why not."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from ronnaplan.cli import main
from ronnaplan.errors import InputError
from tests import cases


def test_a_case_becomes_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cases.write_case(tmp_path)
    out = tmp_path / "report.html"
    assert main(["report", str(tmp_path), "-o", str(out)]) == 0
    assert "the scan is not at hand, so that the report shows and measures nothing" in capsys.readouterr().err
    assert out.read_text().startswith("<!doctype html>")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("fiducials.json", "plan.json", "registration.json", "report.html")
    ]


def test_the_head_is_shown_and_where_it_cannot_be_made_the_report_is_written_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("ronnaplan.report.overview.SHAPE", (70, 100))
    (cases.write_case(tmp_path) / "fiducials.json").unlink()  # cuts of markers take long to draw
    out = tmp_path / "report.html"
    ask = ["report", str(tmp_path), "--ct", str(cases.CT), "--name", "case <7>\udcff", "-o", str(out)]
    assert main(ask) == 0
    page = out.read_text()
    assert r"<h1>Quality report: case &lt;7&gt;\udcff</h1>" in page
    scene = re.findall(r'id="scene">(.*?)</script>', page, re.DOTALL)
    assert {"path left", "skull", "skin"} <= {thing["name"] for thing in json.loads(scene[0])["things"]}

    def none_here(case: object) -> None:
        raise InputError("3-D surfaces need pyvista; install ronnaplan[scene]")

    monkeypatch.setattr("ronnaplan.report.overview.view_of", none_here)
    (tmp_path / "plan.json").unlink()  # what is drawn of paths takes long, too
    capsys.readouterr()
    assert main([*ask, "--paper", "Letter"]) == 0
    assert "the report shows no head in 3-D: 3-D surfaces need pyvista" in capsys.readouterr().err
    assert 'id="scene"' not in out.read_text()
    assert "size: Letter" in out.read_text()


def test_the_measures_of_a_case_become_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cases.write_case(tmp_path)
    ask = ["report", str(tmp_path), "--name", "=case", "-o", str(tmp_path / "measures.csv")]
    assert main(ask) == 1
    assert "no trajectory can be measured in it; give it with --ct" in capsys.readouterr().err
    assert main([*ask, "--ct", str(cases.CT), "--paper", "Letter"]) == 2
    assert "a table of measures is printed on no paper; leave out --paper" in capsys.readouterr().err
    assert main([*ask, "--ct", str(cases.CT)]) == 0
    head, row = (tmp_path / "measures.csv").read_text().splitlines()
    assert head.startswith("case,name,length_mm,")
    assert row.startswith("'=case,left,71.")  # no formula


def test_wrong_names_and_empty_folders_are_told_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(tmp_path), "-o", str(tmp_path / "report.doc")]) == 2
    assert main(["report", str(tmp_path), "-o", str(tmp_path / "report.html")]) == 1
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2
    assert list(tmp_path.iterdir()) == []


def test_a_place_where_nothing_can_be_written_is_told_before_the_case_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ronnaplan.case.folder.read_case", None)
    cases.write_case(tmp_path)
    assert main(["report", str(tmp_path), "-o", str(tmp_path / "nowhere" / "report.pdf")]) == 1
    assert "nowhere does not exist; make it first" in capsys.readouterr().err
