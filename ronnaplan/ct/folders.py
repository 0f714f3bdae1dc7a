"""Every file below a path: a folder, a zip archive or one file."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from ronnaplan.ct.archives import is_archive, zip_members
from ronnaplan.ct.files import Blob, DiskFile, Skipped
from ronnaplan.ct.limits import Limits
from ronnaplan.ct.system_folders import WHY_LEFT_OUT, is_system_folder
from ronnaplan.errors import NOT_READ, STANDARD_INPUT, InputError
from ronnaplan.text import printable


def blobs_below(path: Path, limits: Limits, skipped: list[Skipped], without: Path | None = None) -> Iterator[Blob]:
    """Yield every file of ``path``: a folder (links are followed, each file once), a zip archive or one file.

    The folder ``without``, which must be there, is left out wherever it is met, and so are the system's own folders.

    Files of a folder come as they are met: what is kept of them does not grow with their number.

    What cannot be opened is appended to ``skipped``. Raises `InputError` beyond the limits.
    """
    try:
        status = path.stat()
        is_zip = stat.S_ISREG(status.st_mode) and is_archive(path)
    except FileNotFoundError as error:
        remedy = NOT_READ if str(path) == STANDARD_INPUT else "check the path"
        raise InputError(f"there is no file or folder {printable(path)}; {remedy}") from error
    except OSError as error:
        raise InputError(f"{printable(path)} cannot be opened ({error.strerror}); check the path") from error
    except ValueError as error:
        raise InputError(f"{printable(path)} cannot be opened ({printable(error)}); check the path") from error
    if stat.S_ISDIR(status.st_mode):
        left_out = () if without is None else (without,)
        yield from _files_below(str(path), limits, skipped, {_identity(one.stat()) for one in (path, *left_out)})
    elif is_zip:
        yield from zip_members(path, limits, skipped)
    elif stat.S_ISREG(status.st_mode):
        yield DiskFile(str(path), status.st_size, status.st_mtime_ns)
    else:
        raise InputError(f"{printable(path)} is neither a file nor a folder; give the path of a scan")


class _Folder(NamedTuple):
    """A folder to be looked through; what is ``linked`` may be met by other names, too."""

    path: str
    depth: int
    linked: bool


class _Entry(NamedTuple):
    path: str
    name: str
    status: os.stat_result
    is_link: bool


def _files_below(root: str, limits: Limits, skipped: list[Skipped], seen: set[tuple[int, int]]) -> Iterator[Blob]:
    """Yield the files below a folder that are not ``seen``: folders, and files that may have other names."""
    top = os.path.join(os.path.realpath(root), "")  # noqa: PTH118
    count = 0
    pending = [_Folder(root, 0, False)]
    while pending:
        folder = pending.pop()
        for entry in _entries(folder.path, skipped):
            status = entry.status
            is_folder = stat.S_ISDIR(status.st_mode)
            if entry.is_link and not is_folder and os.path.realpath(entry.path).startswith(top):
                continue  # it is met where it lies
            if is_folder or entry.is_link or folder.linked or status.st_nlink != 1:
                if _identity(status) in seen:
                    continue
                seen.add(_identity(status))
            count += 1
            if count > limits.files:
                raise InputError(
                    f"{printable(root)} holds more than {limits.files} files; "
                    "name a narrower folder or raise the limit"
                )
            if not is_folder:
                if stat.S_ISREG(status.st_mode):
                    yield DiskFile(entry.path, status.st_size, status.st_mtime_ns)
            elif (left_out := _left_out(entry, folder, limits)) is not None:
                skipped.append(left_out)
            else:
                pending.append(_Folder(entry.path, folder.depth + 1, folder.linked or entry.is_link))


def _left_out(entry: _Entry, parent: _Folder, limits: Limits) -> Skipped | None:
    """Return why a folder is not looked into, if so."""
    if is_system_folder(entry.name):
        return Skipped(printable(entry.path), WHY_LEFT_OUT, False)
    if parent.depth == limits.folder_depth:
        return Skipped(
            printable(entry.path), "the folders nest too deeply; name this one by itself", True, entry.path
        )
    return None


def _identity(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


def _entries(folder: str, skipped: list[Skipped]) -> Iterator[_Entry]:
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                try:
                    status = entry.stat()
                    if not status.st_ino:  # Windows tells no file's number here
                        status = os.stat(entry.path)  # noqa: PTH116
                    yield _Entry(entry.path, entry.name, status, entry.is_symlink())
                except OSError as error:
                    skipped.append(_unopened("it", entry.path, error))
    except OSError as error:
        skipped.append(_unopened("the folder", folder, error))


def _unopened(what: str, path: str, error: OSError) -> Skipped:
    return Skipped(
        printable(path),
        f"{what} cannot be opened ({error.strerror}); see whether it is there and may be read",
        True,
        path,
    )
