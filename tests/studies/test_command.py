import argparse
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.cli import main, study
from ronnaplan.errors import InputError


def parse(*arguments: str) -> Any:
    parser = argparse.ArgumentParser()
    study.configure(parser)
    return parser.parse_args(arguments)


def test_the_simulation_writes_and_prints_its_results_and_keeps_progress_off_standard_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = parse(
        "simulation", "--tests", "1", "--protocol-only", "--workers", "1", "-o", str(tmp_path / "out")
    )
    assert study.run(arguments) == 0
    output = capsys.readouterr()
    assert "| 8 | 4 |" in output.out
    assert "block" not in output.out
    assert "90/90" in output.err
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"journal.jsonl", "results.json", "table.md", "outcomes.png", "calibration.png"}


def test_a_folder_that_is_a_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot make the folder"):
        study.run(parse("tracking", "-o", str(tmp_path / "file")))


def test_every_study_has_its_own_folder() -> None:
    assert {str(parse(name).output) for name in study.STUDIES} == {f"study-{name}" for name in study.STUDIES}


@pytest.mark.parametrize(
    ("name", "option", "value"),
    [
        ("simulation", "--tests", "0"),
        ("simulation", "--seed", "-1"),
        ("tracking", "--seed", "-1"),
        ("tracking", "--workers", "0"),
        ("chain", "--sessions", "0"),
    ],
)
def test_a_number_out_of_range_is_wrong_usage_and_leaves_no_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, option: str, value: str
) -> None:
    assert main(["study", name, option, value, "-o", str(tmp_path / "out")]) == 2
    assert f"{option}: {value} is out of range" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
