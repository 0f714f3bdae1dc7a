"""In which units a table says that its numbers are: in its header, a row or a column. Any other than mm is refused."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence, Set
from pathlib import Path

from ronnaplan.errors import InputError
from ronnaplan.text import printable
from ronnaplan.tracking.cells import MISSING, number
from ronnaplan.tracking.columns import OF_WORDS, length_columns, place_columns

LONGEST_NAME = 40
"""Of what a column is called, how much is told."""
UNIT_WORDS = frozenset({"unit", "units"})
MILLIMETRES = frozenset(
    {
        *("mm", "millimeter", "millimeters", "millimetre", "millimetres", "millimètre", "millimètres"),
        *("millimetro", "millimetri", "milímetro", "milímetros", "毫米", "мм"),
    }
)
SECONDS = frozenset({"s", "sec", "secs", "second", "seconds"})
UNIT = re.compile(
    r"[\[(]?([munµμcd]?m|in|inch|inches|zoll|pouces?|pollic[ei]|pulgadas?"
    r"|(mill?[ií]|mi[ck]ro|[cz]enti)?m[eèé]t(er|re|ro|ri)s?)[\])]?",
    re.IGNORECASE,
)
"""A cell that holds a unit of length in the place of a number. KM and foot are none: initials, and places."""
WORD = re.compile(r"[\[(]?[^\W\d_][^\d]*")
"""A cell that may hold a unit in any language."""


def require_units(
    path: Path, cells: Sequence[str], header: Sequence[str], rows: list[list[str]]
) -> list[list[str]]:
    """Return the ``rows`` below a header, without a first one that holds the columns' units, as motion capture writes.

    ``cells`` is the header as it is written, ``header`` its normalized names. Raises `InputError` for lengths not in
    mm and times not in s, stated in the header, in that first row or in a column of units.
    """
    lengths = length_columns(header)
    times = [k for k, name in enumerate(header) if name.split("_")[0] == "time"]
    judged = ((lengths, "mm", MILLIMETRES), (times, "s", SECONDS))
    for columns, expected, names in judged:
        for k in columns:
            _require_unit(path, cells[k], expected, names)
    stated = {k: cell.strip() for k, cell in enumerate(rows[0] if rows else []) if cell.strip()}
    if _are_units(stated, header, lengths, rows[1:]):
        for columns, expected, names in judged:
            for k in sorted(stated.keys() & set(columns)):
                _require_stated(path, stated[k], header[k], expected, names)
        rows = rows[1:]
    _require_mm(path, header, rows)
    return rows


def of_units(header: Sequence[str], rows: Sequence[Sequence[str]]) -> set[int]:
    """Return the columns that are called units, or in which each cell that is not empty is a unit of length."""
    called = {k for k, name in enumerate(header) if UNIT_WORDS & set(name.split("_"))}
    others = (k for k, name in enumerate(header) if name not in OF_WORDS and any(held(rows, k)))
    return called.union(k for k in others if all(map(_is_unit, held(rows, k))))


def held(rows: Sequence[Sequence[str]], column: int) -> Iterator[str]:
    """Yield the cells of a column that are not empty."""
    return (cell for row in rows if column < len(row) and (cell := row[column].strip()))


def _are_units(
    stated: dict[int, str], header: Sequence[str], lengths: Sequence[int], below: Sequence[Sequence[str]]
) -> bool:
    """Whether the first row below a header holds words where lengths stand.

    Words that are no known units say that a marker was not seen where they stand further ``below``, too, not under each
    coordinate, or beside a number, name or status.
    """
    words = {k: stated[k] for k in lengths if k in stated}
    if not words or all(map(UNIT.fullmatch, words.values())):
        return bool(words)
    if any(word.lower() in MISSING or WORD.fullmatch(word) is None for word in words.values()):
        return False
    of_words = {k for k, name in enumerate(header) if name in OF_WORDS}
    beside = {k: cell for k, cell in stated.items() if k not in words and cell.strip("[]()") != "-"}
    is_reading = of_words & beside.keys() or any(number(cell, ";") is not None for cell in beside.values())
    if is_reading or not words.keys() >= set(place_columns(header)):
        return False
    return not any(cell in words.values() for k in words for cell in held(below, k))


def _require_stated(path: Path, unit: str, name: str, expected: str, names: Set[str]) -> None:
    """Raise `InputError` for a ``unit`` below a column's ``name`` that is not ``expected``, by any of its ``names``."""
    if unit.strip("[]()").lower() not in names:
        raise InputError(
            f"{path} says '{printable(unit, LONGEST_NAME)}' right below its column {printable(name, LONGEST_NAME)}, "
            f"where its unit may stand; expected {expected}, so convert the numbers, or delete that row"
        )


def _require_unit(path: Path, cell: str, expected: str, names: Set[str]) -> None:
    """Raise `InputError` for a column's name with a unit that is not ``expected``, by any of its ``names``."""
    stated = re.search(r"[\[(](.*?)[\])]", cell) or re.search(
        r"[_ ]([munµμcd]?m|in|inch|inches)$", cell.strip().lower()
    )
    if stated and stated[1].strip().lower() not in names:
        raise InputError(
            f"{path} has the column '{cell.strip()}'; expected it in {expected}, so convert the numbers and rename it"
        )


def _require_mm(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Raise `InputError` where a column says for its row that lengths are not in mm.

    It is called ``unit``, ``length_unit`` ..., or, as in other languages, otherwise, and holds nothing but units.
    """
    for column in sorted(k for k in of_units(header, rows) if "time" not in header[k]):
        for place, row in enumerate(rows, start=1):
            stated = row[column].strip() if column < len(row) else ""
            if stated.lower() not in MISSING | MILLIMETRES:
                raise InputError(
                    f"{path} row {place} below the header says its unit is '{printable(stated)}' (column "
                    f"'{printable(header[column], LONGEST_NAME)}'); expected mm, so convert the numbers"
                )


def _is_unit(cell: str) -> bool:
    return cell != "M" and UNIT.fullmatch(cell) is not None  # M stands for marker, male, missing ...
