"""What was deleted, and what a system keeps for itself, is no scan and no reason to doubt one."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
from pydicom.dataset import Dataset

from ronnaplan.ct import find_series, read_ct
from ronnaplan.ct.system_folders import WHY_LEFT_OUT, WHY_LEFT_PACKED
from tests.ct.makers import write_series
from tests.faults import shut

NAMES = (
    *(".Trashes", "$RECYCLE.BIN", ".Trash-1000", "#recycle", "@Recycle"),
    *("System Volume Information", "lost+found", ".Spotlight-V100", ".DocumentRevisions-V100"),
)


def of_another_series(made: Dataset, k: int) -> None:
    made.SeriesInstanceUID, made.SOPInstanceUID = "1.2.9", f"1.2.9.{k}"


@pytest.mark.parametrize("name", NAMES)
def test_a_scan_that_was_deleted_is_not_read_unless_it_is_named(tmp_path: Path, name: str) -> None:
    disk = tmp_path / "disk"
    write_series(disk / "scans")
    write_series(disk / name / "501", change=of_another_series)
    (disk / name / "501" / "journal").touch()
    found = find_series(disk)
    assert len(found.series) == 1
    (left_out,) = found.skipped
    assert (left_out.name, left_out.reason) == (str(disk / name), WHY_LEFT_OUT)
    assert read_ct(disk).flags == ()
    assert find_series(disk / name).series[0].key == "1.2.9"


def test_a_folder_of_the_system_that_nobody_may_open_is_no_reason_to_doubt_a_scan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_series(tmp_path)
    (tmp_path / "lost+found").mkdir()
    shut(monkeypatch, "lost+found")
    assert read_ct(tmp_path).flags == ()


def test_what_was_deleted_of_a_disk_that_was_packed_is_left_out(tmp_path: Path) -> None:
    write_series(tmp_path / "disk" / "scans")
    write_series(tmp_path / "disk" / ".Trashes" / "501", change=of_another_series)
    with zipfile.ZipFile(tmp_path / "disk.zip", "w") as archive:
        for path in sorted((tmp_path / "disk").rglob("*")):
            archive.write(path, path.relative_to(tmp_path))
    found = find_series(tmp_path / "disk.zip")
    assert len(found.series) == 1
    assert {one.reason for one in found.skipped} == {WHY_LEFT_PACKED}
