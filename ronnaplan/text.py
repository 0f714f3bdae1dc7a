"""Text that came from a file or a caller: made safe for a terminal, and taken for a number by the letter only."""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence

NOTICE = "Research software, not a medical device."
"""What pages, reports and the command say of all this."""

LONGEST_TEXT = 500
"""Characters kept of a text from a file (DICOM's own limit for descriptions is 64, a path may be longer)."""

LONGEST_SENTENCE = 4000
"""Characters kept of an error's sentence, which may list several series or candidates."""

LONGEST_LISTED = 60
"""Characters kept of a name in a sentence that lists several."""

MOST_DIGITS = 20
"""A whole number with more digits is damage: nanoseconds since 1970 have 19."""

LONGEST_NUMBER = 64
"""Characters of a number as programs write one; Python's shortest form needs 24."""

BLANKS = " \t\r\n"
"""What may stand around a number. Python strips other control characters, too, each of which may be a damaged digit."""

ISOLATE, ISOLATE_END = "\u2068", "\u2069"
"""Unicode's first strong isolate, and its end. No name in a document holds them: they are not printable."""

SOFT_HYPHEN = "\u00ad"

ELLIPSIS = "\u2026"
"""Stands for the middle of a name that is written shorter than it is."""

PLAIN_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")


def printable(text: object, longest: int = LONGEST_TEXT) -> str:
    r"""Return ``text`` on one line, with control, invisible and direction-changing characters escaped.

    >>> printable("a\x1b[31mb\u202ec")
    'a\\x1b[31mb\\u202ec'
    """
    kept = str(text)[:longest]
    if kept.isprintable():
        return kept
    return "".join(character if character.isprintable() else _escaped(character) for character in kept)


def isolated(name: str) -> str:
    """Return a name that is written whole in a page's text, in the direction of its own letters: between isolates.

    One without letters from right to left needs none. For pages only: a terminal may draw the isolates.

    >>> isolated("left (2)"), isolated("\u05e9\u05de (2)") == "\u2068\u05e9\u05de (2)\u2069"
    ('left (2)', True)
    """
    turned = any(unicodedata.bidirectional(letter) in ("R", "AL") for letter in name)
    return f"{ISOLATE}{name}{ISOLATE_END}" if turned else name


def place(position_mm: Iterable[float]) -> str:
    """Return a position in mm for a person to read.

    >>> place([1.0, -2.25, 0.04])
    '(1.0, -2.2, 0.0)'
    """
    return f"({', '.join(f'{value:.1f}' for value in position_mm)})"


def columns(text: str) -> int:
    """Return how many columns of a terminal a text takes: two a Chinese letter, say, and none an accent by itself.

    Nor does a mark of format, as the one that joins emoji; a soft hyphen does, by custom.

    >>> columns("STN"), columns("\u6d77\u99ac"), columns("e\u0301"), columns("a\u200d")
    (3, 4, 1, 1)
    """
    wide = sum(unicodedata.east_asian_width(letter) in "WF" for letter in text)
    bare = text.replace(SOFT_HYPHEN, "-")
    return len(text) + wide - sum(unicodedata.category(letter) in ("Mn", "Me", "Cf") for letter in bare)


def table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of cells as lines of a table, each column as wide as its widest cell.

    >>> table([["name", "mm"], ["left", "71.6"]])
    ['name  mm', 'left  71.6']
    """
    widths = [max(map(columns, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(filled(cell, width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]


def abridged(name: str, longest: int = LONGEST_LISTED) -> str:
    """Return a name in ``longest`` characters at most: its beginning and its end, for it may be told by either.

    >>> abridged("left"), abridged("left amygdala, second", longest=9), abridged("left lead two", longest=6)
    ('left', 'left\u2026cond', 'lef\u2026wo')
    """
    if len(name) <= longest:
        return name
    first, last = longest // 2, (longest - 1) // 2
    return f"{name[:first].rstrip()}{ELLIPSIS}{name[len(name) - last :].lstrip()}"


def told_apart(names: Iterable[str], longest: int = LONGEST_LISTED) -> dict[str, str]:
    """Return each of some names `abridged`, by the name; those that would read alike then stay whole.

    >>> list(told_apart(["left lead", "right lead"], longest=8).values())
    ['left\u2026ead', 'righ\u2026ead']
    >>> list(told_apart(["lead left end", "lead right end"], longest=6).values())
    ['lead left end', 'lead right end']
    """
    shown = {name: abridged(name, longest) for name in names}
    alike = Counter(shown.values())
    return {name: short if alike[short] == 1 else name for name, short in shown.items()}


def counted(number: int, noun: str) -> str:
    """Return so many of a thing, which has an s where they are several.

    >>> counted(1, "marker"), counted(0, "rejected candidate")
    ('1 marker', '0 rejected candidates')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def chance(value: float | None, digits: int = 3) -> str:
    """Write a chance; none that is not certain as if it were.

    >>> chance(0.9994), chance(0.9996), chance(0.0004), chance(None), chance(0.9999996, 6)
    ('0.999', '> 0.999', '< 0.001', '-', '> 0.999999')
    """
    if value is None or math.isnan(value):
        return "-"
    least = 10.0**-digits
    if value >= 1.0 - least / 2:
        return f"> {1.0 - least:.{digits}f}"
    return f"< {least:.{digits}f}" if value < least / 2 else f"{value:.{digits}f}"


def sizes(diameters_mm: Iterable[float]) -> str:
    """Return the diameters that were looked for, to the micrometre, for a sentence that says so.

    >>> sizes([11.5]), sizes([8.0, 11.5]), sizes([5.740537])
    ('11.5', '8 or 11.5', '5.741')
    """
    return " or ".join(f"{round(diameter_mm, 3):g}" for diameter_mm in diameters_mm)


def listed(names: Iterable[str], most: int = 10) -> str:
    """Return names for a sentence that says which there are: each, and their number, within reason.

    >>> listed(["left", "right"]), listed([]), listed("abc", most=2)
    ('left, right', 'none', 'a, b and 1 more')
    """
    shown = [printable(abridged(name)) for name in names]
    more = f" and {len(shown) - most} more" if len(shown) > most else ""
    return f"{', '.join(shown[:most])}{more}" or "none"


def runs(names: Sequence[object], which: Iterable[int]) -> list[str]:
    """Return the names at the indices ``which``, in their order, and such as follow each other as one.

    >>> runs([4, 5, 7, 8, 20], [0, 1, 2, 4])
    ['4-7', '20']
    """
    return [f"{names[a]}" if a == b else f"{names[a]}-{names[b]}" for a, b in successive(which)]


def successive(which: Iterable[int]) -> list[tuple[int, int]]:
    """Return the first and the last of each run of numbers that follow each other.

    >>> successive([0, 1, 2, 4])
    [(0, 2), (4, 4)]
    """
    found: list[tuple[int, int]] = []
    for one in which:
        if found and one == found[-1][1] + 1:
            found[-1] = (found[-1][0], one)
        else:
            found.append((one, one))
    return found


def as_read(name: str) -> str:
    """Return a name as it reads in a list, where neither blanks nor how accents are coded can be told.

    >>> as_read(" left  HC ") == as_read("left HC") != as_read("leftHC")
    True
    """
    return " ".join(unicodedata.normalize("NFC", name).split())


def filled(text: str, width: int) -> str:
    """Return ``text`` with so many blanks behind it that it takes ``width`` columns of a terminal, or more."""
    return text + " " * (width - columns(text))


def plain_number(text: str) -> float | None:
    r"""Return the number that ``text`` is, written with ASCII digits and a point; None for anything else.

    Python's own ``float`` takes digit groups (``1_0``), digits of other scripts, ``nan`` and ``infinity``, too.

    >>> plain_number(" -1.5e3 "), plain_number("1_0"), plain_number("1,5"), plain_number("nan")
    (-1500.0, None, None, None)
    >>> plain_number("10\x1c"), plain_number("\xa05")
    (None, None)
    """
    bare = text.strip(BLANKS)
    if len(bare) > LONGEST_NUMBER or not PLAIN_NUMBER.fullmatch(bare):
        return None
    value = float(bare)
    return value if math.isfinite(value) else None


def whole_number(text: str) -> int | None:
    """Return the whole number that ``text`` is, written with ASCII digits; None for anything else."""
    bare = text.strip(BLANKS)
    return int(bare) if re.fullmatch(rf"[+-]?[0-9]{{1,{MOST_DIGITS}}}", bare) else None


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")
