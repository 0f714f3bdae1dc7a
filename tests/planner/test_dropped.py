"""What is dropped is kept within limits, under names that lead nowhere else, and is gone unless it is taken."""

from __future__ import annotations

import io
import zipfile
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ronnaplan.case.folder import scan_in
from ronnaplan.ct import find_series
from ronnaplan.ct.limits import Limits
from ronnaplan.errors import InputError, UsageError
from ronnaplan.planner.dropped import Dropped
from tests import cases
from tests.loops import run


def add(dropped: Dropped, name: str, content: bytes = b"some") -> None:
    async def pieces() -> AsyncIterator[bytes]:
        for start in range(0, len(content), 1 << 20):
            yield content[start : start + (1 << 20)]

    run(dropped.add(name, pieces()))


def test_a_folder_and_an_archive_become_the_scan_of_a_case(tmp_path: Path) -> None:
    dropped = Dropped(tmp_path)
    for file in sorted(cases.CT.glob("*.dcm")):
        add(dropped, f"study/{file.name}", file.read_bytes())
    dropped.take(tmp_path / "one")
    assert scan_in(tmp_path / "one") == tmp_path / "one" / "ct"
    with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
        for file in sorted(cases.CT.glob("*.dcm")):
            archive.write(file, file.name)
    dropped.begin()
    add(dropped, "all.zip", (tmp_path / "all.zip").read_bytes())
    dropped.take(tmp_path / "two")
    assert scan_in(tmp_path / "two") == tmp_path / "two" / "ct.zip"
    assert not list(tmp_path.glob(".dropped-*"))


@pytest.mark.parametrize("name", ["", "../out", "a/../../out", "/", "/".join(13 * "x"), ".."])
def test_a_name_that_leads_elsewhere_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="is no name of a file"):
        add(Dropped(tmp_path), name)


def test_strange_names_are_made_plain_and_stay_within(tmp_path: Path) -> None:
    dropped = Dropped(tmp_path)
    for name in ("/etc/pass wd", "C:\\x", "a\x00b", "\u202e.dcm", "nul:" + 300 * "x"):
        add(dropped, name)
    files = [one for one in dropped.scan.rglob("*") if one.is_file()]
    assert len(files) == 5
    assert all(one.resolve().is_relative_to(dropped.scan.resolve()) for one in files)
    with pytest.raises(InputError, match="cannot be kept"):
        add(dropped, "/etc/pass wd/x")


@pytest.mark.parametrize("name", ["Schädel.zip", f"{'x' * 300}.zip", "NUL.zip", "头.ZIP"])
def test_an_archive_is_one_whatever_its_name(tmp_path: Path, name: str) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for file in sorted(cases.CT.glob("*.dcm")):
            archive.write(file, file.name)
    dropped = Dropped(tmp_path)
    add(dropped, name, packed.getvalue())
    assert len(find_series(dropped.scan, progress=False).usable) == 1


def test_every_file_is_kept_where_their_plain_names_are_alike(tmp_path: Path) -> None:
    dropped = Dropped(tmp_path)
    names = ["ä.dcm", "ö.dcm", "ö.dcm", "É/1.dcm", "È/1.dcm"]
    for name in names:
        add(dropped, name, name.encode())
    kept = [one.read_bytes().decode() for one in dropped.scan.rglob("*") if one.is_file()]
    assert sorted(kept) == sorted(names)


@pytest.mark.parametrize("name", ["con", "NUL.dcm", "lpt1 .txt", "1.2.", "scan ", ".hidden", "Aux/1.dcm"])
def test_no_name_is_kept_that_means_no_file_of_that_name_on_windows(tmp_path: Path, name: str) -> None:
    dropped = Dropped(tmp_path)
    add(dropped, name)
    (first, *_) = (one.name for one in dropped.scan.iterdir())
    assert first.lower().split(".")[0].rstrip() not in {"con", "nul", "lpt1", "aux"}
    assert not first.endswith((".", " "))
    assert not first.startswith(".")


def test_plain_names_stay(tmp_path: Path) -> None:
    dropped = Dropped(tmp_path)
    for name in ("IM 0001 (2).dcm", "1.2.840.113", "study/CT_1+2,3=4@5-6.nii.gz", "conus.dcm"):
        add(dropped, name)
        assert (dropped.scan / name).is_file()


def test_too_much_is_refused_and_what_is_not_taken_is_removed(tmp_path: Path) -> None:
    few = Dropped(tmp_path, Limits(files=2))
    add(few, "a")
    add(few, "b")
    with pytest.raises(InputError, match="more than 2 files"):
        add(few, "c")
    few.close()
    small = Dropped(tmp_path, Limits(file_bytes=10, archive_bytes=15))
    with pytest.raises(InputError, match="limit of bytes"):
        add(small, "a", 11 * b"x")
    small.begin()
    add(small, "a", 9 * b"x")
    with pytest.raises(InputError, match="limit of bytes"):
        add(small, "b", 9 * b"x")
    small.close()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(UsageError, match="nothing was dropped"):
        _ = small.scan
