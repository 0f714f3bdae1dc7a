"""Where bytes come from: a file on disk or a member of a zip archive, and every such file below a path."""

from __future__ import annotations

import lzma
import os
import shutil
import stat
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol

from ronnaplan.ct.limits import Limits
from ronnaplan.errors import InputError
from ronnaplan.text import printable

_READ_WITHOUT_WAITING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""A pipe is opened at once, and then refused."""
_END_OF_DIRECTORY = struct.Struct("<4s4H2LH")
_ZIP64_LOCATOR = struct.Struct("<4sLQL")
_ZIP64_END = struct.Struct("<4sQ2H2L4Q")
_LONGEST_ZIP_COMMENT = 0xFFFF
_ENCRYPTED = 0x1
_UNPACKED_IN_MEMORY_BYTES = 4 << 20
"""A single slice fits; larger members hold many frames, each of which would unpack all of them before it."""


class NotDicomError(InputError):
    """The file is of another kind altogether."""


class DamagedError(InputError):
    """The file is of the right kind but broken."""


class Blob(Protocol):
    """A named run of bytes; reading raises `DamagedError` where it cannot be opened or unpacked."""

    @property
    def name(self) -> str:
        """How to call it in a message."""
        ...

    @property
    def size(self) -> int:
        """Number of bytes."""
        ...

    def read(self, offset: int, count: int) -> bytes:
        """Return ``count`` bytes from ``offset``, fewer at the end."""
        ...

    def read_into(self, offset: int, target: memoryview) -> int:
        """Fill ``target`` from ``offset``; return how many bytes there were."""
        ...


@dataclass(frozen=True, slots=True)
class DiskFile:
    """A regular file."""

    path: str
    size: int

    @property
    def name(self) -> str:
        """The path, safe to print."""
        return printable(self.path)

    def read(self, offset: int, count: int) -> bytes:
        """Return ``count`` bytes from ``offset``, fewer at the end."""
        with self._opened() as descriptor:
            return os.pread(descriptor, count, offset)

    def read_into(self, offset: int, target: memoryview) -> int:
        """Fill ``target`` from ``offset``; return how many bytes there were."""
        with self._opened() as descriptor:
            return _fill(descriptor, offset, target)

    @contextmanager
    def _opened(self) -> Iterator[int]:
        descriptor = _open_descriptor(self.path, "it")
        try:
            yield descriptor
        except OSError as error:
            raise DamagedError(f"it cannot be read ({error.strerror})") from error
        finally:
            os.close(descriptor)


def open_regular(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a file that another file names; raises `DamagedError` for what is no regular file and may never end."""
    return os.fdopen(_open_descriptor(path, printable(path)), "rb")


def _open_descriptor(path: str | os.PathLike[str], shown: str) -> int:
    try:
        descriptor = os.open(path, _READ_WITHOUT_WAITING)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise DamagedError(f"{shown} cannot be opened ({printable(reason)})") from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise DamagedError(f"{shown} is not a regular file")
    return descriptor


@dataclass(frozen=True, slots=True)
class ZipMember:
    """A small file inside a zip archive, unpacked in memory at each read."""

    archive: zipfile.ZipFile
    info: zipfile.ZipInfo

    @property
    def name(self) -> str:
        """Archive and member, safe to print."""
        return printable(f"{self.archive.filename}:{self.info.filename}")

    @property
    def size(self) -> int:
        """Number of bytes once unpacked, as declared."""
        return self.info.file_size

    def read(self, offset: int, count: int) -> bytes:
        """Return ``count`` bytes from ``offset``, fewer at the end."""
        with _unpacking(), self.archive.open(self.info) as stream:
            stream.seek(offset)
            return stream.read(count)

    def read_into(self, offset: int, target: memoryview) -> int:
        """Fill ``target`` from ``offset``; return how many bytes there were."""
        content = self.read(offset, len(target))
        target[: len(content)] = content
        return len(content)


@dataclass(frozen=True, slots=True)
class UnpackedMember:
    """A large file of a zip archive, unpacked once into a file without a name, which vanishes when closed."""

    name: str
    descriptor: int
    size: int

    def __del__(self) -> None:
        os.close(self.descriptor)

    def read(self, offset: int, count: int) -> bytes:
        """Return ``count`` bytes from ``offset``, fewer at the end."""
        return os.pread(self.descriptor, count, offset)

    def read_into(self, offset: int, target: memoryview) -> int:
        """Fill ``target`` from ``offset``; return how many bytes there were."""
        return _fill(self.descriptor, offset, target)


def _fill(descriptor: int, offset: int, target: memoryview) -> int:
    done = 0
    while done < len(target):
        count = os.preadv(descriptor, [target[done:]], offset + done)
        if count == 0:
            break
        done += count
    return done


@contextmanager
def _unpacking() -> Iterator[None]:
    """Turn what `zipfile` raises for a damaged member into one sentence."""
    try:
        yield
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, RuntimeError, ValueError) as error:
        raise DamagedError(f"it cannot be unpacked ({printable(error)})") from error


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file that was left out, and why; ``is_trouble`` when it may have held a wanted image."""

    name: str
    reason: str
    is_trouble: bool


def blobs_below(path: Path, limits: Limits, skipped: list[Skipped]) -> Iterator[Blob]:
    """Yield every file of ``path``: a folder (links are followed, each file once), a zip archive or one file.

    What cannot be opened is appended to ``skipped``. Raises `InputError` beyond the limits.
    """
    try:
        status = path.stat()
        is_archive = stat.S_ISREG(status.st_mode) and _is_archive(path)
    except FileNotFoundError as error:
        raise InputError(f"there is no file or folder {printable(path)}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{printable(path)} cannot be opened ({printable(error)})") from error
    if stat.S_ISDIR(status.st_mode):
        yield from _files_below(str(path), limits, skipped)
    elif is_archive:
        yield from _zip_members(path, limits, skipped)
    elif stat.S_ISREG(status.st_mode):
        yield DiskFile(str(path), status.st_size)
    else:
        raise InputError(f"{printable(path)} is neither a file nor a folder")


def _is_archive(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(2) == b"PK"


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


def _zip_members(path: Path, limits: Limits, skipped: list[Skipped]) -> Iterator[Blob]:
    count = _member_count(path)
    if count > limits.files:
        raise InputError(f"{printable(path)} declares {count} members; at most {limits.files} are read")
    try:
        archive = zipfile.ZipFile(path)  # stays open as long as one of its members is in use
    except (zipfile.BadZipFile, OSError, NotImplementedError, ValueError) as error:
        raise InputError(
            f"{printable(path)} is a damaged zip archive ({printable(error)}); copy it again"
        ) from error
    total = sum(info.file_size for info in archive.infolist())
    if total > limits.archive_bytes:
        raise InputError(
            f"{printable(path)} unpacks to {total} bytes, more than the limit of {limits.archive_bytes}; "
            "raise the limit if you trust it"
        )
    for info in archive.infolist():
        member = ZipMember(archive, info)
        if info.filename.endswith("/"):
            continue
        if info.flag_bits & _ENCRYPTED:
            skipped.append(Skipped(member.name, "it is encrypted", True))
        elif info.file_size > limits.file_bytes:
            skipped.append(Skipped(member.name, f"it declares {info.file_size} bytes, above the limit", True))
        elif info.file_size <= _UNPACKED_IN_MEMORY_BYTES:
            yield member
        else:
            try:
                yield _unpacked(member)
            except DamagedError as error:
                skipped.append(Skipped(member.name, str(error), True))


def _unpacked(member: ZipMember) -> UnpackedMember:
    with _unpacking(), tempfile.TemporaryFile() as file, member.archive.open(member.info) as stream:
        shutil.copyfileobj(stream, file, 1 << 20)
        file.flush()
        return UnpackedMember(member.name, os.dup(file.fileno()), member.size)


def _member_count(path: Path) -> int:
    """Return the number of members a zip declares, before its directory is read into memory."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        stream.seek(max(0, size - _LONGEST_ZIP_COMMENT - _END_OF_DIRECTORY.size - _ZIP64_LOCATOR.size))
        tail = stream.read()
        at = tail.rfind(b"PK\5\6")
        if at < 0 or at + _END_OF_DIRECTORY.size > len(tail):
            return 0
        fields = _END_OF_DIRECTORY.unpack_from(tail, at)
        bytes_per_entry = 46
        most = max(fields[4], int(fields[5]) // bytes_per_entry)
        locator_at = at - _ZIP64_LOCATOR.size
        if locator_at >= 0 and tail[locator_at : locator_at + 4] == b"PK\6\7":
            stream.seek(min(int(_ZIP64_LOCATOR.unpack_from(tail, locator_at)[2]), size))
            record = stream.read(_ZIP64_END.size)
            if len(record) == _ZIP64_END.size:
                return int(max(_ZIP64_END.unpack(record)[6:8]))
    return most if fields[4] == 0xFFFF else int(fields[4])


def given_path(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` as a `Path`; raises `InputError` for an empty one (it would mean the current folder)."""
    try:
        text = os.fspath(path)
    except TypeError as error:
        raise InputError(f"{path!r} is no path; give the path of a CT") from error
    if not isinstance(text, str) or not text:
        raise InputError(f"the path {text!r} was given; expected the path of a CT")
    return Path(text)
