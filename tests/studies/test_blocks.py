import json
from pathlib import Path
from typing import Any

import pytest

from ronnaplan import scheduler
from ronnaplan.errors import InputError
from ronnaplan.studies import plots
from ronnaplan.studies.blocks import run_blocks, write_whole

SETTINGS = {"study": "squares", "seed": 1}
BLOCKS = [(k, "x") for k in range(6)]


def square(number: Any, name: Any) -> Any:
    return {"square": number * number, "name": name}


def test_records_come_in_the_order_of_the_blocks_for_any_number_of_workers(tmp_path: Path) -> None:
    for workers in (1, 3):
        records = run_blocks(square, BLOCKS, tmp_path / f"{workers}.jsonl", SETTINGS, workers=workers)
        assert [record["square"] for record in records] == [0, 1, 4, 9, 16, 25]


def test_a_stopped_run_goes_on_where_it_was(tmp_path: Path) -> None:
    journal, called = tmp_path / "journal.jsonl", []

    def stops_at_three(number: Any, name: Any) -> Any:
        if number == 3:
            raise KeyboardInterrupt
        called.append(number)
        return square(number, name)

    with pytest.raises(KeyboardInterrupt):
        run_blocks(stops_at_three, BLOCKS, journal, SETTINGS, workers=1)
    first = list(called)
    assert first

    def goes_on(number: Any, name: Any) -> Any:
        called.append(number)
        return square(number, name)

    records = run_blocks(goes_on, BLOCKS, journal, SETTINGS, workers=1)
    assert [record["square"] for record in records] == [0, 1, 4, 9, 16, 25]
    assert len(json_lines(journal)) == 7


def test_finished_blocks_are_not_run_again_and_a_torn_line_is_passed_over(tmp_path: Path) -> None:
    journal = tmp_path / "journal.jsonl"
    run_blocks(square, BLOCKS[:3], journal, SETTINGS, workers=1)
    torn, _ = json.loads(journal.read_text().splitlines()[-1])["block"]  # blocks are noted as they finish
    journal.write_text(journal.read_text()[:-9])
    called = []

    def note(number: Any, name: Any) -> Any:
        called.append(number)
        return square(number, name)

    run_blocks(note, BLOCKS, journal, SETTINGS, workers=1)
    assert sorted(called) == [torn, 3, 4, 5]


def test_a_journal_of_another_study_is_refused(tmp_path: Path) -> None:
    journal = tmp_path / "journal.jsonl"
    run_blocks(square, BLOCKS, journal, SETTINGS, workers=1)
    with pytest.raises(InputError, match="other settings"):
        run_blocks(square, BLOCKS, journal, {**SETTINGS, "seed": 2}, workers=1)


def test_an_absent_scheduler_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduler, "ANSWERS_WITHIN", "1s")
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        run_blocks(square, BLOCKS, tmp_path / "j.jsonl", SETTINGS, scheduler="tcp://127.0.0.1:1")


def json_lines(path: Any) -> Any:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_full_disk_is_told_and_the_run_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal, full, opened = tmp_path / "journal.jsonl", Path("/dev/full"), Path.open
    with monkeypatch.context() as patch:
        patch.setattr(
            Path, "open", lambda path, *rest, **named: opened(full if path == journal else path, *rest, **named)
        )
        with pytest.raises(InputError, match="No space left on device; make room"):
            run_blocks(square, BLOCKS, journal, SETTINGS, workers=1)
    assert [path.name for path in tmp_path.iterdir()] == ["journal.jsonl"]
    assert len(run_blocks(square, BLOCKS, journal, SETTINGS, workers=1)) == len(BLOCKS)


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "table.md").mkdir()
    with pytest.raises(InputError, match="no regular file"):
        write_whole(tmp_path / "study" / "table.md", "text")
    with pytest.raises(InputError, match="no regular file"):
        plots.save(plots.new_figure(1, 1, 2, 2)[0], tmp_path / "study" / "table.md")
