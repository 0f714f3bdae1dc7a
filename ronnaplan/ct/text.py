"""Text that came from a file, made safe for a terminal."""

from __future__ import annotations

import unicodedata

_UNSAFE = {"Cc", "Cf", "Cs", "Co", "Zl", "Zp"}
LONGEST_TEXT = 200
"""Characters kept of a text from a file (DICOM's own limit for descriptions is 64)."""


def printable(text: object) -> str:
    r"""Return ``text`` on one line, with control and direction-changing characters escaped.

    >>> printable("a\x1b[31mb")
    'a\\x1b[31mb'
    """
    kept = str(text)[:LONGEST_TEXT]
    if kept.isascii() and kept.isprintable():
        return kept
    return "".join(_escaped(character) if _is_unsafe(character) else character for character in kept)


def _is_unsafe(character: str) -> bool:
    return unicodedata.category(character) in _UNSAFE


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")
