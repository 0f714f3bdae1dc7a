"""Text that came from a file or a caller, made safe for a terminal."""

from __future__ import annotations

LONGEST_TEXT = 500
"""Characters kept of a text from a file (DICOM's own limit for descriptions is 64, a path may be longer)."""

LONGEST_SENTENCE = 4000
"""Characters kept of an error's sentence, which may list several series or candidates."""


def printable(text: object, longest: int = LONGEST_TEXT) -> str:
    r"""Return ``text`` on one line, with control, invisible and direction-changing characters escaped.

    >>> printable("a\x1b[31mb\u202ec")
    'a\\x1b[31mb\\u202ec'
    """
    kept = str(text)[:longest]
    if kept.isprintable():
        return kept
    return "".join(character if character.isprintable() else _escaped(character) for character in kept)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")
