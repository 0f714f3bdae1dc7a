"""The file that an instance is written to while it arrives."""

from __future__ import annotations

import io
import os
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pynetdicom.dimse_messages
from pynetdicom import _config


class Spool:
    """A file in the folder for incoming instances, as pynetdicom writes one.

    A disk that takes no more is no reason to end the association: ``error`` says so when the instance is whole, and
    its sender is told then. The file is removed with the spool, unless it has got another name.
    """

    def __init__(self, folder: Path) -> None:
        self.error: OSError | None = None
        self.name = str(folder / "unwritten.dcm")
        try:
            handle, self.name = tempfile.mkstemp(suffix=".dcm", dir=folder)
        except OSError as error:
            self.error = error
            return
        self._stream = io.FileIO(handle, "wb")
        # a peer may go when its instance is whole and nobody has looked at it yet
        self._remove = weakref.finalize(self, _remove, self._stream, self.name)

    @property
    def file(self) -> Spool:
        """What pynetdicom flushes."""
        return self

    def write(self, content: bytes) -> int:
        """Write ``content`` at once; after an error nothing more is written."""
        if self.error is None:
            try:
                rest = memoryview(content)
                while rest:
                    rest = rest[write(self._stream.fileno(), rest) :]
            except OSError as error:
                self.error = error
                self._remove()  # gives its room back
        return len(content)

    def flush(self) -> None:
        """Nothing: every write is done at once."""

    def sync(self) -> None:
        """Wait until the content is on the disk; raises the OSError of any step since the beginning."""
        if self.error is not None:
            raise self.error
        os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Let go of the file."""
        if self.error is None:
            self._stream.close()


def write(handle: int, content: memoryview) -> int:
    """Write as much of ``content`` as the system takes at once; return how much."""
    return os.write(handle, content)


def _remove(stream: io.FileIO, name: str) -> None:
    stream.close()
    with suppress(OSError):
        Path(name).unlink()


@contextmanager
def spooled(folder: Path) -> Iterator[None]:
    """Have instances that arrive meanwhile written to files in ``folder``, whatever their number, as they come."""
    messages: Any = pynetdicom.dimse_messages  # what it imports is no part of its interface
    before = _config.STORE_RECV_CHUNKED_DATASET, messages.NamedTemporaryFile
    _config.STORE_RECV_CHUNKED_DATASET, messages.NamedTemporaryFile = True, lambda **_: Spool(folder)
    try:
        yield
    finally:
        _config.STORE_RECV_CHUNKED_DATASET, messages.NamedTemporaryFile = before
