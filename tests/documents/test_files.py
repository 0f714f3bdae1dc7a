"""Nothing is ever half a file, and no writer undoes what another has written."""

from __future__ import annotations

import errno
import json
import os
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from filelock import FileLock

from ronnaplan.documents import files
from ronnaplan.documents.files import change_document, check_target, make_folder, read_json, write_atomically
from ronnaplan.errors import InputError, UnwrittenError
from tests import faults

ROOT = Path(__file__).resolve().parents[2]


def test_an_existing_file_is_replaced_whole(tmp_path: Path) -> None:
    target = tmp_path / "out.json"
    target.write_text("old and longer than the new one")
    write_atomically(target, "new")
    assert target.read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "out.json"
    target.write_text("old")

    def full(self: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(InputError, match="No space left"):
        write_atomically(target, "new")
    assert target.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "No space left on device; make room on its disk"),
        (errno.EROFS, "Read-only file system; make that place writable"),
        (errno.EFBIG, "File too large; choose another place"),
    ],
)
def test_what_can_be_done_about_a_file_that_is_not_written_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, remedy: str
) -> None:
    def refuse(_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(UnwrittenError, match=remedy):
        write_atomically(tmp_path / "out.json", "new")


def test_a_place_that_is_no_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        write_atomically(tmp_path / "file" / "out.json", "new")
    with pytest.raises(UnwrittenError, match="cannot make the folder"):  # by a disk that is full, too
        make_folder(tmp_path / "file" / "folder")


def test_a_link_is_followed_and_what_is_no_file_is_left_alone(tmp_path: Path) -> None:
    real, link, pipe = tmp_path / "real.csv", tmp_path / "link.csv", tmp_path / "pipe"
    real.write_text("old")
    link.symlink_to(real)
    write_atomically(link, "new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    os.mkfifo(pipe)
    for target in (pipe, tmp_path, tmp_path / "nowhere" / "out.json", ""):
        with pytest.raises(InputError, match=r"no regular file|does not exist|empty name"):
            write_atomically(target, "new")
    assert pipe.is_fifo()


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="links to open files are Linux's")
def test_a_link_to_a_nameless_pipe_is_told_as_no_file() -> None:
    read, write = os.pipe()
    with os.fdopen(read), os.fdopen(write, "w"), pytest.raises(InputError, match=f"fd/{write} is no regular file"):
        write_atomically(f"/proc/self/fd/{write}", "new")


@pytest.mark.parametrize("content", [b'{"a": "\\ud800"}', b'"\\udfff"'])
def test_text_that_no_encoding_can_hold_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "odd.json").write_bytes(content)
    with pytest.raises(InputError, match="not a JSON document"):
        read_json(tmp_path / "odd.json")


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="no regular file"):
        read_json(tmp_path / "pipe")


def test_writers_that_meet_all_have_their_changes_kept(tmp_path: Path) -> None:
    path = tmp_path / "number.json"
    write_atomically(path, "0")

    def count_up(_: int) -> int:
        found: int = change_document(path, read_json, lambda number: number + 1, json.dumps)
        return found

    with ThreadPoolExecutor(4) as writers:
        assert sorted(writers.map(count_up, range(20))) == list(range(1, 21))
    assert read_json(path) == 20
    assert [one.name for one in tmp_path.iterdir()] == ["number.json"]


def test_a_change_that_fails_leaves_the_file_and_lets_the_next_writer_in(tmp_path: Path) -> None:
    path = tmp_path / "number.json"
    write_atomically(path, "1")
    with pytest.raises(ZeroDivisionError):
        change_document(path, read_json, lambda number: number / 0, json.dumps)
    assert change_document(path, read_json, lambda number: number + 1, json.dumps) == 2


def test_a_document_that_could_not_be_read_again_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "list.json"
    write_atomically(path, "[]")
    monkeypatch.setattr(files, "MAX_DOCUMENT_BYTES", 10)
    assert change_document(path, read_json, lambda _: list(range(3)), json.dumps) == [0, 1, 2]
    with pytest.raises(InputError, match="would take 15 bytes"):
        change_document(path, read_json, lambda _: list(range(5)), json.dumps)
    assert read_json(path) == [0, 1, 2]


def test_a_writer_that_never_ends_is_not_waited_for_forever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "out.json"
    monkeypatch.setattr(files, "LOCK_WAIT_S", 0.05)

    def meanwhile(content: str) -> str:
        with pytest.raises(InputError, match="another program holds it"):
            write_atomically(path, "other")
        return content

    path.write_text("1")
    assert change_document(path, read_json, meanwhile, str) == 1
    assert path.read_text() == "1"


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="the system has no folder in which nobody makes files")
def test_a_place_where_no_file_can_be_made_is_not_held_by_a_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "LOCK_WAIT_S", 0.05)
    with pytest.raises(
        UnwrittenError, match=r"cannot write /proc/out.json: .*; (choose another place|make that place)"
    ):
        write_atomically("/proc/out.json", "1")


def test_content_is_on_the_disk_before_its_name_and_the_name_before_the_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    def sync(handle: int) -> None:
        done.append("sync folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "sync file")

    def rename(source: Path, target: Path) -> None:
        done.append("rename")
        source.rename(target)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(Path, "replace", rename)
    write_atomically(tmp_path / "out.json", "new")
    assert done == ["sync file", "rename"] + ["sync folder"] * (sys.platform != "win32")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps access by folder")
def test_mode_and_group_of_a_replaced_file_stay(tmp_path: Path) -> None:
    private, others = tmp_path / "private.json", tmp_path / "new.json"
    private.write_text("old")
    private.chmod(0o600)
    if os.geteuid() == 0:
        os.chown(private, 12345, 23456)
    before = private.stat()
    write_atomically(private, "new")
    after = private.stat()
    assert (after.st_mode, after.st_uid, after.st_gid) == (before.st_mode, before.st_uid, before.st_gid)
    write_atomically(others, "new")
    (tmp_path / "plain").write_text("")
    assert others.stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("number", [28, 5])
def test_a_disk_that_takes_no_more_is_told_and_the_old_file_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    path = tmp_path / "out.json"
    path.write_text("old")

    def full(handle: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match=os.strerror(number)):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert [one.name for one in tmp_path.iterdir()] == ["out.json"]


def test_what_dead_writers_left_goes_with_the_next_write_and_what_live_ones_hold_stays(tmp_path: Path) -> None:
    dead, live = (tmp_path / f".ronnaplan.{name * 16}.lock" for name in "ab")
    for lock in (dead, live):
        lock.write_text("")
        lock.with_suffix(".part").write_text("half")
    with FileLock(live):
        write_atomically(tmp_path / "out.json", "new")
    assert sorted(tmp_path.iterdir()) == sorted([tmp_path / "out.json", live, live.with_suffix(".part")])


@pytest.mark.skipif(not faults.available, reason="system calls can be stopped at on Linux only")
def test_a_writer_killed_at_any_system_call_loses_no_acknowledged_change(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.documents.killed_writer", str(tmp_path / "number.json"), "4"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr
    result = json.loads(ended.stdout)
    assert result["wrong"] == []
    assert result["killed"] > 30


def test_a_folder_that_may_not_be_written_to_is_told_before_anything_is_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: (Path(path), mode) != (tmp_path, os.W_OK))
    with pytest.raises(UnwrittenError, match="may not be written to; make that place writable"):
        check_target(tmp_path / "fiducials.json")


def test_a_file_where_a_folder_is_meant_is_told_as_such(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("")
    with pytest.raises(InputError, match="results is a file; name a folder"):
        check_target(tmp_path / "results" / "fiducials.json")


def test_a_dicom_object_is_called_so_where_a_document_is_expected(tmp_path: Path) -> None:
    path = tmp_path / "fiducials.dcm"
    path.write_bytes(b"\0" * 128 + b"DICM\2\0\0\0UL\4\0\xc8\0\0\0")
    with pytest.raises(InputError, match=r"is a DICOM object, not a JSON document; give the file that"):
        read_json(path)
