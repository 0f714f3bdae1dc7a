"""Every file below a path: a folder, a zip archive or one file."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from ronnaplan.ct.archives import is_archive, zip_members
from ronnaplan.ct.files import Blob, DiskFile, Skipped
from ronnaplan.ct.limits import Limits
from ronnaplan.errors import InputError
from ronnaplan.text import printable


def blobs_below(path: Path, limits: Limits, skipped: list[Skipped]) -> Iterator[Blob]:
    """Yield every file of ``path``: a folder (links are followed, each file once), a zip archive or one file.

    What cannot be opened is appended to ``skipped``. Raises `InputError` beyond the limits.
    """
    try:
        status = path.stat()
        is_zip = stat.S_ISREG(status.st_mode) and is_archive(path)
    except FileNotFoundError as error:
        raise InputError(f"there is no file or folder {printable(path)}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{printable(path)} cannot be opened ({printable(error)})") from error
    if stat.S_ISDIR(status.st_mode):
        yield from _files_below(str(path), limits, skipped)
    elif is_zip:
        yield from zip_members(path, limits, skipped)
    elif stat.S_ISREG(status.st_mode):
        yield DiskFile(str(path), status.st_size)
    else:
        raise InputError(f"{printable(path)} is neither a file nor a folder")


def _files_below(root: str, limits: Limits, skipped: list[Skipped]) -> Iterator[Blob]:
    seen: set[tuple[int, int]] = set()
    pending = [(root, 0)]
    while pending:
        folder, depth = pending.pop()
        for entry, status in _entries(folder, skipped):
            identity = (status.st_dev, status.st_ino)
            if identity in seen:
                continue
            seen.add(identity)
            if len(seen) > limits.files:
                raise InputError(
                    f"{printable(root)} holds more than {limits.files} files; "
                    "name a narrower folder or raise the limit"
                )
            if stat.S_ISDIR(status.st_mode):
                if depth == limits.folder_depth:
                    skipped.append(Skipped(printable(entry), "the folders nest too deeply", True))
                else:
                    pending.append((entry, depth + 1))
            elif stat.S_ISREG(status.st_mode):
                yield DiskFile(entry, status.st_size)


def _entries(folder: str, skipped: list[Skipped]) -> Iterator[tuple[str, os.stat_result]]:
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                try:
                    yield entry.path, entry.stat()
                except OSError as error:
                    skipped.append(Skipped(printable(entry.path), f"it cannot be opened ({error.strerror})", True))
    except OSError as error:
        skipped.append(Skipped(printable(folder), f"the folder cannot be opened ({error.strerror})", True))
