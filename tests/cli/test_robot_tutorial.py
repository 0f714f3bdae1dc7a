"""The page's way from a phantom's scan to a placed robot and a printed template, as it is printed."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from ronnaplan.cli import main
from ronnaplan.documents.placement import read_placement
from ronnaplan.documents.template import read_template_document

ROOT = Path(__file__).resolve().parents[2]
HEADING = "### From a phantom scan to a placed robot and a printed template"
HEIGHTS = "z = [800, 1000]"


def commands() -> list[list[str]]:
    page = (ROOT / "docs" / "robot.md").read_text(encoding="utf-8")
    block = "\n".join(
        line[4:] for line in page.split(HEADING)[1].split("\n## ")[0].splitlines() if line[:4] == " " * 4
    )
    return [shlex.split(line, comments=True)[1:] for line in block.replace("\\\n", " ").splitlines()]


def test_every_command_of_the_page_does_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run = [[str(ROOT / word) if word.startswith("data/") else word for word in line] for line in commands()]
    assert {tuple(line[:2]) for line in run} >= {("robot", "place"), ("plan", "template"), ("report", ".")}
    for line in run:
        capsys.readouterr()
        words, _, target = " ".join(line).partition(" > ")
        assert main(line[: len(line) - 2] if target else line) == 0, words
        if target:
            room = capsys.readouterr().out
            assert HEIGHTS in room
            Path(target).write_text(room.replace(HEIGHTS, "z = [800, 800]"))  # as the page says: "and edit it"
    placed = read_placement(tmp_path / "placement.json")
    assert placed.status == "placed"
    assert {one.name for one in placed.robot_from_ct[0].tasks} == {"LH", *(f"F{n}" for n in range(1, 7))}
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Placement of the robot" in page
    assert "the robot at the first place" in page
    assert len(read_template_document(tmp_path / "template.json").labels) == 4
    assert (tmp_path / "template.stl").stat().st_size > 10_000
