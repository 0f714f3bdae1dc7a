"""A file as a named run of bytes, opened without waiting, and what is said of one that was left out."""

from __future__ import annotations

import os
import re
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol

from ronnaplan.errors import InputError
from ronnaplan.portable import read_at, read_into
from ronnaplan.text import printable

_READ_WITHOUT_WAITING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""A pipe is opened at once, and then refused."""


class NotDicomError(InputError):
    """The file is of another kind altogether."""


class DamagedError(InputError):
    """The file is of the right kind but broken."""

    def with_remedy(self, remedy: str) -> str:
        """Return what was found and what to do; a sentence that says that itself, behind a semicolon, as it is.

        A semicolon between quotation marks is the file's.
        """
        found = str(self)
        return found if ";" in re.sub("'.*'", "", found) else f"{found}; {remedy}"


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


class Copied:
    """What can be read into new memory only, as a `Blob`: ``read`` is its own."""

    __slots__ = ()

    def read(self, offset: int, count: int) -> bytes:
        """Return ``count`` bytes from ``offset``, fewer at the end."""
        raise NotImplementedError

    def read_into(self, offset: int, target: memoryview) -> int:
        """Fill ``target`` from ``offset``; return how many bytes there were."""
        content = self.read(offset, len(target))
        target[: len(content)] = content
        return len(content)


def starts_with(blob: Blob, signature: bytes) -> bool:
    """Whether a file starts so; False where it cannot be read."""
    try:
        return blob.read(0, len(signature)) == signature
    except DamagedError:
        return False


@dataclass(frozen=True, slots=True)
class DiskFile:
    """A regular file; ``changed_ns`` is when it was last written (ns since 1970), as far as that was looked up.

    It is read as it was then, or not: a header and the pixels of another image would make a slice that never was.
    """

    path: str
    size: int
    changed_ns: int = 0

    @property
    def name(self) -> str:
        """The path, safe to print."""
        return printable(self.path)

    def read(self, offset: int, count: int) -> bytes:
        """Return ``count`` bytes from ``offset``, fewer at the end."""
        with self._opened() as descriptor:
            return read_at(descriptor, count, offset)

    def read_into(self, offset: int, target: memoryview) -> int:
        """Fill ``target`` from ``offset``; return how many bytes there were."""
        with self._opened() as descriptor:
            return read_into(descriptor, target, offset)

    @contextmanager
    def _opened(self) -> Iterator[int]:
        descriptor = _open_descriptor(self.path, "it")
        try:
            yield descriptor
            status = os.fstat(descriptor)
            if status.st_size != self.size or (self.changed_ns and status.st_mtime_ns != self.changed_ns):
                raise DamagedError("it was changed since it was listed; read it again when nothing writes to it")
        except OSError as error:
            raise DamagedError(f"it cannot be read ({error.strerror}); see to its disk") from error
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
        raise DamagedError(
            f"{shown} cannot be opened ({printable(reason)}); see whether it is there and may be read"
        ) from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise DamagedError(f"{shown} is not a regular file; leave it out")
    return descriptor


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file or folder that was left out, and why; ``is_trouble`` when it may have held a wanted image.

    ``path`` is where it lies, of what a walk through folders could not open.
    """

    name: str
    reason: str
    is_trouble: bool
    path: str = ""


def inflate(content: bytes, most: int) -> bytes:
    """Return up to ``most`` inflated bytes of a deflated data set; raises `DamagedError`."""
    try:
        return zlib.decompressobj(-zlib.MAX_WBITS).decompress(content, most)
    except zlib.error as error:
        raise DamagedError("its deflated data cannot be unpacked") from error


def given_path(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` as a `Path`; raises `InputError` for an empty one (it would mean the current folder)."""
    try:
        text = os.fspath(path)
    except TypeError as error:
        raise InputError(f"{path!r} is no path; give the path of a CT") from error
    if not isinstance(text, str) or not text:
        raise InputError(f"the path {text!r} was given; expected the path of a CT")
    return Path(text)
