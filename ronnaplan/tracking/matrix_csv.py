"""Tables whose rows hold 4 x 4 matrices, tracker from tool: columns m00 to m33 (or m11 to m44), by row and column."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from ronnaplan.tracking.cells import (
    NO_NUMBER,
    SEEN_COLUMNS,
    frame_number,
    number,
    stated_status,
)
from ronnaplan.tracking.recording import OK, Recording, Roundings, tool_reading
from ronnaplan.tracking.tables import passed_over, read_rows, require_table

FIRSTS = (0, 1)
"""Rows and columns are counted from either; which one is told by the first column's name."""
MOST_LACKING = 6
"""A table that lacks no more of a matrix's twelve columns was meant to hold one."""
TOOL_NAMES = ("tool", "tool_name", "label", "name")
SECONDS = {"time": 1.0, "time_ns": 1e-9, "timestamp_ns": 1e-9}


def has_matrices(header: list[str]) -> bool:
    """Return whether normalized column names are those of a matrix in each row; its last row may be left out."""
    return any(set(_names(first)[:12]) <= set(header) for first in FIRSTS)


def lacking(header: list[str]) -> list[str]:
    """Return the columns of a matrix that a table with most of them has not; none where it has but few."""
    without = min(([name for name in _names(first)[:12] if name not in header] for first in FIRSTS), key=len)
    return without if len(without) <= MOST_LACKING else []


def read_matrices(path: Path) -> Recording:
    """Read a pose from each row of ``path``; what is no pose is kept, flagged.

    Optional columns are ``tool`` (else all are of one), ``frame`` (else each tool's poses are counted), ``time`` (s) or
    ``timestamp_ns``. Raises `InputError` for two columns of one name or rows longer than the header.
    """
    header, rows, delimiter = read_rows(path)
    require_table(path, header, rows)
    names = next(_names(first) for first in FIRSTS if set(_names(first)[:12]) <= set(header))
    table = [dict(zip(header, row, strict=False)) for row in rows]
    numbered = any(number(cells.get("frame", ""), delimiter) is not None for cells in table)
    tools, roundings = [], Roundings()
    counts: Counter[str] = Counter()
    for cells in table:
        values = [number(cells.get(name, ""), delimiter) for name in names]
        last = [0.0, 0.0, 0.0, 1.0] if names[12] not in header else values[12:]
        matrix = np.array([*values[:12], *last], dtype=np.float64).reshape(4, 4)
        tool = next((cells[name].strip() for name in TOOL_NAMES if cells.get(name, "").strip()), "tool")
        times = [number(cells[name], delimiter) for name in SECONDS if name in cells]
        scale = next((SECONDS[name] for name in SECONDS if name in cells), 1.0)
        time_s = scale * times[0] if times and times[0] is not None else float("nan")
        frame = frame_number(path, cells.get("frame", ""), delimiter, counts[tool])
        reading, excess = tool_reading(frame, tool, matrix, time_s, stated_status(cells))
        if numbered and reading.status == OK and number(cells.get("frame", ""), delimiter) is None:
            reading = replace(reading, status=NO_NUMBER)
        tools.append(reading)
        counts[tool] += 1
        roundings.add(excess)
    known = {*names, *TOOL_NAMES, *SECONDS, *SEEN_COLUMNS, "frame"}
    notes = (*roundings.notes, *passed_over(header, rows, known))
    return Recording(str(path), tools=tuple(tools), notes=notes, numbered=numbered)


def _names(first: int) -> list[str]:
    return [f"m{row}{column}" for row in range(first, first + 4) for column in range(first, first + 4)]
