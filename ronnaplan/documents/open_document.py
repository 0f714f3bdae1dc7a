"""A document that a program keeps open: its next change is made to what it knows, others' changes are noticed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypeVar

from ronnaplan.documents.files import change_document
from ronnaplan.errors import InputError

Document = TypeVar("Document")

Stamp = tuple[int, int, int] | None
"""Time, size and number of a file; another one after every write. None: there is no file."""

NOT_LOOKED_AT: Stamp = (0, 0, 0)
"""Of no file there can be."""


class Kept(Generic[Document]):
    """One document as it was last read or written here. ``content`` is None where there is none."""

    def __init__(
        self,
        path: Path,
        read: Callable[[Path], Document],
        text: Callable[[Document], str],
        merge: Callable[[Document, Document, Document], Document] | None = None,
    ) -> None:
        """Read the document at ``path``, if there is one.

        ``merge(base, mine, theirs)`` returns ``theirs`` with the change that led from ``base`` to ``mine``, or raises
        `InputError`; without it what both have changed is refused.
        """
        self.path, self._read, self._text, self._merge = path, read, text, merge
        self._stamp = _stamp(path)
        self._written: tuple[bytes, Document] | None = None
        """What was written here last, as the file has it."""
        self.content: Document | None = self._there()

    def write(self, mine: Document) -> Document:
        """Write ``mine``, a change of ``content``; return what was written, others' changes with it.

        Raises `InputError`, and writes nothing, where another hand changed the same thing or the file cannot be
        written. A file that was removed is written anew.
        """
        base = self.content

        def change(theirs: Document | None) -> Document:
            if theirs is None or self._same(theirs, base):
                return mine
            if self._merge is None or base is None:
                raise InputError(
                    f"{self.path.name} was changed by another hand meanwhile; look again, then change it"
                )
            return self._merge(base, mine, theirs)

        written: Document | None = change_document(self.path, lambda _: self._there(), change, self._text_of)
        assert written is not None
        self.content, self._stamp = written, NOT_LOOKED_AT  # looked at once more: another may have written since
        return written

    def look_again(self) -> bool:
        """Read what another hand has written; return whether there is anything new.

        Raises `InputError`, once for each such write, where it cannot be read or was removed; ``content`` is then as it
        was.
        """
        stamp = _stamp(self.path)
        if stamp == self._stamp:
            return False
        self._stamp = stamp
        theirs = self._there()
        if theirs is None:
            self.require_there()
        if theirs is None or self._same(theirs, self.content):
            return False
        self.content = theirs
        return True

    def require_there(self) -> None:
        """Raise `InputError` where ``content`` is on the disk no longer: who reads the file finds something else."""
        if self.content is not None and _stamp(self.path) is None:
            raise InputError(
                f"{self.path.name} was removed, and what it held still counts here; put it back, or open the case "
                "again to go on without it"
            )

    def _there(self) -> Document | None:
        if self._written is not None and _holds(self.path, self._written[0]):
            return self._written[1]  # a plan of hundreds takes longer to read than to write
        try:
            is_there = self.path.exists()
        except OSError:  # who may not look it up does not know that there is none: to read it tells why
            is_there = True
        return self._read(self.path) if is_there else None

    def _same(self, one: Document, other: Document | None) -> bool:
        return one is other or (other is not None and self._text(one) == self._text(other))

    def _text_of(self, document: Document | None) -> str:
        assert document is not None
        text = self._text(document)
        self._written = text.encode(), document
        return text


def _stamp(path: Path) -> Stamp:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino


def _holds(path: Path, content: bytes) -> bool:
    """Whether there is a file that holds ``content`` and nothing else."""
    try:
        return path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False
