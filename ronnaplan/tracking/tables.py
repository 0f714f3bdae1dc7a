"""Text tables with a header: delimiter found, column names normalized, numbers parsed, nothing guessed."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Sequence, Set
from pathlib import Path
from unicodedata import normalize

from ronnaplan.errors import InputError
from ronnaplan.text import BLANKS, printable
from ronnaplan.tracking.cells import SEEN_COLUMNS, number
from ronnaplan.tracking.columns import (
    AXES,
    OF_A_READING,
    SAME_COLUMNS,
    bare_name,
    column_name,
    length_columns,
    place_columns,
)
from ronnaplan.tracking.units import LONGEST_NAME, held, of_units, require_units
from ronnaplan.untrusted import read_whole

DELIMITERS = (",", ";", "\t")
SEPARATOR_LINE = re.compile(r'\s*"?sep=(?P<delimiter>[^\r\n])"?[ ,;\t]*\r*(\n|$)', re.IGNORECASE)
"""By which a first line tells a spreadsheet what stands between the columns."""
MOST_TEXT_BYTES = 2**27
MOST_LINES_BEFORE = 50
"""Among so many lines one may name the columns; what motion capture writes before it are 7."""
MOST_NAMED = 12
"""Of the columns that are not read, how many are told."""
MOST_ROWS = 500_000
"""Seven hours of a tracker's frames at 20 Hz; a file with more rows or bytes would take the memory."""
GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
"""A number that is one of thousands, if its sign stands between these."""


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

    So is a first row that holds units. Raises `InputError` for a file without a header, for lengths not in mm or times
    not in s, stated in the header, in that first row or in a column of units, for lengths of which some have a
    comma and some a point, and for coordinates whose signs may stand between thousands.
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
    lines = text.lstrip().split("\n", MOST_LINES_BEFORE)[:MOST_LINES_BEFORE]
    parted = next((line for line in lines if any(sign in line for sign in DELIMITERS)), "")
    delimiter = told["delimiter"] if told else max(DELIMITERS, key=parted.count)
    _require_first(path, lines)
    rows = split_rows(path, text, delimiter)
    if not rows:
        raise InputError(f"{path} is empty; expected a header and tracker readings")
    _require_delimiter(path, rows[-1], delimiter)
    rows[0] = [normalize("NFKC", cell) for cell in rows[0]]  # letters and brackets as wide as Chinese ones
    header = [column_name(cell) for cell in rows[0]]
    _require_own_tools(path, rows[0], header)
    if any(number(cell, delimiter) is not None for cell in rows[0]):
        raise InputError(
            f"{path} has no header; its first line must name the columns, such as label,x,y,z, and each row below hold "
            "one reading"
        )
    below = require_units(path, rows[0], header, rows[1:])
    if delimiter != ",":
        _require_one_sign(path, length_columns(header), below, delimiter)
        _require_no_thousands(path, place_columns(header), below, delimiter)
    return header, below, delimiter


def _require_first(path: Path, lines: Sequence[str]) -> None:
    """Refuse ``lines`` of which a later one names the axes: what programs write before it may hold a unit."""
    names = ({column_name(cell.strip(' "')).split("_")[0] for cell in re.split("[,;\t]", line)} for line in lines)
    found = next((k for k, words in enumerate(names) if any(axes <= words for axes in AXES)), 0)
    if found:
        raise InputError(
            f"{path} names its columns in a later line ({printable(lines[found].strip(), LONGEST_NAME)}); expected "
            "them in the first, so look in those before it for the unit (mm), and delete them"
        )


def _require_own_tools(path: Path, cells: Sequence[str], header: Sequence[str]) -> None:
    """Refuse columns that say by its number of which tool they tell, unless each stands before that tool's pose."""
    found = {k: OF_A_READING.fullmatch(bare_name(cell)) for k, cell in enumerate(cells)}
    tools = {k: int(one["tool"]) for k, one in found.items() if one and one["tool"]}
    poses = header.count("q0")
    if not tools or (poses < 2 and len(set(tools.values())) < 2):
        return
    before = {k: header[:k].count("q0") for k in tools}
    first = min(1, *tools.values())
    if set(before.values()) != set(range(poses)) or any(tools[k] - first != before[k] for k in tools):
        told = ", ".join(printable(cells[k].strip(), LONGEST_NAME) for k in list(tools)[:MOST_NAMED])
        raise InputError(
            f"{path} has {told}, not each right before the pose of its own tool; expected tool_1_status before the "
            "first pose of a row, tool_2_status before the second and so on"
        )


def _require_delimiter(path: Path, row: list[str], delimiter: str) -> None:
    """Refuse a ``row`` of numbers with blanks between, as other programs save points, with a name or without."""
    numbers = [word for word in row[0].split() if number(word, delimiter) is not None]
    if len(row) == 1 and len(numbers) > 2:
        raise InputError(
            f"{path} separates its columns by blanks; expected a comma, ';' or a tab, and a first line that names "
            "them, such as x,y,z"
        )


def split_rows(path: Path, text: str, delimiter: str) -> list[list[str]]:
    """Return the cells of each line that is not blank; raises `InputError` for what no table holds."""
    rows = []
    try:
        # StringIO splits at line feeds alone, str.splitlines also at U+2028 and the like, inside a label
        for row in csv.reader(io.StringIO(text, newline="\n"), delimiter=delimiter):
            if any(map(str.strip, row)):
                rows.append(row)
            if len(rows) > MOST_ROWS:
                raise InputError(f"{path} has more than {MOST_ROWS} rows; split the recording")
    except csv.Error as error:
        raise InputError(f"{path} is not a readable table ({error}); expected CSV with a header") from error
    return rows


def require_table(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Raise `InputError` unless every cell belongs to one column, found by its name."""
    twice = sorted({name for name in header if name and header.count(name) > 1})
    if twice:
        others = {name: f" (or tool_{name})" for name in SEEN_COLUMNS}
        others |= {name: f" (or {other})" for other, name in SAME_COLUMNS.items()}
        told = ", ".join(f"{name}{others.get(name, '')}" for name in twice)
        rows_of = ", and a row for each reading (frame, label, x, y, z)" if set(twice) & {"x", "y", "z"} else ""
        raise InputError(f"{path} has more than one column named {told}; expected each name once{rows_of}")
    for place, row in enumerate(rows, start=1):
        if any(cell.strip() for cell in row[len(header) :]):
            raise InputError(
                f"{path} row {place} below the header has {len(row)} cells under {len(header)} columns; "
                "numbers with a decimal comma need ';' between the columns"
            )


def passed_over(header: Sequence[str], rows: Sequence[Sequence[str]], known: Set[str]) -> tuple[str, ...]:
    """Return a sentence that names the columns that hold something and are not ``known``, where there are any."""
    read = of_units(header, rows)
    names = [name for k, name in enumerate(header) if name not in known and k not in read and any(held(rows, k))]
    if not names:
        return ()
    shown = ", ".join(printable(name or "one without a name", LONGEST_NAME) for name in names[:MOST_NAMED])
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return (f"columns that are not read: {shown}{more}",)


def _require_one_sign(path: Path, lengths: Sequence[int], rows: list[list[str]], delimiter: str) -> None:
    """Raise `InputError` where lengths have points and commas: commas are decimal then, or separate thousands."""

    def first(sign: str) -> str:
        cells = (row[k] for k in lengths for row in rows if k < len(row) and sign in row[k])
        return next((cell.strip() for cell in cells if number(cell, delimiter) is not None), "")

    comma, point = first(","), first(".")
    if comma and point:
        raise InputError(
            f"{path} holds the numbers {comma} and {point}; expected a comma or a point in all of them, for a comma "
            "that separates thousands would be taken for a decimal one"
        )


def _require_no_thousands(path: Path, places: Sequence[int], rows: list[list[str]], delimiter: str) -> None:
    """Raise `InputError` where whole coordinates may have signs between thousands: -1.294 beside 187.

    A sign that is decimal has another number of digits behind it now and then, or a zero or four digits before it.
    """
    written = [row[k] for k in places for row in rows if k < len(row)]
    bare = (cell.strip() for cell in written if "." not in cell and "," not in cell)
    whole = {cell: value for cell in bare if (value := number(cell))}  # zero has no sign to lose
    if not whole or not all(abs(value) < 1000.0 for value in whole.values()):
        return
    signs = (cell.strip(BLANKS) for cell in written if "." in cell or "," in cell)
    signed = [cell for cell in signs if number(cell, delimiter) is not None]
    if signed and all(map(GROUPED.fullmatch, signed)):
        thousands = signed[0].replace(".", "").replace(",", "")
        raise InputError(
            f"{path} holds the coordinates {signed[0]} and {next(iter(whole))}, so that the first may be {thousands}; "
            "expected as many decimals in all of them, and no sign between thousands"
        )
