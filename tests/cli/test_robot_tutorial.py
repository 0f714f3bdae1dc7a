"""The page's way from a phantom's scan to a placed robot and a printed template, as it is printed."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from phantoms.robot_session import SESSION_SEED, Session
from ronnaplan.cli import command_parser, main
from ronnaplan.documents.placement import read_placement
from ronnaplan.documents.template import read_template_document
from tests.cli.chains import parked_chain

ROOT = Path(__file__).resolve().parents[2]
HEADING = "### From a phantom scan to a placed robot and a printed template"
EDITED = {
    "x = [-1100, 700]": "x = [-1100, -1100]",
    "y = [-1100, 1100]": "y = [-100, -100]",
    "z = [800, 1000]": "z = [800, 800]",
    "# x_axis = [1, 0, 0]": "x_axis = [1, 0, 0]",
}
"""One place of the floor, near which the session parked, and the tool's x axis, as the page says: "and edit it"."""


def commands() -> list[list[str]]:
    page = (ROOT / "docs" / "robot.md").read_text(encoding="utf-8")
    block = "\n".join(
        line[4:] for line in page.split(HEADING)[1].split("\n## ")[0].splitlines() if line[:4] == " " * 4
    )
    return [shlex.split(line, comments=True)[1:] for line in block.replace("\\\n", " ").splitlines()]


def test_every_command_of_the_page_is_one_that_there_is() -> None:
    run = [line[: line.index(">")] if ">" in line else line for line in commands()]
    assert len(run) > 5
    for line in run:
        command_parser().parse_args(line)


@pytest.mark.long
def test_every_command_of_the_page_does_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ronnaplan.report.overview.SHAPE", (70, 100))
    run = [[str(ROOT / word) if word.startswith("data/") else word for word in line] for line in commands()]
    assert {tuple(line[:2]) for line in run} >= {("robot", "place"), ("plan", "template"), ("report", ".")}
    told = ""
    for line in run:
        words, _, target = " ".join(line).partition(" > ")
        assert main(line[: len(line) - 2] if target else line) == 0, words
        said = capsys.readouterr()
        told += said.err
        if target:
            room = said.out
            for old, new in EDITED.items():
                assert old in room
                room = room.replace(old, new)
            Path(target).write_text(room)
    placed = read_placement(tmp_path / "placement.json")
    assert placed.status == "placed"
    assert {one.name for one in placed.robot_from_ct[0].tasks} == {"LH", *(f"F{n}" for n in range(1, 7))}
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Placement of the robot" in page
    assert "the robot at the first place" in page
    assert len(read_template_document(tmp_path / "template.json").labels) == 4
    assert (tmp_path / "template.stl").stat().st_size > 10_000
    assert "the tracker stands at" not in told
    session = Session.of_case(ROOT / "data" / "synthetic_ct", SESSION_SEED)
    chain = parked_chain(placed.source.model_dump(), session.robot_from_ots @ session.ots_from_ct)
    (tmp_path / "chain.json").write_text(json.dumps(chain))
    (place,) = (line for line in run if "placement.json" in line)
    assert main([*place, "--chain", "chain.json"]) == 0
    parked = read_placement(tmp_path / "placement.json")
    assert parked.status == "parked"
    bases_mm = [np.array(one.robot_from_ct[0].room_from_r)[:3, 3] for one in (placed, parked)]
    assert np.linalg.norm(bases_mm[1] - bases_mm[0]) < 60.0
    assert main(["robot", "export", "chain.json", "plan.json", "--placement", "placement.json"]) == 0
