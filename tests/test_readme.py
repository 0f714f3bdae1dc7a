"""The README is true: its commands run from top to bottom as printed, and so does its Python."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from ronnaplan.cli import command_parser, main
from ronnaplan.errors import InputError
from tests.long import few_or_all

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SMALL = (70, 100)
"""Pixels of the report's picture of the head: rows, columns."""
COARSE = {"--matrix 256": "--matrix 64 --spacing 5"}
"""What is printed of a phantom -> what is scanned: with fewer pixels and slices."""
SERVERS = ("view",)
"""Verbs that do not end by themselves; their arguments are parsed."""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("readme")
    (folder / "data").symlink_to(ROOT / "data")
    return folder


def commands(text: str) -> list[list[str]]:
    """Return the indented ``ronnaplan`` commands, those over several lines put together."""
    block = "\n".join(line[4:] for line in text.splitlines() if line.startswith("    "))
    lines = block.replace("\\\n", " ").splitlines()
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("ronnaplan ")]


def undrawn(_: object) -> None:
    raise InputError("the head is looked at in cli/test_report.py")


@few_or_all("with_head", False, True)
def test_every_command_runs_as_printed(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], with_head: bool
) -> None:
    """But for the picture of the head in its report, which takes longer than all else."""
    monkeypatch.chdir(home)
    monkeypatch.setattr("ronnaplan.report.overview.SHAPE", SMALL)
    if not with_head:
        monkeypatch.setattr("ronnaplan.report.overview.view_of", undrawn)
    text = README
    for printed, coarse in COARSE.items():
        assert printed in text
        text = text.replace(printed, coarse)
    run = commands(text)
    assert len(run) > 10
    for arguments in run:
        if arguments[0] in SERVERS:
            command_parser().parse_args(arguments)
            continue
        assert main(arguments) == 0, (arguments, capsys.readouterr().err)
    told = capsys.readouterr()
    assert "markers' centroid" in told.err
    assert {"fiducials.json", "registration.json", "report.html", "ct_from_ots.tfm", "expected_error.nii.gz"} <= {
        path.name for path in home.iterdir()
    }


def test_the_python_runs_as_printed(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(home)
    (block,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(block, "README.md", "exec"), {})
    told = capsys.readouterr().out
    assert "unique with probability" in told
    assert "expected error at a target" in told


def test_every_command_of_the_pages_is_one_that_the_program_takes() -> None:
    """But for the forms of a command, which show what may be left out or chosen."""
    pages = [page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs").rglob("*.md"))]
    shown = [one for page in pages for one in commands(page)]
    asked = [one for one in shown if not re.search(r"[\[|]|\.\.\.|\d\.\.\d", " ".join(one))]
    assert len(asked) > 50
    parser = command_parser()
    for arguments in asked:
        parser.parse_args(arguments[: arguments.index(">")] if ">" in arguments else arguments)


def test_what_the_demo_installs_is_part_of_what_the_tests_install() -> None:
    def pinned(name: str) -> dict[str, str]:
        text = (ROOT / name).read_text(encoding="utf-8")
        return {
            entry.split("==")[0]: re.sub(r" ; [^\\]*", " ", entry)  # on which systems it is needed may differ
            for entry in re.findall(r"^\S+==\S+ .*(?:\n    --hash.*)*", text, re.M)
        }

    demo, full = pinned("requirements-demo.lock"), pinned("requirements.lock")
    assert len(demo) < len(full) / 2
    assert set(demo.items()) <= set(full.items())
