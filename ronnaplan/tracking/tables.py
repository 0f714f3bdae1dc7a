"""Text tables with a header: delimiter found, column names normalized, numbers parsed, nothing guessed."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Sequence, Set
from pathlib import Path

from ronnaplan.errors import InputError
from ronnaplan.text import printable
from ronnaplan.tracking.cells import MISSING, SEEN_COLUMNS, number
from ronnaplan.untrusted import read_whole

DELIMITERS = (",", ";", "\t")
SEPARATOR_LINE = re.compile(r'\s*"?sep=(?P<delimiter>[^\r\n])"?[ ,;\t]*\r*(\n|$)', re.IGNORECASE)
"""By which a first line tells a spreadsheet what stands between the columns."""
MOST_TEXT_BYTES = 2**27
MOST_NAMED, LONGEST_NAME = 12, 40
"""Of the columns that are not read, how many are told, and how much of a name."""
MOST_ROWS = 500_000
"""Seven hours of a tracker's frames at 20 Hz; a file with more rows or bytes would take the memory."""
LENGTHS = frozenset({"sigma", "error", "entry", "target", "diameter", "length"})
"""Columns that are lengths in mm, by the first word of their name, beside those of places (`AXES`)."""
UNIT_WORDS = frozenset({"unit", "units"})
MILLIMETRES = frozenset({"mm", "millimeter", "millimeters", "millimetre", "millimetres"})
SECONDS = frozenset({"s", "sec", "secs", "second", "seconds"})
UNIT = re.compile(r"[\[(]?([munµμcd]?m|in|inch|inches|(milli|micro|centi)?met(er|re)s?)[\])]?", re.IGNORECASE)
"""A cell that holds a unit of length in the place of a number."""
POINT_NAMES = ("label", "name", "marker", "id")
TOOL_NAMES = ("label", "name", "marker", "tool", "tool_name", "id")
"""Columns that name what a row tells of; the first one that it fills counts."""
SYSTEM_COLUMNS = ("coordinate_system", "coordinates")
OF_WORDS = frozenset({"kind", "frame", "notes", "description", *TOOL_NAMES, *SYSTEM_COLUMNS, *SEEN_COLUMNS})
"""Columns of words, of which none is a unit: a frame may be called M."""
SAME_COLUMNS = {"qw": "q0", "frame_number": "frame"}
OF_A_READING = re.compile(
    rf"(((tool|pose)(_?(?P<tool>\d+))?|(marker|point)(_?\d+)?)_)?(is_?)?(?P<said>{'|'.join(sorted(SEEN_COLUMNS))})"
)
"""What columns are called, too, that say whether a reading counts: ``tool_1_status``, ``is_valid``."""
AXES = (
    *(frozenset(names) for names in (("x", "y", "z"), ("tx", "ty", "tz"), ("l", "p", "s"), ("r", "a", "s"))),
    *(frozenset(names) for names in (("m03", "m13", "m23"), ("m14", "m24", "m34"))),
)
"""What columns of places are called, by the first word of their name."""


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
    not in s, stated in the header, in that first row or in a column of units, and for lengths of which some have a
    comma and some a point.
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
    delimiter = told["delimiter"] if told else max(DELIMITERS, key=text.lstrip().partition("\n")[0].count)
    rows = split_rows(path, text, delimiter)
    if not rows:
        raise InputError(f"{path} is empty; expected a header and tracker readings")
    _require_delimiter(path, rows[-1], delimiter)
    header = [column_name(cell) for cell in rows[0]]
    _require_own_tools(path, rows[0], header)
    if any(number(cell, delimiter) is not None for cell in rows[0]):
        raise InputError(
            f"{path} has no header; its first line must name the columns, such as label,x,y,z, and each row below hold "
            "one reading"
        )
    lengths = _lengths(header)
    for k in lengths:
        _require_unit(path, rows[0][k], "mm", MILLIMETRES)
    times = [k for k, name in enumerate(header) if name.split("_")[0] == "time"]
    for k in times:
        _require_unit(path, rows[0][k], "s", SECONDS)
    below = _below_units(path, header, rows[1:], lengths, times)
    _require_mm(path, header, below)
    _require_one_sign(path, lengths, below, delimiter)
    return header, below, delimiter


def _require_own_tools(path: Path, cells: Sequence[str], header: Sequence[str]) -> None:
    """Refuse columns that say by its number of which tool they tell, unless each stands before that tool's pose."""
    found = {k: OF_A_READING.fullmatch(_bare(cell)) for k, cell in enumerate(cells)}
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


def _lengths(header: Sequence[str]) -> list[int]:
    """Return the columns that are lengths in mm, by the first word of their name."""
    names = [name.split("_")[0] for name in header]
    lengths = LENGTHS.union(*(axes for axes in AXES if axes <= set(names)))
    return [k for k, name in enumerate(names) if name in lengths]


def _require_delimiter(path: Path, row: list[str], delimiter: str) -> None:
    """Refuse a ``row`` of numbers with blanks between, as other programs save points, with a name or without."""
    numbers = [word for word in row[0].split() if number(word, delimiter) is not None]
    if len(row) == 1 and len(numbers) > 2:
        raise InputError(
            f"{path} separates its columns by blanks; expected a comma, ';' or a tab, and a first line that names "
            "them, such as x,y,z"
        )


def _below_units(
    path: Path, header: list[str], rows: list[list[str]], lengths: Sequence[int], times: Sequence[int]
) -> list[list[str]]:
    """Return ``rows`` without a first one that holds the columns' units, as motion capture writes; judges these."""
    stated = {k: cell.strip() for k, cell in enumerate(rows[0] if rows else []) if cell.strip()}
    units = [stated[k] for k in lengths if k in stated]
    if not units or not all(map(UNIT.fullmatch, units)):
        return rows
    for columns, expected, names in ((lengths, "mm", MILLIMETRES), (times, "s", SECONDS)):
        for k in stated.keys() & columns:
            _require_unit(path, f"{header[k]} [{stated[k].strip('[]()')}]", expected, names)
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
        others = {name: f" (or tool_{name})" for name in SEEN_COLUMNS}
        others |= {name: f" (or {other})" for other, name in SAME_COLUMNS.items()}
        told = ", ".join(f"{name}{others.get(name, '')}" for name in twice)
        raise InputError(f"{path} has more than one column named {told}; expected each name once")
    for place, row in enumerate(rows, start=1):
        if any(cell.strip() for cell in row[len(header) :]):
            raise InputError(
                f"{path} row {place} below the header has {len(row)} cells under {len(header)} columns; "
                "numbers with a decimal comma need ';' between the columns"
            )


def passed_over(header: Sequence[str], rows: Sequence[Sequence[str]], known: Set[str]) -> tuple[str, ...]:
    """Return a sentence that names the columns that hold something and are not ``known``, where there are any."""
    read = _of_units(header, rows)
    names = [name for k, name in enumerate(header) if name not in known and k not in read and any(_held(rows, k))]
    if not names:
        return ()
    shown = ", ".join(printable(name or "one without a name", LONGEST_NAME) for name in names[:MOST_NAMED])
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return (f"columns that are not read: {shown}{more}",)


def _require_unit(path: Path, cell: str, expected: str, names: Set[str]) -> None:
    """Raise `InputError` for a column's name with a unit that is not ``expected``, by any of its ``names``."""
    stated = re.search(r"[\[(](.*?)[\])]", cell) or re.search(
        r"[_ ]([munµμcd]?m|in|inch|inches)$", cell.strip().lower()
    )
    if stated and stated[1].strip().lower() not in names:
        raise InputError(
            f"{path} has the column '{cell.strip()}'; expected it in {expected}, so convert the numbers and rename it"
        )


def _require_mm(path: Path, header: list[str], rows: list[list[str]]) -> None:
    """Raise `InputError` where a column says for its row that lengths are not in mm.

    It is called ``unit``, ``length_unit`` ..., or, as in other languages, otherwise, and holds nothing but units.
    """
    for column in sorted(k for k in _of_units(header, rows) if "time" not in header[k]):
        for place, row in enumerate(rows, start=1):
            stated = row[column].strip() if column < len(row) else ""
            if stated.lower() not in MISSING | MILLIMETRES:
                raise InputError(
                    f"{path} row {place} below the header says its unit is '{printable(stated)}' (column "
                    f"'{printable(header[column], LONGEST_NAME)}'); expected mm, so convert the numbers"
                )


def _of_units(header: Sequence[str], rows: Sequence[Sequence[str]]) -> set[int]:
    """Return the columns that are called units, or in which each cell that is not empty is a unit of length."""
    called = {k for k, name in enumerate(header) if UNIT_WORDS & set(name.split("_"))}
    others = (k for k, name in enumerate(header) if name not in OF_WORDS and any(_held(rows, k)))
    return called.union(k for k in others if all(map(_is_unit, _held(rows, k))))


def _is_unit(cell: str) -> bool:
    return cell != "M" and UNIT.fullmatch(cell) is not None  # M stands for marker, male, missing ...


def _held(rows: Sequence[Sequence[str]], column: int) -> Iterator[str]:
    """Yield the cells of a column that are not empty."""
    return (cell for row in rows if column < len(row) and (cell := row[column].strip()))


def _require_one_sign(path: Path, lengths: Sequence[int], rows: list[list[str]], delimiter: str) -> None:
    """Raise `InputError` where lengths have points and commas: commas are decimal then, or separate thousands."""
    if delimiter == ",":
        return

    def first(sign: str) -> str:
        cells = (cell for k in lengths for cell in _held(rows, k) if sign in cell)
        return next((cell for cell in cells if number(cell, delimiter) is not None), "")

    comma, point = first(","), first(".")
    if comma and point:
        raise InputError(
            f"{path} holds the numbers {comma} and {point}; expected a comma or a point in all of them, for a comma "
            "that separates thousands would be taken for a decimal one"
        )


def column_name(cell: str) -> str:
    """Return ``cell`` lower-case, without ``#``, unit or brackets: ``"#Tx [mm]"`` becomes ``"tx"``.

    >>> column_name(" X (mm)"), column_name("Frame#"), column_name("sigma_mm"), column_name("time_s")
    ('x', 'frame', 'sigma', 'time')

    A quaternion's scalar, and a frame's number, have two names that mean the same: ``"qw"`` becomes ``"q0"``, and
    ``"Frame Number"`` ``"frame"``. What says whether a reading counts has several.

    >>> column_name("tool_1_status"), column_name("isVisible"), column_name("system_status")
    ('status', 'visible', 'system_status')
    """
    name = _bare(cell)
    of_a_reading = OF_A_READING.fullmatch(name)
    return of_a_reading["said"] if of_a_reading else SAME_COLUMNS.get(name, name)


def _bare(cell: str) -> str:
    bare = re.sub(r"[\[(].*?[\])]", "", cell).replace("#", "").strip().lower()
    return re.sub(r"_(mm|s)$", "", bare.replace(" ", "_")).strip("_")
