"""The files inside a zip archive, unpacked within limits."""

from __future__ import annotations

import io
import lzma
import os
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Container, Iterator
from dataclasses import dataclass
from pathlib import Path

from ronnaplan.ct.files import Blob, Copied, DamagedError, Skipped, starts_with
from ronnaplan.ct.limits import Limits
from ronnaplan.ct.system_folders import WHY_LEFT_PACKED, is_below_system_folder
from ronnaplan.errors import InputError
from ronnaplan.portable import read_at, read_into
from ronnaplan.text import printable

SIGNATURE = b"PK"
"""How zip archives start."""

_ENCRYPTED = 0x1
_METHODS = frozenset({zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA})
"""How members may be packed."""
_DAMAGE = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, RuntimeError, ValueError)
_UNPACKED_IN_MEMORY_BYTES = 4 << 20
"""A single slice fits; larger members hold many frames, each of which would unpack all of them before it."""


@dataclass(frozen=True, slots=True)
class ZipMember(Copied):
    """A small file inside a zip archive, unpacked in memory at each read."""

    archive: zipfile.ZipFile
    info: zipfile.ZipInfo

    @property
    def name(self) -> str:
        """Archive and member, safe to print."""
        return printable(f"{self.archive.filename}:{self.info.filename}")

    @property
    def member(self) -> str:
        """Its path inside the archive."""
        return self.info.filename

    @property
    def size(self) -> int:
        """Number of bytes once unpacked, as declared."""
        return self.info.file_size

    def read(self, offset: int, count: int) -> bytes:
        """Return ``count`` bytes from ``offset``, fewer at the end."""
        with _Unpacking(), self.archive.open(self.info) as stream:
            return stream.read(offset + count)[offset:]  # from Python 3.12 on, `seek` drops the check of the sum


@dataclass(frozen=True, slots=True)
class UnpackedMember:
    """A large file of a zip archive, unpacked once into a file without a name, which vanishes when closed."""

    name: str
    descriptor: int
    size: int
    member: str

    def __del__(self) -> None:
        os.close(self.descriptor)

    def read(self, offset: int, count: int) -> bytes:
        """Return ``count`` bytes from ``offset``, fewer at the end."""
        return read_at(self.descriptor, count, offset)

    def read_into(self, offset: int, target: memoryview) -> int:
        """Fill ``target`` from ``offset``; return how many bytes there were."""
        return read_into(self.descriptor, target, offset)


class _Unpacking:
    """Turns what `zipfile` raises for a damaged member into one sentence.

    No generator: in Python 3.13 the error would lie in a circle with its frames, and keep the archive open.
    """

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, _DAMAGE):
            raise DamagedError(f"it cannot be unpacked ({printable(error)}); copy its archive again") from error


class _BoundedReader(io.BufferedReader):
    """A file of which at most ``most`` bytes are read at once."""

    def __init__(self, raw: io.RawIOBase, most: int) -> None:
        super().__init__(raw)
        self._most = most

    def read(self, size: int | None = -1, /) -> bytes:
        """Return the next ``size`` bytes, or all that are left."""
        content = super().read(self._most + 1 if size is None or size < 0 else min(size, self._most + 1))
        if len(content) > self._most:
            raise ValueError(f"its directory is longer than {self._most} bytes")
        return content


class _Archive(zipfile.ZipFile):
    """An archive whose directory is bounded: `zipfile` reads all of it, whatever number of members is declared."""

    def __init__(self, raw: io.RawIOBase, name: str, most_directory_bytes: int) -> None:
        self._file = _BoundedReader(raw, max(most_directory_bytes, _UNPACKED_IN_MEMORY_BYTES))
        try:
            super().__init__(self._file)
        except BaseException:
            self._file.close()
            raise
        self.filename = name

    def close(self) -> None:
        """Close the file, too."""
        super().close()
        self._file.close()


def is_archive(path: Path) -> bool:
    """Whether a file starts as zip archives do."""
    with path.open("rb") as stream:
        return stream.read(len(SIGNATURE)) == SIGNATURE


def starts_as_archive(blob: Blob) -> bool:
    """Whether a file, on the disk or not, starts as zip archives do; False where it cannot be read."""
    return starts_with(blob, SIGNATURE)


def zip_members(
    path: Path,
    limits: Limits,
    skipped: list[Skipped],
    *,
    raw: io.RawIOBase | None = None,
    wanted: Container[str] | None = None,
) -> Iterator[ZipMember | UnpackedMember]:
    """Yield the members of an archive, noting in ``skipped`` what cannot be read; raises `InputError` beyond limits.

    ``raw`` is the open archive where it is no file of this machine; only members in ``wanted`` are unpacked.
    """
    archive = _opened(path, limits, raw)
    for info in archive.infolist():
        member = ZipMember(archive, info)
        if info.filename.endswith("/") or (wanted is not None and info.filename not in wanted):
            continue
        if wanted is None and is_below_system_folder(info.filename):
            skipped.append(Skipped(member.name, WHY_LEFT_PACKED, False))
        elif info.flag_bits & _ENCRYPTED:
            skipped.append(Skipped(member.name, "it is encrypted", True))
        elif info.compress_type not in _METHODS:  # Windows packs large folders by Deflate64, method 9
            reason = f"it is packed by method {info.compress_type}, which is not read; unpack the archive first"
            skipped.append(Skipped(member.name, reason, True))
        elif info.file_size > limits.file_bytes:
            skipped.append(
                Skipped(
                    member.name,
                    f"it declares {info.file_size} bytes, above the limit; raise that if you trust it",
                    True,
                )
            )
        elif info.file_size <= _UNPACKED_IN_MEMORY_BYTES:
            yield member
        else:
            try:
                yield _unpacked(member)
            except DamagedError as error:
                skipped.append(Skipped(member.name, str(error), True))


def _opened(path: Path, limits: Limits, raw: io.RawIOBase | None) -> _Archive:
    """Return an archive within ``limits``, which stays open as long as one of its members is in use."""
    try:
        archive = _Archive(io.FileIO(path) if raw is None else raw, str(path), limits.header_bytes)
    except (zipfile.BadZipFile, OSError, NotImplementedError, ValueError) as error:
        raise InputError(
            f"{printable(path)} is a damaged zip archive ({printable(error)}); copy it again"
        ) from error
    try:
        _check_limits(archive, path, limits)
    except InputError:
        archive.close()  # the error's traceback would hold it
        raise
    return archive


def _check_limits(archive: _Archive, path: Path, limits: Limits) -> None:
    count = len(archive.infolist())
    if count > limits.files:
        raise InputError(
            f"{printable(path)} declares {count} members; at most {limits.files} are read: unpack it, and name the "
            "folder of one scan"
        )
    total = sum(info.file_size for info in archive.infolist())
    if total > limits.archive_bytes:
        raise InputError(
            f"{printable(path)} unpacks to {total} bytes, more than the limit of {limits.archive_bytes}; "
            "raise the limit if you trust it"
        )


def _unpacked(member: ZipMember) -> UnpackedMember:
    with _Unpacking(), tempfile.TemporaryFile() as file, member.archive.open(member.info) as stream:
        shutil.copyfileobj(stream, file, 1 << 20)
        file.flush()
        return UnpackedMember(member.name, os.dup(file.fileno()), member.size, member.member)
