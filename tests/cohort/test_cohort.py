"""A cohort's folder, roots and rules: what cannot be used is refused, and what no rule fits is left."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.cli import main
from ronnaplan.cohort import cohort as cohort_module
from ronnaplan.cohort.cohort import Counts, run_cohort
from ronnaplan.cohort.index import FILE, Index
from ronnaplan.cohort.rules import CohortRule, Rules
from ronnaplan.errors import InputError
from tests.cohort.runs import FAKE, RULE, begun, cohort, parquet, table
from tests.cohort.scans import SLICES, tiny
from tests.long import few_and_others

pytestmark = pytest.mark.usefixtures("log")


def test_a_folder_that_another_run_has_is_left_alone(tmp_path: Path) -> None:
    from filelock import FileLock

    tiny(tmp_path / "in", "6")
    (tmp_path / "out").mkdir()
    with FileLock(tmp_path / "out" / "cohort.lock"), pytest.raises(InputError, match="another run has the folder"):
        cohort(tmp_path)


@few_and_others("protocol", [""], ["file://"])
def test_a_root_below_another_is_refused_for_its_series_would_count_twice(tmp_path: Path, protocol: str) -> None:
    tiny(tmp_path / "in" / "a", "6")
    tiny(tmp_path / "in b", "7")

    def run(*names: str) -> Counts:
        roots = [f"{protocol}{tmp_path}/{name}" for name in names]
        return run_cohort(roots, tmp_path / "out", Rules(rule=(RULE,)), module=FAKE, workers=1)

    with pytest.raises(InputError, match=r"in/a lies below .*/in,"):
        run("in", "in b", "in/a/")
    with pytest.raises(InputError, match="no file or folder"):
        run("in/misspelt")
    counts = run("in", "in/", "in b")  # the same by two names
    assert (counts.done, counts.listed.files, counts.listed.changed) == (2, 2 * SLICES, 2 * SLICES)
    with pytest.raises(InputError, match=r"in/a lies below .*/in,"):  # of an earlier run, too
        run("in/a")


@pytest.mark.parametrize(
    ("roots", "reason"),
    [
        (["in", "misspelt"], "there is no file or folder"),
        (["nonsense://x"], "check its address"),
        (["in/notes.txt"], r"in/notes\.txt is neither a DICOM image nor a zip archive; name a folder"),
        (["file://{here}/in/notes.txt"], r"notes\.txt is neither a DICOM image nor a zip archive; name a folder"),
        (["in", "in/a"], "in/a lies below"),
        (["in", "out/"], "out is a root, too"),
        (["in/a", "link/a"], "link/a is the same as .*/in/a,"),
        (["in", "file://{here}/link/a"], "link/a lies below .*/in,"),
        (["in/a", "link/DICOMDIR"], "in/a lies below .*/link/DICOMDIR,"),
        (["in", "file://~/in/a"], "in/a lies below .*/in,"),  # as fsspec opens it
        ([], "nothing has been listed"),
    ],
)
def test_what_cannot_be_listed_is_refused_before_there_is_a_folder_of_results(
    tmp_path: Path, roots: list[str], reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny(tmp_path / "in" / "a", "6")
    (tmp_path / "in" / "notes.txt").write_text("no scan")
    (tmp_path / "in" / "DICOMDIR").touch()
    (tmp_path / "link").symlink_to("in")
    monkeypatch.chdir(tmp_path)
    for home in ("HOME", "USERPROFILE"):  # of Windows
        monkeypatch.setenv(home, str(tmp_path))
    given = [root.format(here=tmp_path) for root in roots]
    with pytest.raises(InputError, match=reason):
        run_cohort(given, Path("out"), Rules(rule=(RULE,)), module=FAKE, workers=1, list_roots=bool(roots))
    assert not Path("out").exists()


def test_a_folder_that_cannot_be_used_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny(tmp_path / "in", "6")
    cohort(tmp_path)

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(parquet, "ParquetWriter", full)
        with pytest.raises(InputError, match=r"cannot write .*series\.parquet: .*No space left"):
            cohort(tmp_path)
    assert not list((tmp_path / "out").glob("*.part"))
    with Index(tmp_path / "out") as index:
        index.run("ALTER TABLE series DROP COLUMN reason")  # as another version may have it
    with pytest.raises(
        InputError, match=r"another version of ronnaplan: its table series differs in reason; name"
    ):
        cohort(tmp_path)
    (tmp_path / "out" / "index.sqlite").write_bytes(b"damaged" * 1000)
    with pytest.raises(InputError, match="not a database"):
        cohort(tmp_path)
    (tmp_path / "out" / "cohort.lock").unlink()
    (tmp_path / "out" / "cohort.lock").mkdir()
    with pytest.raises(InputError, match=r"cannot write .*cohort\.lock"):
        cohort(tmp_path)


def test_a_folder_that_is_removed_while_a_run_writes_to_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny(tmp_path / "in", "6")
    monkeypatch.setattr(cohort_module, "work_off", lambda *_, **__: shutil.rmtree(tmp_path / "out"))
    with pytest.raises(InputError, match="out was removed while the run wrote to it; run the same again"):
        cohort(tmp_path)


def test_a_damaged_index_is_let_go_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / FILE).write_bytes(b"damaged" * 1000)
    opened: list[sqlite3.Connection] = []
    connect = sqlite3.connect

    def remembered(*args: Any, **kwargs: Any) -> sqlite3.Connection:
        opened.append(connect(*args, **kwargs))
        return opened[0]

    monkeypatch.setattr(sqlite3, "connect", remembered)
    with pytest.raises(sqlite3.DatabaseError, match="not a database"):
        Index(tmp_path)
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        opened[0].execute("SELECT 1")


def test_what_writing_example_rules_would_pass_over_is_wrong_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rules = tmp_path / "rules.toml"
    for beside in (["-o", "out"], ["in"], ["--workers", "2"], ["--again"]):
        assert main(["cohort", "--rules", str(rules), "--init", *beside]) == 2
        assert "leave all else out" in capsys.readouterr().err
    assert not rules.exists()
    assert main(["cohort", "--rules", str(rules), "--init"]) == 0
    assert rules.exists()


def test_a_folder_with_a_colon_takes_the_tables_and_a_url_is_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Either ended in a traceback once the tables were due, all work done: `s3://bucket` was a folder called s3:."""
    monkeypatch.chdir(tmp_path)
    tiny(tmp_path / "in", "6")
    run_cohort(["in"], Path("ward:3"), Rules(rule=(RULE,)), module=FAKE, workers=1)
    assert len(table(tmp_path, out="ward:3")) == 1
    assert main(["cohort", "in", "-o", "s3://bucket/out"]) == 2
    assert "is a URL; name a folder of this machine" in capsys.readouterr().err
    assert not list(tmp_path.glob("s3*"))


def test_one_file_is_counted_as_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "notes.txt").write_text("no scan")
    assert main(["cohort", str(tmp_path / "in"), "-o", str(tmp_path / "out")]) == 0
    assert "1 file, 1 of them new" in capsys.readouterr().err


def test_a_rule_behind_one_that_fits_all_that_it_does_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    tiny(tmp_path / "in", "6")
    rules = Rules(rule=(RULE, CohortRule(name="late", folder="qa*")))
    run_cohort([str(tmp_path / "in")], tmp_path / "out", rules, module=FAKE, workers=1)
    assert "the rule 'late' is never reached: 'all', before it, fits all that it does" in caplog.messages


def test_series_of_no_rule_are_left_and_the_last_listing_can_be_taken(
    tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny(tmp_path / "in" / "a", "6")
    tiny(tmp_path / "in" / "b", "7")
    rule = CohortRule(name="a", diameters=(11.5,), folder="A*")
    counts = cohort(tmp_path, rule)
    assert (counts.done, counts.left, counts.idle_rules) == (1, 1, ())
    assert {row["folder"]: row["state"] for row in table(tmp_path)} == {"a": "done", "b": "left"}
    tiny(tmp_path / "in" / "a", "8")
    begun(log)
    cohort(tmp_path, RULE, list_roots=False)
    assert begun(log) == {"7": 1}
    counts = cohort(tmp_path, CohortRule(name="misspelt", diameters=(11.5,), folder="c*"), list_roots=False)
    assert (counts.done, counts.left, counts.idle_rules) == (0, 2, ("misspelt",))
    assert {row["state"] for row in table(tmp_path)} == {"left"}
    assert not table(tmp_path, "markers")
    monkeypatch.chdir(tmp_path / "in" / "a")  # the same root by another name
    run_cohort(["../../in/"], tmp_path / "out", Rules(rule=(RULE,)), module=FAKE, workers=1)
    assert begun(log) == {"8": 1}
    with Index(tmp_path / "out") as index:
        assert index.count("done") == 3
    with pytest.raises(InputError, match="nothing has been listed"):
        run_cohort([], tmp_path / "misspelt", Rules(rule=(RULE,)), list_roots=False)
    with pytest.raises(InputError, match=r"in/b has not been listed in .*/out yet; leave --as-listed out"):
        run_cohort([str(tmp_path / "in" / "b")], tmp_path / "out", Rules(rule=(RULE,)), list_roots=False)
