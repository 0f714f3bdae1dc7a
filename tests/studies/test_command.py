import argparse
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.cli import study
from ronnaplan.errors import InputError, UsageError


def parse(*arguments: str) -> Any:
    parser = argparse.ArgumentParser()
    study.configure(parser)
    return parser.parse_args(arguments)


def test_the_simulation_prints_its_tables_and_keeps_progress_off_standard_output(
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


def test_no_tests_at_all_is_wrong_usage(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="expected at least 1"):
        study.run(parse("simulation", "--tests", "0", "-o", str(tmp_path)))


def test_no_workers_is_wrong_usage(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--workers is 0"):
        study.run(parse("tracking", "--workers", "0", "-o", str(tmp_path)))


def test_a_folder_that_is_a_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be a folder"):
        study.run(parse("tracking", "-o", str(tmp_path / "file")))


def test_every_study_has_its_own_folder() -> None:
    assert {str(parse(name).output) for name in study.STUDIES} == {f"study-{name}" for name in study.STUDIES}


@pytest.mark.parametrize("name", ["simulation", "tracking"])
def test_a_negative_seed_is_wrong_usage_and_leaves_no_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="--seed is -1"):
        study.run(parse(name, "--seed", "-1", "-o", str(tmp_path / "out")))
    assert not (tmp_path / "out").exists()
