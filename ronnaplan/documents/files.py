"""Writing and reading of small files: whole or not at all, one writer at a time, no traceback for a bad one.

Who writes holds a lock beside the file, writes beside it, syncs, renames, and syncs the folder. A writer that dies at
any step leaves the old content or the new one; what it left beside is removed by the next write in that folder.
"""

from __future__ import annotations

import errno
import os
import shutil
import sys
import unicodedata
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

from ronnaplan.ct.header import is_marked
from ronnaplan.errors import NO_ROOM, InputError, UnwrittenError, UsageError
from ronnaplan.portable import keep_access, replace, sync, sync_folder
from ronnaplan.untrusted import parse_json, read_whole

Document = TypeVar("Document")

MAX_DOCUMENT_BYTES = 16 * 2**20
"""Documents are a few kilobytes; a larger file is something else."""

TABLE_ENDINGS = (".csv", ".txt", ".tsv")
"""What tables must be called."""

REMEDIES = {
    **dict.fromkeys(NO_ROOM, "make room on its disk"),
    **dict.fromkeys((errno.EROFS, errno.EACCES, errno.EPERM), "make that place writable"),
    errno.EIO: "check its disk",
}
"""What can be done where a file lies, about an error of the system's. About others another place can be chosen."""

LOCK_WAIT_S = 10.0
"""How long to wait for another writer of the same file: a write takes some milliseconds."""

LOCK_POLL_S = 0.01
"""How often a waiting writer tries again."""


def write_atomically(path: str | os.PathLike[str], data: str | bytes) -> None:
    """Write ``data`` to ``path``, replacing what was there whole; it is on the disk when this returns.

    A link is followed, so that what it points to is replaced and not the link. Mode and ownership of a replaced file
    stay. Raises `UnwrittenError` for a place that cannot be written, `InputError` for anything but a regular file (a
    device, a pipe), and where another program holds the file for more than `LOCK_WAIT_S`.
    """
    with _locked(path) as target:
        _replace(target, data.encode() if isinstance(data, str) else data)


class GrowingFile:
    """A file of lines, in the place of what was there from its first line on, that holds each as soon as it is told."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Name the file; raises `InputError` where it cannot be written."""
        check_target(path)
        self._path, self._begun = path, False

    def add(self, line: str) -> None:
        """Add a line; raises `InputError` where it cannot be written."""
        if not self._begun:
            write_atomically(self._path, f"{line}\n")
            self._begun = True
            return
        try:
            with Path(self._path).open("ab") as stream:
                stream.write(f"{line}\n".encode())
        except OSError as error:
            raise _unwritten(self._path, error) from error

    def end(self) -> None:
        """Leave an empty file where no line came."""
        if not self._begun:
            write_atomically(self._path, "")


def change_document(
    path: str | os.PathLike[str],
    read: Callable[[str | os.PathLike[str]], Document],
    change: Callable[[Document], Document],
    text: Callable[[Document], str],
) -> Document:
    """Write ``text(change(read(path)))`` to ``path`` and return what was written; nobody else writes meanwhile.

    What ``read`` or ``change`` raises leaves the file as it was. Others wait for both: what takes long (a scan to
    read) is done before. Raises `InputError` like `write_atomically`, and for more than could be read again.
    """
    with _locked(path) as target:
        changed = change(read(path))
        content = text(changed).encode()
        if len(content) > MAX_DOCUMENT_BYTES:
            raise InputError(
                f"{target} would take {len(content)} bytes, more than the {MAX_DOCUMENT_BYTES} that are read; "
                "begin another document"
            )
        _replace(target, content)
    return changed


@contextmanager
def _locked(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield the file that ``path`` names, which no other program writes within; leave nothing hidden behind."""
    from filelock import FileLock, Timeout

    check_target(path)
    target = Path(os.path.realpath(path))
    lock = FileLock(_hidden(target, "lock"), timeout=LOCK_WAIT_S, poll_interval=LOCK_POLL_S, mode=0o666)
    try:
        with lock:
            try:
                yield target
            finally:
                _remove_hidden(Path(lock.lock_file))
    except Timeout as error:
        _require_lock_file(target, Path(lock.lock_file))
        raise InputError(
            f"cannot write {target}: another program holds it since {LOCK_WAIT_S:.0f} s; "
            "end that program or let it finish, then try again"
        ) from error
    except OSError as error:
        raise _unwritten(target, error) from error
    _clear_leftovers(target.parent)


def _require_lock_file(target: Path, lock_file: Path) -> None:
    """Raise `UnwrittenError` where no file can be made beside ``target``, for which a lock waits as for a writer."""
    try:
        lock_file.touch()
    except OSError as error:
        raise _unwritten(target, error) from error


def _unwritten(path: str | os.PathLike[str], error: OSError) -> UnwrittenError:
    return UnwrittenError(f"cannot write {os.fspath(path)}: {error.strerror or error}; {_remedy(error)}")


def _remedy(error: OSError) -> str:
    return REMEDIES.get(error.errno or 0, "choose another place")


def _replace(target: Path, content: bytes) -> None:
    """Write beside ``target``, sync, rename, sync the folder. Only who holds the lock calls this."""
    beside = _hidden(target, "part")
    beside.unlink(missing_ok=True)  # of a writer that died
    before = target.stat() if target.exists() else None
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    try:
        with os.fdopen(os.open(beside, flags, 0o666 if before is None else 0o600), "wb") as stream:
            if before is not None:
                keep_access(stream.fileno(), before)
            stream.write(content)
            stream.flush()
            sync(stream.fileno())
        replace(beside, target)
        sync_folder(target.parent)
    finally:
        beside.unlink(missing_ok=True)


def _hidden(target: Path, kind: str) -> Path:
    """Where the lock or the new content of ``target`` lies; the same for all names that may mean one file."""
    name = unicodedata.normalize("NFKC", target.name).casefold()
    return target.with_name(f".ronnaplan.{sha256(name.encode(errors='surrogateescape')).hexdigest()[:16]}.{kind}")


def _remove_hidden(lock_file: Path) -> None:
    """Remove a lock, which this program holds, and content that was not finished under it.

    Who waits for the removed lock notices and takes the next one.
    """
    with suppress(OSError):  # Windows removes no open file: the lock stays
        lock_file.with_suffix(".part").unlink(missing_ok=True)
        lock_file.unlink(missing_ok=True)


def _clear_leftovers(folder: Path) -> None:
    """Remove what writers that died left in ``folder``: the system has let go of their locks."""
    from filelock import FileLock

    for left in folder.glob(".ronnaplan.*.lock"):
        with suppress(OSError), FileLock(left, timeout=0):
            _remove_hidden(left)


def check_target(path: str | os.PathLike[str]) -> None:
    """Raise `InputError` unless a file can be written at ``path``: worth knowing before a long computation."""
    if not os.fspath(path):
        raise InputError("an empty name was given for the file to write; give its path")
    try:
        _check_place(path, Path(os.path.realpath(path)))
    except OSError as error:  # in a folder that is closed nothing can be looked up
        raise _unwritten(path, error) from error


def _check_place(path: str | os.PathLike[str], target: Path) -> None:
    # not of the target: /dev/stdout is a link whose target, a pipe, has no name
    if Path(path).exists() and not Path(path).is_file():
        raise InputError(f"{os.fspath(path)} is no regular file; give the path of a file to write")
    if not target.parent.is_dir():
        wrong = "is a file; name a folder" if target.parent.exists() else "does not exist; make it first"
        raise InputError(f"cannot write {os.fspath(path)}: the folder {target.parent} {wrong}")
    if not os.access(target.parent, os.W_OK):
        raise UnwrittenError(
            f"cannot write {os.fspath(path)}: the folder {target.parent} may not be written to; make that place "
            "writable"
        )


def require_ending(path: str | os.PathLike[str], kind: str, endings: tuple[str, ...]) -> None:
    """Raise `UsageError` for a name that ends otherwise than programs want it of a file of a ``kind``."""
    if not os.fspath(path).lower().endswith(endings):
        raise UsageError(
            f"the file to write is '{os.fspath(path)}'; expected a name that ends in {' or '.join(endings)}, by which "
            f"programs tell '{kind}'"
        )


def write_new(path: str | os.PathLike[str], text: str) -> None:
    """Write ``text`` to a file that was not there; raises `UsageError` where one was."""
    if Path(path).exists():
        raise UsageError(f"{os.fspath(path)} is there already; name a new file")
    write_atomically(path, text)


def write_result(path: str | None, text: str) -> None:
    """Write ``text`` to the file named by ``-o``, or to standard output when there is none."""
    if path is None:
        sys.stdout.write(text)
    else:
        write_atomically(path, text)


def read_json(path: str | os.PathLike[str]) -> Any:
    """Parse the JSON file at ``path``; raises `InputError` when it is missing, too large or not JSON by the letter."""
    content = read_whole(path, MAX_DOCUMENT_BYTES, expected="a JSON document")
    if is_marked(content):  # the node's answers, say
        raise InputError(
            f"{os.fspath(path)} is a DICOM object, not a JSON document; give the file that `ronnaplan localize`, "
            "`register` or another command wrote with -o"
        )
    try:
        return parse_json(content)
    except ValueError as error:
        raise InputError(
            f"{os.fspath(path)} is not a JSON document ({error}); give a file that ronnaplan wrote"
        ) from error


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Return the folder at ``path``, made if it is not there; raises `UnwrittenError` where it cannot be."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnwrittenError(f"cannot make the folder {folder}: {error.strerror}; {_remedy(error)}") from error
    return folder


def move_up(part: Path, whole: Path, names: Iterable[str]) -> None:
    """Move the files ``names`` of a folder ``part`` up to where ``whole`` is; raises `UnwrittenError` for a failure.

    It gets the new name ``whole`` first: whoever is killed amid this leaves all of them below that place.
    """
    try:
        part.rename(whole)
        for name in names:
            (whole / name).replace(whole.with_name(name))
        shutil.rmtree(whole)
        sync_folder(whole.parent)
    except OSError as error:
        raise _unwritten(whole.parent, error) from error
