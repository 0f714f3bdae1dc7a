"""A document that is kept open: others' changes are noticed, kept, and never written over."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from ronnaplan.documents import files
from ronnaplan.documents.files import read_json, write_atomically
from ronnaplan.documents.open_document import Kept
from ronnaplan.errors import InputError


def kept(path: Path, *, merging: bool = False) -> Kept[list[int]]:
    """A list of numbers; those added here are put behind those that are there."""

    def read(path: Path) -> list[int]:
        numbers = read_json(path)
        return list(numbers)

    def merge(base: list[int], mine: list[int], theirs: list[int]) -> list[int]:
        return theirs + mine[len(base) :]

    return Kept(path, read, str, merge if merging else None)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_atomically(tmp_path / "numbers.json", "[1]")
    return tmp_path / "numbers.json"


def test_two_hands_changes_are_merged_where_that_can_be_done(path: Path) -> None:
    one, other = kept(path, merging=True), kept(path, merging=True)
    one.write([1, 2])
    assert other.write([1, 3]) == [1, 2, 3]
    assert other.content == read_json(path) == [1, 2, 3]


def test_two_hands_changes_are_refused_where_not_and_the_first_stays(path: Path) -> None:
    one, other = kept(path), kept(path)
    one.write([1, 2])
    with pytest.raises(InputError, match="changed by another hand"):
        other.write([1, 3])
    assert read_json(path) == [1, 2]
    assert other.content == [1]
    assert other.look_again()
    assert other.write([1, 2, 3]) == [1, 2, 3]


def test_a_change_by_another_hand_is_noticed_once_and_ones_own_is_none(path: Path) -> None:
    one, other = kept(path), kept(path)
    one.write([1, 2])
    assert not one.look_again()
    assert other.look_again()
    assert other.content == [1, 2]
    assert not other.look_again()


@pytest.mark.parametrize("year_s", [-3e7, 3e7])
def test_a_change_is_noticed_whichever_way_the_clock_jumps(path: Path, year_s: float) -> None:
    one = kept(path)
    one.look_again()
    write_atomically(path, "[2]")
    then = path.stat().st_mtime + year_s
    os.utime(path, (then, then))
    assert one.look_again()
    assert one.content == [2]


def test_a_document_that_appears_is_noticed_and_not_written_over(tmp_path: Path) -> None:
    one = kept(tmp_path / "numbers.json", merging=True)
    assert one.content is None
    assert not one.look_again()
    write_atomically(one.path, "[2]")
    with pytest.raises(InputError, match="changed by another hand"):
        one.write([1])
    assert one.look_again()
    assert one.content == [2]


def test_a_document_that_was_removed_is_written_anew_and_what_it_held_is_not_forgotten(path: Path) -> None:
    one = kept(path)
    path.unlink()
    for told in (one.look_again, one.require_there):
        with pytest.raises(InputError, match="removed, and what it held still counts here"):
            told()
    assert not one.look_again()  # told once
    assert one.content == [1]
    assert one.write([1, 2]) == read_json(path) == [1, 2]
    one.require_there()
    path.unlink()
    with pytest.raises(InputError, match="removed"):
        one.look_again()
    assert not kept(path).look_again()
    kept(path).require_there()


def test_a_document_that_may_not_be_looked_up_is_told_and_is_no_absent_one(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = kept(path)

    def closed(*_: object, **__: object) -> os.stat_result:
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "stat", closed)
        patched.setattr(files, "read_whole", lambda *_, **__: (_ for _ in ()).throw(InputError("cannot be read")))
        with pytest.raises(InputError, match="cannot be read"):
            one.look_again()
        assert not one.look_again()
        with pytest.raises(InputError, match="cannot be read"):
            kept(path)
    assert not one.look_again()
    assert one.content == [1]


def test_a_document_that_was_damaged_is_told_once_and_not_written_over(path: Path) -> None:
    one = kept(path)
    path.write_text("[1, 2")
    with pytest.raises(InputError, match="not a JSON document"):
        one.look_again()
    assert not one.look_again()
    assert one.content == [1]
    with pytest.raises(InputError, match="not a JSON document"):
        one.write([1, 3])
    assert path.read_text() == "[1, 2"


def test_what_was_written_here_is_not_read_again_but_what_another_hand_put_there_is(path: Path) -> None:
    """To read a plan of hundreds at every change would take longer than to write it."""
    reads = list[Path]()

    def read(path: Path) -> list[int]:
        reads.append(path)
        return list(read_json(path))

    one = Kept(path, read, str)
    one.write([1, 2])
    reads.clear()
    one.write([1, 2, 3])
    assert not one.look_again()
    assert not reads
    for theirs in ([7], [1, 2, 3], [8]):  # also back to what was written here
        write_atomically(path, str(theirs))
        assert one.look_again()
        assert one.content == theirs
