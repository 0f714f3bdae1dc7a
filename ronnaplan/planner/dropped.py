"""What is dropped onto the start page: kept in a folder of its own, within limits, until it is opened."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path

from ronnaplan.ct.images import is_image_file
from ronnaplan.ct.limits import DEFAULT_LIMITS, Limits
from ronnaplan.errors import InputError, UsageError
from ronnaplan.text import printable

PREFIX = ".dropped-"

LONGEST_NAME = 120
"""Characters that are kept of a name: its last ones, for the ending tells an archive or image."""

STRANGE = re.compile(r"[^\w. ()+,=@-]|^\.|[. ]$", re.ASCII)
"""What not every file system takes in a name, or takes for something else: Windows drops a dot or blank at the end."""

DEVICE = re.compile(r"(con|prn|aux|nul|(com|lpt)\d) *(\.|$)", re.ASCII | re.IGNORECASE)
"""How names begin that mean no file on Windows."""

DEEPEST = 12
"""Folders in which a dropped file may lie."""


class Dropped:
    """The files that were dropped last; `close` removes what was not taken."""

    def __init__(self, home: Path, limits: Limits = DEFAULT_LIMITS) -> None:
        self._home, self._limits = home, limits
        self._folder: Path | None = None
        self._count = self._bytes = 0

    def begin(self) -> Path:
        """Forget what was dropped before; return the folder for what comes."""
        self.close()
        try:
            self._folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=self._home))
        except OSError as error:
            raise InputError(f"nothing can be kept in {self._home} ({error.strerror}); start elsewhere") from error
        return self._folder

    async def add(self, name: str, pieces: AsyncIterator[bytes]) -> None:
        """Keep one file, named with the folders it was dropped in; raises `InputError` beyond the limits."""
        target = (self._folder or self.begin()).joinpath(*_parts(name))
        self._count += 1
        if self._count > self._limits.files:
            raise InputError(f"more than {self._limits.files} files were dropped; drop a narrower folder")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.exists():  # of a name that differs in what is not kept of it, or in capitals
                target = target.with_name(f"{self._count}-{target.name}")
            with target.open("xb") as stream:
                size = 0
                async for piece in pieces:
                    size, self._bytes = size + len(piece), self._bytes + len(piece)
                    if size > self._limits.file_bytes or self._bytes > self._limits.archive_bytes:
                        raise InputError(
                            f"{printable(name)} is beyond the limit of bytes; start the planner with it"
                        )
                    stream.write(piece)
        except OSError as error:
            raise InputError(f"{printable(name)} cannot be kept ({error.strerror}); drop it again") from error

    @property
    def key(self) -> str:
        """What tells the files that were dropped last from those of any other drop; empty where there are none."""
        return self._folder.name if self._folder is not None else ""

    def require(self, key: str) -> None:
        """Raise `UsageError` unless the drop of that ``key`` is the last one: its files are gone otherwise."""
        if not self.key or key != self.key:
            raise UsageError("something else was dropped, fetched or opened since; drop or fetch it again")

    @property
    def scan(self) -> Path:
        """What is looked through: the only file where it is an archive or image, else the folder."""
        if self._folder is None:
            raise UsageError("nothing was dropped; drop a folder or a zip archive")
        files = [one for one in self._folder.rglob("*") if one.is_file()]
        only = files[0] if len(files) == 1 else None
        return only if only and (only.suffix.lower() == ".zip" or is_image_file(only)) else self._folder

    def take(self, case: Path) -> Path:
        """Move what was dropped into a new folder of a case, as its scan; return where it lies there."""
        scan, folder = self.scan, self._folder
        assert folder is not None
        name = "ct" if scan == folder else f"ct{_suffix(scan)}"
        try:
            case.mkdir()
            moved = Path(shutil.move(scan, case / name))
        except OSError as error:
            raise InputError(f"the case cannot be made in {case} ({error.strerror}); give another name") from error
        self.close()
        return moved

    def close(self) -> None:
        """Remove what was dropped and not taken."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
        self._folder, self._count, self._bytes = None, 0, 0


def _parts(name: str) -> list[str]:
    parts = [part for part in name.split("/") if part not in ("", ".")]
    if not 0 < len(parts) <= DEEPEST or any(part == ".." for part in parts):
        raise UsageError(f"'{printable(name, 100)}' is no name of a file; drop a folder or a zip archive")
    return [_plain(part) for part in parts]


def _plain(part: str) -> str:
    """Return a name that every file system takes, and none for anything but a plain file."""
    name = STRANGE.sub("_", part[-LONGEST_NAME:])
    return f"_{name}" if DEVICE.match(name) else name


def _suffix(path: Path) -> str:
    return ".nii.gz" if path.name.lower().endswith(".nii.gz") else path.suffix.lower()
