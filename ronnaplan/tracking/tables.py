"""Text tables with a header: delimiter found, column names normalized, numbers parsed, nothing guessed."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.text import BLANKS, plain_number, printable
from ronnaplan.tracking.recording import OK
from ronnaplan.untrusted import read_whole

DELIMITERS = (",", ";", "\t")
SEPARATOR_LINE = re.compile(r'\s*"?sep=(?P<delimiter>[^\r\n])"?[ ,;\t]*\r*(\n|$)', re.IGNORECASE)
"""By which a first line tells a spreadsheet what stands between the columns."""
MOST_TEXT_BYTES = 2**27
MOST_ROWS = 500_000
"""Seven hours of a tracker's frames at 20 Hz; a file with more rows or bytes would take the memory."""
LENGTHS = frozenset(
    {
        *("x", "y", "z", "tx", "ty", "tz", "m03", "m13", "m23", "m14", "m24", "m34"),
        *("sigma", "error", "entry", "target", "diameter", "length"),
    }
)
"""Columns that are lengths in mm, by the first word of their name."""
MOST_FRAMES = 2**53 - 1
"""Beyond, a number that is read as a float may be a neighbour of the one that is written."""
MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "missing", "-"})
NO_POSITION = "no position"
NO_PLAIN_NUMBER = "a coordinate that is no plain number, such as -1234.5"
"""Statuses of a reading without a place: one that is not written, and one that is written otherwise."""
NO_NUMBER = "no frame number"
"""Status of a pose of no numbered frame among numbered ones: it would be taken for another frame's."""
UNIT_WORDS = frozenset({"unit", "units"})
MILLIMETRES = frozenset({"mm", "millimeter", "millimeters", "millimetre", "millimetres"})
UNIT = re.compile(r"[\[(]?([munµμcd]?m|in|inch|inches|(milli|micro|centi)?met(er|re)s?)[\])]?", re.IGNORECASE)
"""A cell that holds a unit of length in the place of a number."""
STATUS_COLUMNS = ("status", "state")
TRUTH_COLUMNS = ("valid", "visible", "seen", "usable")
AXES = (
    *(frozenset(names) for names in (("x", "y", "z"), ("tx", "ty", "tz"), ("l", "p", "s"), ("r", "a", "s"))),
    *(frozenset(names) for names in (("m03", "m13", "m23"), ("m14", "m24", "m34"))),
)
"""What columns of places are called, by the first word of their name."""
TRUE = frozenset({"true", "yes", "y", "t", "ok"})
FALSE = frozenset({"0", "false", "no", "n", "f"})
FORMULA = ("=", "+", "-", "@", "\t", "\r", "'")
"""A spreadsheet takes a text that begins so for a formula, or swallows its first character."""


def read_text(path: Path) -> str:
    """Return the text of ``path`` (UTF-8, or UTF-16 with its byte order mark).

    Raises `InputError` for a file that is missing, unreadable, too large or not text.
    """
    content = read_whole(path, MOST_TEXT_BYTES, expected="a text file of tracker readings")
    marks = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    try:
        text = content.decode("utf-16" if content.startswith(marks) else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path} is not a text file in UTF-8, nor in UTF-16 with its mark; expected tracker readings, save them as "
            "'CSV UTF-8'"
        ) from error
    if "\0" in text:
        raise InputError(f"{path} is not a text file, it holds null characters; expected tracker readings")
    return text if "\n" in text else text.replace("\r", "\n")  # as spreadsheets save "CSV (Macintosh)"


def seems_table(beginning: bytes) -> bool:
    """Whether a text's first row names two axes, or holds the numbers of a place: a header may be wrong or missing."""
    marks = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    text = beginning.decode("utf-16" if beginning.startswith(marks) else "utf-8-sig", errors="replace")
    told = SEPARATOR_LINE.match(text)
    row = re.match(r"\s*([^\r\n]*)", text[told.end() if told else 0 :])
    cells = re.split("[,;\t]", row[1] if row else "")
    names = {column_name(cell.strip(' "')).split("_")[0] for cell in cells}
    numbers = sum(number(cell.strip(' "')) is not None for cell in cells)
    return numbers >= 3 or any(len(axes & names) >= 2 for axes in AXES)


def read_rows(path: Path) -> tuple[list[str], list[list[str]], str]:
    """Return the header's normalized names, the rows below it and the delimiter. Blank lines are left out.

    So is a first row that holds units. Raises `InputError` for a file without a header, for two columns of one name
    that hold lengths, and for lengths not in mm or times not in s, stated in the header, in that first row or in a
    column ``unit``.
    """
    text = read_text(path)
    told = SEPARATOR_LINE.match(text)
    if told is not None:
        text = text[told.end() :]
        if told["delimiter"] not in DELIMITERS:
            raise InputError(
                f"{path} separates its columns by '{printable(told['delimiter'])}', as its first line says; "
                "expected a comma, ';' or a tab"
            )
    if not text.strip():
        raise InputError(f"{path} is empty; expected a header and tracker readings")
    delimiter = told["delimiter"] if told else max(DELIMITERS, key=text.lstrip().partition("\n")[0].count)
    rows = split_rows(path, text, delimiter)
    header = [column_name(cell) for cell in rows[0]]
    if any(number(cell, delimiter) is not None for cell in rows[0]):
        raise InputError(
            f"{path} has no header; its first line must name the columns, such as label,x,y,z, and each row below hold "
            "one reading"
        )
    for cell, name in zip(rows[0], header, strict=True):
        _require_unit(path, cell, name)
    below = _below_units(path, header, rows[1:])
    _require_mm(path, header, below)
    return header, below, delimiter


def _below_units(path: Path, header: list[str], rows: list[list[str]]) -> list[list[str]]:
    """Return ``rows`` without a first one that holds the columns' units, as motion capture writes; judges these."""
    lengths = [
        (name, cell.strip())
        for name, cell in zip(header, rows[0] if rows else [], strict=False)
        if name.split("_")[0] in LENGTHS and cell.strip()
    ]
    if not lengths or not all(UNIT.fullmatch(cell) for _, cell in lengths):
        return rows
    for name, cell in lengths:
        _require_unit(path, f"{name} [{cell.strip('[]()')}]", name)
    return rows[1:]


def split_rows(path: Path, text: str, delimiter: str) -> list[list[str]]:
    """Return the cells of each line that is not blank; raises `InputError` for what no table holds."""
    rows = []
    try:
        for row in csv.reader(_lines(text), delimiter=delimiter):
            if any(cell.strip() for cell in row):
                rows.append(row)
            if len(rows) > MOST_ROWS:
                raise InputError(f"{path} has more than {MOST_ROWS} rows; split the recording")
    except csv.Error as error:
        raise InputError(f"{path} is not a readable table ({error}); expected CSV with a header") from error
    return rows


def _lines(text: str) -> Iterator[str]:
    # str.splitlines would also split at U+2028 and the like, inside a label
    start = 0
    while start < len(text):
        end = text.find("\n", start) + 1 or len(text)
        yield text[start:end]
        start = end


def require_table(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Raise `InputError` unless every cell belongs to one column, found by its name."""
    twice = sorted({name for name in header if name and header.count(name) > 1})
    if twice:
        raise InputError(f"{path} has more than one column named {', '.join(twice)}; expected each name once")
    for place, row in enumerate(rows, start=1):
        if any(cell.strip() for cell in row[len(header) :]):
            raise InputError(
                f"{path} row {place} below the header has {len(row)} cells under {len(header)} columns; "
                "numbers with a decimal comma need ';' between the columns"
            )


def _require_unit(path: Path, cell: str, name: str) -> None:
    """Raise `InputError` for a length that is not in mm or a time that is not in s."""
    quantity = name.split("_")[0]
    expected = "mm" if quantity in LENGTHS else "s" if quantity == "time" else None
    stated = re.search(r"[\[(](.*?)[\])]", cell) or re.search(
        r"[_ ]([munµμcd]?m|in|inch|inches)$", cell.strip().lower()
    )
    if expected and stated and stated[1].strip().lower() not in (MILLIMETRES if expected == "mm" else {expected}):
        raise InputError(
            f"{path} has the column '{cell.strip()}'; expected it in {expected}, so convert the numbers and rename it"
        )


def _require_mm(path: Path, header: list[str], rows: list[list[str]]) -> None:
    """Raise `InputError` where a column (``unit``, ``length_unit`` ...) says for its row that lengths are not in mm."""
    for column in (k for k, name in enumerate(header) if UNIT_WORDS & set(name.split("_")) and "time" not in name):
        for place, row in enumerate(rows, start=1):
            stated = row[column].strip() if column < len(row) else ""
            if stated.lower() not in MISSING | MILLIMETRES:
                raise InputError(
                    f"{path} row {place} below the header says its unit is '{printable(stated)}'; "
                    "expected mm, so convert the numbers"
                )


def column_name(cell: str) -> str:
    """Return ``cell`` lower-case, without ``#``, unit or brackets: ``"#Tx [mm]"`` becomes ``"tx"``.

    >>> column_name(" X (mm)"), column_name("Frame#"), column_name("sigma_mm"), column_name("time_s")
    ('x', 'frame', 'sigma', 'time')

    A quaternion's scalar has two names that mean the same: ``"qw"`` becomes ``"q0"``.
    """
    bare = re.sub(r"[\[(].*?[\])]", "", cell).replace("#", "").strip().lower()
    name = re.sub(r"_(mm|s)$", "", bare.replace(" ", "_")).strip("_")
    return "q0" if name == "qw" else name


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
    odd = any(cell.strip(BLANKS).lower() not in MISSING and number(cell, delimiter) is None for cell in cells)
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
    >>> stated_status({"valid": "0.0"}), stated_status({"visible": "FALSCH"}), stated_status({"visible": "4"})
    ('not valid', "visible is 'falsch', neither yes nor no", 'ok')
    """
    said = [unescaped(row[name].strip()).lower() for name in STATUS_COLUMNS if row.get(name, "").strip()]
    said += [
        _said_of_truth(name, row[name].strip().lower()) for name in TRUTH_COLUMNS if row.get(name, "").strip()
    ]
    return next((status for status in said if status != OK), OK)


def _said_of_truth(name: str, word: str) -> str:
    """Return what ``word``, not empty, in a column of truth values says; other numbers count what was seen."""
    count = number(word)
    if word in FALSE or count == 0.0:
        return f"not {name}"
    if word in TRUE or (count is not None and count > 0.0):
        return OK
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
