"""Text tables with a header: delimiter found, column names normalized, numbers parsed, nothing guessed."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from ronnaplan.errors import InputError

DELIMITERS = (",", ";", "\t")
LARGEST_NUMBER = 1e19
"""Nanoseconds since 1970 fit; what is larger, or infinite, is damage."""
LENGTHS = frozenset({"x", "y", "z", "tx", "ty", "tz", "sigma"})
"""Columns that are lengths in mm."""
TIMES = frozenset({"time", "timestamp", "timespec"})
"""Columns that are times in s."""
MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "missing", "-"})


def read_text(path: Path) -> str:
    """Return the text of ``path``; raises `InputError` for a file that is missing, unreadable or not text."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text file; expected tracker readings") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); check the path") from error


def read_rows(path: Path) -> tuple[list[str], list[list[str]], str]:
    """Return the header's normalized names, the rows below it and the delimiter. Blank lines are left out.

    Raises `InputError` for a file without a header, and for lengths not in mm or times not in s.
    """
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    if not lines:
        raise InputError(f"{path} is empty; expected a header and tracker readings")
    delimiter = max(DELIMITERS, key=lines[0].count)
    try:
        rows = list(csv.reader(lines, delimiter=delimiter))
    except csv.Error as error:
        raise InputError(f"{path} is not a readable table ({error}); expected CSV with a header") from error
    header = [column_name(cell) for cell in rows[0]]
    if any(number(cell, delimiter) is not None for cell in rows[0]):
        raise InputError(f"{path} has no header; its first line must name the columns, such as label,x,y,z")
    for cell, name in zip(rows[0], header, strict=True):
        _require_unit(path, cell, name)
    return header, rows[1:], delimiter


def _require_unit(path: Path, cell: str, name: str) -> None:
    """Raise `InputError` for a length that is not in mm or a time that is not in s."""
    quantity = name.split("_")[0]
    expected = "mm" if quantity in LENGTHS else "s" if quantity in TIMES else None
    stated = re.search(r"[\[(](.*?)[\])]", cell) or re.search(
        r"[_ ]([munµμcd]?m|in|inch|inches)$", cell.strip().lower()
    )
    if expected and stated and stated[1].strip().lower() != expected:
        raise InputError(
            f"{path} has the column '{cell.strip()}'; expected it in {expected}, so convert the numbers and rename it"
        )


def column_name(cell: str) -> str:
    """Return ``cell`` lower-case, without ``#``, unit or brackets: ``"#Tx [mm]"`` becomes ``"tx"``.

    >>> column_name(" X (mm)"), column_name("Frame#"), column_name("sigma_mm"), column_name("time_s")
    ('x', 'frame', 'sigma', 'time')
    """
    bare = re.sub(r"[\[(].*?[\])]", "", cell).replace("#", "").strip().lower()
    return re.sub(r"_(mm|s)$", "", bare.replace(" ", "_")).strip("_")


def number(cell: str, delimiter: str = ",") -> float | None:
    """Return the number in ``cell``, or None for one that is missing, not numeric or beyond `LARGEST_NUMBER`.

    A decimal comma is understood where the comma is not the delimiter.
    """
    text = cell.strip()
    if text.lower() in MISSING:
        return None
    if delimiter != ",":
        text = text.replace(",", ".")
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) <= LARGEST_NUMBER else None
