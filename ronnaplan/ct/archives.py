"""The files inside a zip archive, unpacked within limits."""

from __future__ import annotations

import lzma
import os
import shutil
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ronnaplan.ct.files import Blob, DamagedError, Skipped, fill
from ronnaplan.ct.limits import Limits
from ronnaplan.errors import InputError
from ronnaplan.text import printable

_END_OF_DIRECTORY = struct.Struct("<4s4H2LH")
_ZIP64_LOCATOR = struct.Struct("<4sLQL")
_ZIP64_END = struct.Struct("<4sQ2H2L4Q")
_LONGEST_ZIP_COMMENT = 0xFFFF
_ENCRYPTED = 0x1
_UNPACKED_IN_MEMORY_BYTES = 4 << 20
"""A single slice fits; larger members hold many frames, each of which would unpack all of them before it."""


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
        return fill(self.descriptor, offset, target)


@contextmanager
def _unpacking() -> Iterator[None]:
    """Turn what `zipfile` raises for a damaged member into one sentence."""
    try:
        yield
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, RuntimeError, ValueError) as error:
        raise DamagedError(f"it cannot be unpacked ({printable(error)})") from error


def is_archive(path: Path) -> bool:
    """Whether a file starts as zip archives do."""
    with path.open("rb") as stream:
        return stream.read(2) == b"PK"


def zip_members(path: Path, limits: Limits, skipped: list[Skipped]) -> Iterator[Blob]:
    """Yield the members of an archive, noting in ``skipped`` what cannot be read; raises `InputError` beyond limits."""
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
