"""Where files lie: a folder, a file or an archive, on a disk of this machine or behind a URL that fsspec opens."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

from ronnaplan.ct.archives import UnpackedMember, ZipMember, starts_as_archive, zip_members
from ronnaplan.ct.catalogue import folder_of_index
from ronnaplan.ct.files import Blob, Copied, DamagedError, DiskFile, Skipped, given_path
from ronnaplan.ct.folders import blobs_below
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.ct.system_folders import is_system_folder
from ronnaplan.errors import InputError
from ronnaplan.text import printable

LIMITS: Final = replace(DEFAULT_LIMITS, files=10**10)
"""A folder may hold any number of files: they are not kept in memory."""

_NOT_FOUND: Final = (404, 410)
"""Statuses by which a web server says that it has no such file, or no longer."""

NAMELESS: Final = "no library lists objects with two slashes together in their names; give them other names"

_KEPT_BYTES: Final = {0xDC80 + n: 0xF780 + n for n in range(128)}
_DISK_BYTES: Final = {kept: byte for byte, kept in _KEPT_BYTES.items()}


def kept_name(path: str) -> str:
    """Return a path as index and tables keep it: with characters of private use for bytes that are no UTF-8.

    Names from old systems have such bytes. Python has lone surrogates for them, which neither index nor tables take.
    """
    return path.translate(_KEPT_BYTES)


def disk_name(path: str) -> str:
    """Return a kept path as the system knows it."""
    return path.translate(_DISK_BYTES)


def is_url(root: str) -> bool:
    """Whether a root is a URL."""
    return "://" in root


class Met(NamedTuple):
    """A file as it is met: its folder below the place, its name there, and what changes when its content does."""

    folder: str
    name: str
    size: int
    stamp: str


@dataclass(frozen=True)
class RemoteFile(Copied):
    """A file behind a URL, of which parts are fetched."""

    files: Any
    path: str
    size: int

    @property
    def name(self) -> str:
        """The path, safe to print."""
        return printable(self.path)

    def read(self, offset: int, count: int) -> bytes:
        """Return ``count`` bytes from ``offset``, fewer at the end."""
        try:
            return bytes(self.files.cat_file(self.path, start=offset, end=min(offset + count, self.size)))
        except Exception as error:  # each store's library has errors of its own
            raise DamagedError(f"it cannot be fetched ({printable(error)}); see to its store") from error


@dataclass(frozen=True)
class Fetched(Copied):
    """A file that was fetched whole."""

    name: str
    content: bytes

    @property
    def size(self) -> int:
        """Number of bytes."""
        return len(self.content)

    def read(self, offset: int, count: int) -> bytes:
        """Return ``count`` bytes from ``offset``, fewer at the end."""
        return self.content[offset : offset + count]


@dataclass(frozen=True)
class Place:
    """A root as it was named, or an archive at the path ``archive`` below it."""

    root: str
    archive: str = ""

    @property
    def is_remote(self) -> bool:
        """Whether fsspec opens it."""
        return is_url(self.root)

    @cached_property
    def _remote(self) -> tuple[Any, str]:
        """File system and path of a URL."""
        try:
            from fsspec.core import url_to_fs

            files, path = url_to_fs(disk_name(self.root))
        except Exception as error:  # each store's library has errors of its own
            raise InputError(
                f"{printable(self.root)} cannot be opened ({printable(error)}); check its address"
            ) from error
        return files, path.rstrip("/")

    @property
    def _local(self) -> Path:
        """Path of a root that is no URL."""
        return folder_of_index(given_path(disk_name(self.root)))

    @cached_property
    def is_file(self) -> bool:
        """Whether the root is a single file."""
        if self.is_remote:
            files, path = self._remote
            return bool(files.isfile(path))
        return self._local.is_file()

    @cached_property
    def _base(self) -> str:
        """The folder that paths of files start from; of a single file, that of the file."""
        if self.is_remote:
            path = self._remote[1]
            return path.rpartition("/")[0] if self.is_file else path
        return str(self._local.parent if self.is_file else self._local)

    def path(self, folder: str, name: str) -> str:
        """Return where a file of this root lies."""
        return "/".join(part for part in (self._base, disk_name(folder), disk_name(name)) if part)

    def files(self, skipped: list[Skipped], without: Path | None = None) -> Iterator[Met]:
        """Yield every file of a root, one by one; what cannot be opened is appended to ``skipped``.

        The folder ``without`` of this machine is not looked into, unless the root is a URL. Raises `InputError` where
        there is no such place.
        """
        if self.is_remote:
            yield from self._remote_files(skipped)
        else:
            path = self._local
            if self.is_file:
                status = path.stat()
                yield Met("", kept_name(path.name), status.st_size, str(status.st_mtime_ns))
                return
            for blob in blobs_below(path, LIMITS, skipped, without):
                if isinstance(blob, DiskFile):
                    folder, _, name = self.below(blob.path).rpartition("/")
                    yield Met(folder, name, blob.size, str(blob.changed_ns))

    def below(self, path: str) -> str:
        """Return, of a whole path, what is below this root; "" for an empty path and the root itself."""
        separator = "/" if self.is_remote else os.sep
        below = path[len(self._base.rstrip(separator)) :]
        return kept_name(below.removeprefix(separator).replace(separator, "/"))  # members of an archive have none

    def members(self, skipped: list[Skipped]) -> Iterator[tuple[Met, Blob]]:
        """Yield every file of an archive; raises `InputError` where it cannot be read."""
        for one in self._archive_blobs(skipped, None):
            folder, _, name = one.member.rpartition("/")
            yield Met(folder, name, one.size, ""), one

    def blob(self, folder: str, name: str, size: int) -> Blob:
        """Return a file of a root that is no archive, of which parts will be read: one of this machine as it is now."""
        if self.is_remote:
            return RemoteFile(self._remote[0], self.path(folder, name), size)
        path = self.path(folder, name)
        with suppress(OSError, ValueError):  # who reads it tells
            status = os.stat(path)  # noqa: PTH116
            return DiskFile(path, status.st_size, status.st_mtime_ns)
        return DiskFile(path, size)

    def blobs(self, wanted: Iterable[tuple[str, str, int]], skipped: list[Skipped]) -> list[Blob]:
        """Return files (folder, name, size) of one series, which will be read whole."""
        given = list(wanted)
        if self.archive:
            names = {f"{folder}/{name}" if folder else name for folder, name, _ in given}
            return list(self._archive_blobs(skipped, names))
        if not self.is_remote:
            return [self.blob(*one) for one in given]
        files = self._remote[0]
        paths = [self.path(folder, name) for folder, name, _ in given]
        try:  # together, for each request waits; and not by `cat`, for which a name with brackets is a pattern
            content = files.cat_ranges(paths, None, None, on_error="return")
        except Exception as error:
            raise InputError(
                f"{printable(self.root)} cannot be read ({printable(error)}); see to its store"
            ) from error
        found: list[Blob] = []
        for path, value in zip(paths, content, strict=True):
            if isinstance(value, bytes):
                found.append(Fetched(printable(path), value))
            else:
                skipped.append(
                    Skipped(printable(path), f"it cannot be fetched ({printable(value)}); see to its store", True)
                )
        return found

    def is_archive(self, folder: str, name: str, size: int) -> bool:
        """Whether a file of this root is a zip archive."""
        return not self.archive and starts_as_archive(self.blob(folder, name, size))

    def _remote_files(self, skipped: list[Skipped]) -> Iterator[Met]:
        files, path = self._remote
        try:
            of_file = files.info(path) if files.isfile(path) else None
            is_there = of_file is not None or files.exists(path)
        except Exception as error:  # each store's library has errors of its own
            raise InputError(
                f"{printable(self.root)} cannot be listed ({printable(error)}); see to its store"
            ) from error
        if not is_there:
            raise self._nothing_there()
        if of_file is not None:
            yield Met("", kept_name(path.rpartition("/")[2]), int(of_file.get("size") or 0), _stamp(of_file))
            return
        pending = [path]
        while pending:
            folder = pending.pop()
            try:
                listed = files.ls(folder, detail=True)
            except Exception as error:
                reason = f"the folder cannot be opened ({printable(error)}); see to its store"
                skipped.append(Skipped(printable(folder or self.root), reason, True, folder))
                continue
            below = self.below(folder)
            for info in listed:
                whole = info["name"].rstrip("/")
                name, is_folder = whole.rpartition("/")[2], info["type"] == "directory"
                if whole == folder or (is_folder and is_system_folder(name)):
                    skipped += _nameless(info, folder)
                    continue  # stores have empty objects that stand for folders
                if is_folder:
                    pending.append(whole)
                elif info["type"] == "file" or info.get("islink"):  # a pipe may never end
                    yield Met(below, kept_name(name), int(info.get("size") or 0), _stamp(info))

    def _nothing_there(self) -> InputError:
        """Return why there is nothing behind a URL; fsspec takes a web server that does not answer for an empty one."""
        files, path = self._remote
        cause: object = None
        try:
            files.info(path)
        except Exception as error:
            cause = error.__cause__
        is_missing = cause is None or isinstance(cause, FileNotFoundError | LookupError)
        if is_missing or getattr(cause, "status", None) in _NOT_FOUND:
            return InputError(f"there is no file or folder {printable(self.root)}; check its address")
        return InputError(f"{printable(self.root)} cannot be reached ({printable(cause)}); see to its server")

    def _archive_blobs(
        self, skipped: list[Skipped], wanted: set[str] | None
    ) -> Iterator[ZipMember | UnpackedMember]:
        path = self.path("", self.archive)
        raw = None
        if self.is_remote:
            try:
                raw = self._remote[0].open(path, "rb")
            except Exception as error:
                raise InputError(
                    f"{printable(path)} cannot be opened ({printable(error)}); see to its store"
                ) from error
        return zip_members(Path(path), LIMITS, skipped, raw=raw, wanted=wanted)


def _nameless(info: dict[str, Any], folder: str) -> list[Skipped]:
    """Return what is to be told of a folder in ``folder`` whose name is empty: of objects that are called a//b."""
    if info["type"] != "directory" or info["name"] != f"{folder}/":
        return []
    return [Skipped(printable(f"{folder}//"), NAMELESS, True, f"{folder}//")]


def _stamp(info: dict[str, Any]) -> str:
    """Return what a file system tells of a file that changes with its content."""
    names = ("ETag", "etag", "md5Hash", "mtime", "LastModified", "last_modified", "created")
    return next((str(info[name]) for name in names if info.get(name)), "")
