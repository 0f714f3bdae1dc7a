"""The file that an instance is written to while it arrives."""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path

from pynetdicom import PYNETDICOM_IMPLEMENTATION_UID, PYNETDICOM_IMPLEMENTATION_VERSION

from ronnaplan.portable import sync

BEGINNING_BYTES = 64 << 10
"""So much stays of an instance that cannot be written whole, until its sender is told: it says whose it is."""


class Spool:
    """A DICOM file in a folder for incoming instances.

    A disk that takes no more is no reason to end the association: `sync` says so when the instance is whole, and its
    sender is told then. The file is removed with the spool, until `keep` leaves it there.
    """

    def __init__(self, folder: Path, sop_class: str, sop_uid: str, syntax: str) -> None:
        self._error: OSError | None = None
        self._is_begun = False
        self._digest = hashlib.sha256()
        self.path = folder / "unwritten.dcm"
        try:
            handle, name = tempfile.mkstemp(suffix=".dcm", dir=folder)
        except OSError as error:
            self._error = error
            return
        self.path = Path(name)
        self._is_begun = True
        self._stream = io.FileIO(handle, "wb")
        # a peer may go before its instance is whole
        self._remove = weakref.finalize(self, _remove, self._stream, name)
        self._write(file_beginning(sop_class, sop_uid, syntax))

    @property
    def sha256(self) -> str:
        """That of the data set so far, without the file's meta part, whose content is each receiver's own."""
        return self._digest.hexdigest()

    def write(self, content: memoryview) -> None:
        """Write a part of the data set at once; after an error nothing more is written."""
        self._digest.update(content)
        self._write(content)

    def _write(self, content: bytes | memoryview) -> None:
        if self._error is None:
            try:
                rest = memoryview(content)
                while rest:
                    rest = rest[write(self._stream.fileno(), rest) :]
            except OSError as error:
                self._error = error
                with suppress(OSError):  # gives its room back
                    self._stream.truncate(min(self._stream.tell(), BEGINNING_BYTES))

    def sync(self) -> None:
        """Wait until the content is on the disk; raises the OSError of any step since the beginning."""
        if self._error is not None:
            raise self._error
        sync(self._stream.fileno())
        self._stream.close()

    def keep(self) -> None:
        """Leave the file to who has its path."""
        self._remove.detach()

    def remove(self) -> None:
        """Remove the file, where there is one."""
        if self._is_begun:
            self._remove()


def write(handle: int, content: memoryview) -> int:
    """Write as much of ``content`` as the system takes at once; return how much."""
    return os.write(handle, content)


def file_beginning(sop_class: str, sop_uid: str, syntax: str) -> bytes:
    """Return what stands before the data set in a file: preamble and meta part (PS3.10, 7.1)."""
    meta = _element(1, b"OB", b"\0\1")
    for number, uid in ((2, sop_class), (3, sop_uid), (0x10, syntax), (0x12, PYNETDICOM_IMPLEMENTATION_UID)):
        meta += _element(number, b"UI", uid.encode("ascii", "replace"))
    meta += _element(0x13, b"SH", PYNETDICOM_IMPLEMENTATION_VERSION.encode("ascii"))
    return bytes(128) + b"DICM" + _element(0, b"UL", len(meta).to_bytes(4, "little")) + meta


def _element(number: int, form: bytes, value: bytes) -> bytes:
    value += (b" " if form == b"SH" else b"\0") * (len(value) % 2)
    length = b"\0\0" + len(value).to_bytes(4, "little") if form == b"OB" else len(value).to_bytes(2, "little")
    return b"\2\0" + number.to_bytes(2, "little") + form + length + value


def _remove(stream: io.FileIO, name: str) -> None:
    stream.close()
    with suppress(OSError):
        Path(name).unlink()
