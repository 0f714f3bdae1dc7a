"""What a single cell of a table of readings says: a number, a place, a frame's number, a status. Nothing is guessed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.text import BLANKS, plain_number, printable
from ronnaplan.tracking.recording import NO_POSITION, OK

MOST_FRAMES = 2**53 - 1
"""Beyond, a number that is read as a float may be a neighbour of the one that is written."""
MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "missing", "-"})
NO_PLAIN_NUMBER = "a coordinate that is no plain number, such as -1234.5"
DECIMAL_COMMA = "a coordinate with a comma, a decimal one only where ';' or a tab stands between the columns"
"""Statuses of a reading without a place, as that is written otherwise."""
NO_NUMBER = "no frame number"
"""Status of a pose of no numbered frame among numbered ones: it would be taken for another frame's."""
STATUS_COLUMNS = ("status", "state")
TRANSFORM_STATUS_COLUMNS = ("transformstatus", "transform_status")
"""By NDI and PLUS."""
HIDDEN_COLUMNS = ("occluded", "hidden", "invalid", "invisible")
TRUTH_COLUMNS = ("valid", "visible", "seen", "usable", "tracked", *HIDDEN_COLUMNS)
SEEN_COLUMNS = frozenset({*STATUS_COLUMNS, *TRANSFORM_STATUS_COLUMNS, *TRUTH_COLUMNS})
"""Columns that say whether a reading counts."""
GOOD = frozenset({OK, "okay", "good", "valid", "enabled", "tracked", "visible"})
"""What programs' statuses say of a reading that counts."""
MEASURED = GOOD | {"", "partially_out_of_volume"}
"""What is said of a tool that the tracker sees."""
TRUE = frozenset({"true", "yes", "y", "t", "ok"})
FALSE = frozenset({"0", "false", "no", "n", "f"})
FORMULA = ("=", "+", "-", "@", "\t", "\r", "'")
"""A spreadsheet takes a text that begins so for a formula, or swallows its first character."""


def number(cell: str, delimiter: str = ",") -> float | None:
    """Return the number in ``cell``, or None for one that is missing or not numeric.

    A decimal comma is understood where the comma is not the delimiter.
    """
    text = cell.strip(BLANKS)
    if text.lower() in MISSING:
        return None
    return plain_number(text if delimiter == "," else text.replace(",", "."))


def place_status(cells: Sequence[str], position_mm: FloatArray, delimiter: str = ",") -> str:
    """Return what is to be said of a place (3,) that was read from ``cells``.

    >>> place_status(["1", "", "3"], np.array([1, np.nan, 3])), place_status(["1", "-1,234.5", "3"], np.full(3, np.nan))
    ('no position', 'a coordinate that is no plain number, such as -1234.5')
    """
    if np.isfinite(position_mm).all():
        return OK
    odd = [cell for cell in cells if cell.strip(BLANKS).lower() not in MISSING and number(cell, delimiter) is None]
    if any(number(cell, ";") is not None for cell in odd):
        return DECIMAL_COMMA
    return NO_PLAIN_NUMBER if odd else NO_POSITION


def frame_number(path: Path, cell: str, delimiter: str, otherwise: int) -> int:
    """Return a frame's number, ``otherwise`` where the row has none; raises `InputError` unless it is whole."""
    if cell.strip(BLANKS).lower() in MISSING:
        return otherwise
    value = number(cell, delimiter)
    if value is None or value != int(value) or abs(value) > MOST_FRAMES:
        raise InputError(f"{path} has the frame number '{printable(cell.strip(), 40)}'; expected whole numbers")
    return int(value)


def stated_status(row: Mapping[str, str]) -> str:
    """Return what a row says of its reading: `OK` where it says nothing else.

    A word or number that is neither a yes nor a no says that it is not known whether the reading counts.

    >>> stated_status({"state": " Missing "}), stated_status({"valid": "0"}), stated_status({"x": "1"})
    ('missing', 'not valid', 'ok')
    >>> stated_status({"status": "Okay"}), stated_status({"occluded": "1"}), stated_status({"occluded": "False"})
    ('ok', 'occluded', 'ok')
    >>> stated_status({"valid": "0.0"}), stated_status({"visible": "FALSCH"}), stated_status({"visible": "4"})
    ('not valid', "visible is 'falsch', neither yes nor no", 'ok')
    >>> stated_status({"tracked": "Tracked"}), stated_status({"tracked": "lost"})
    ('ok', "tracked is 'lost', neither yes nor no")
    >>> stated_status({"occluded": "OK"})
    "occluded is 'ok', neither yes nor no"
    """
    said = [unescaped(row[name].strip()).lower() for name in STATUS_COLUMNS if row.get(name, "").strip()]
    said = [OK if word in GOOD else word for word in said]
    said += [tool_status(row.get(name, "")) for name in TRANSFORM_STATUS_COLUMNS]
    said += [
        _said_of_truth(name, row[name].strip().lower()) for name in TRUTH_COLUMNS if row.get(name, "").strip()
    ]
    return next((status for status in said if status != OK), OK)


def tool_status(cell: str) -> str:
    """Return what a tracker's ``cell`` says of a tool: `OK` where it is seen, or nothing is said.

    >>> tool_status("Enabled"), tool_status("Visible"), tool_status("Out of volume")
    ('ok', 'ok', 'out_of_volume')
    """
    name = cell.strip().lower().replace(" ", "_")
    return OK if name in MEASURED else name


def _said_of_truth(name: str, word: str) -> str:
    """Return what ``word``, not empty, in a column of truth values says; other numbers count what was seen."""
    count, is_good = number(word), name not in HIDDEN_COLUMNS
    if word in FALSE or count == 0.0:
        return f"not {name}" if is_good else OK
    is_yes = word in TRUE and (is_good or word != OK)
    if is_yes or word == name or count == 1.0 or (count is not None and count > 0.0 and is_good):
        return OK if is_good else name
    return f"{name} is '{printable(word, 40)}', neither yes nor no"


def plain_text(text: str) -> str:
    """Keep a spreadsheet from taking a text for a formula; `unescaped` takes it back.

    >>> plain_text("=1+1"), plain_text(""), unescaped(plain_text("'a")), unescaped("'n Haarlem")
    ("'=1+1", '', "'a", "'n Haarlem")
    """
    return f"'{text}" if text.startswith(FORMULA) else text


def unescaped(text: str) -> str:
    """Return what `plain_text` was given."""
    return text[1:] if text.startswith("'") and text[1:].startswith(FORMULA) else text
