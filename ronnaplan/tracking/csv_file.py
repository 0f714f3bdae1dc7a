"""Readings as CSV with a header: x, y, z, and optionally kind, label, frame, time, sigma, status and a quaternion."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from pathlib import Path

import numpy as np

from ronnaplan.bounds import LARGEST_SIGMA_MM, SMALLEST_SIGMA_MM
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import FloatArray, Frame
from ronnaplan.text import BLANKS, printable
from ronnaplan.tracking.cells import (
    MISSING,
    NO_NUMBER,
    SEEN_COLUMNS,
    frame_number,
    number,
    place_status,
    plain_text,
    stated_status,
    unescaped,
)
from ronnaplan.tracking.columns import POINT_NAMES, SYSTEM_COLUMNS, TOOL_NAMES
from ronnaplan.tracking.matrix_csv import lacking
from ronnaplan.tracking.recording import (
    NO_POSE,
    OK,
    OTS,
    QUATERNION,
    PointReading,
    Recording,
    ToolReading,
    quaternion_pose,
)
from ronnaplan.tracking.tables import passed_over, read_rows, require_table

KINDS = ("point", "tool")
NOT_STATED = MISSING - {"nan"}
"""Cells that state no error. NaN does: what was to estimate it failed."""
COLUMNS = (
    *("kind", "frame", "time_s", "label", "x", "y", "z"),
    *(*QUATERNION, "sigma", "error_mm", "status"),
)
KNOWN_COLUMNS = frozenset(
    {
        *("kind", "frame", "time", "x", "y", "z", "sigma", "error"),
        *(*QUATERNION, *POINT_NAMES, *SYSTEM_COLUMNS, *SEEN_COLUMNS),
    }
)
OF_POSES = {"error"}
"""Columns that say something of a tool's pose alone."""
LONGEST_FRAME_NAME = 64
MOST_SHOWN = 5
MOST_COLUMNS = 16


def read_csv(path: Path) -> Recording:
    """Read ``path``; columns are found by name, in any order, with ``,``, ``;`` or tab between them.

    ``frame`` is the tracker's frame number; words there name the coordinate frame, which must be one for all rows
    (`FrameMismatchError`). ``kind`` says whether a row is a point or a tool's pose; without it, a row with any of q0,
    qx, qy, qz is a pose, and so is each row with the label of one. Without ``frame`` all points are of one frame, and
    each tool's poses are counted. Rows without a position are kept, flagged. Raises `InputError` for a file without a
    header or without x, y, z, with a part of a quaternion, with two columns of one name, with a row longer than the
    header, or with a frame number that is not whole.
    """
    header, rows, delimiter = read_rows(path)
    _require_columns(path, header)
    require_table(path, header, rows)
    cells = [dict(zip(header, row, strict=False)) for row in rows]
    frame = _coordinate_frame(path, cells, delimiter)
    poses = {_name(row, TOOL_NAMES) for row in cells if any(row.get(name, "").strip() for name in QUATERNION)} - {
        ""
    }
    numbered = any(number(row.get("frame", ""), delimiter) is not None for row in cells)
    points: list[PointReading] = []
    tools: list[ToolReading] = []
    counts: Counter[str] = Counter()
    for row in cells:
        reading = _reading(path, row, delimiter, poses)
        if isinstance(reading, PointReading):
            points.append(reading)
            continue
        if not numbered:
            reading = replace(reading, frame=counts[reading.tool])
        elif reading.status == OK and number(row.get("frame", ""), delimiter) is None:
            reading = replace(reading, status=NO_NUMBER)
        tools.append(reading)
        counts[reading.tool] += 1
    notes = passed_over(header, rows, KNOWN_COLUMNS.union(TOOL_NAMES) if tools else KNOWN_COLUMNS - OF_POSES)
    return Recording(str(path), tuple(points), tuple(tools), frame, notes, numbered=numbered)


def _require_columns(path: Path, header: list[str]) -> None:
    """Raise `InputError` without a place, with a part of a quaternion, and with errors that differ by axis."""
    missing = [axis for axis in "xyz" if axis not in header]
    if missing:
        of_matrix = lacking(header)
        of_place = "a first line with x, y, z (mm) or m00 to m33, and one reading in each row below"
        expected = "all of a matrix, row by row" if of_matrix else of_place
        raise InputError(
            f"{path} has columns {', '.join(header[:MOST_COLUMNS])} but no {', '.join(of_matrix or missing)}; "
            f"expected {expected}"
        )
    parts = [name for name in QUATERNION if name in header]
    if parts and len(parts) < len(QUATERNION):
        raise InputError(
            f"{path} has {', '.join(parts)} of a quaternion; expected all of {', '.join(QUATERNION)}, q0 (or qw) "
            "its scalar"
        )
    unknown = [name for name in header if name.startswith("sigma") and name != "sigma"]
    if unknown:
        raise InputError(
            f"{path} has columns {', '.join(unknown)}; expected one sigma, the same for each axis, in mm"
        )


def write_csv(recording: Recording) -> str:
    """Return ``recording`` as CSV text that `read_csv` reads back with nothing lost."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for point in recording.points:
        start = [
            "point",
            point.frame,
            _cell(point.time_s),
            plain_text(point.label),
            *map(_cell, point.position_mm),
        ]
        table.writerow([*start, "", "", "", "", _cell(point.sigma_mm), "", plain_text(point.status)])
    for tool in recording.tools:
        start = ["tool", tool.frame, _cell(tool.time_s), plain_text(tool.tool), *_pose_cells(tool.matrix)]
        table.writerow([*start, "", _cell(tool.error_mm), plain_text(tool.status)])
    return text.getvalue()


def _reading(path: Path, row: Mapping[str, str], delimiter: str, poses: Set[str]) -> PointReading | ToolReading:
    """Return the reading of a row; ``poses`` are the labels whose rows are a tool's."""

    def value(name: str) -> float:
        found = number(row.get(name, ""), delimiter)
        return np.nan if found is None else found

    position = np.array([value(axis) for axis in "xyz"])
    tool = _name(row, TOOL_NAMES)
    status = stated_status(row)
    cell = row.get("frame", "")
    index = 0 if number(cell, delimiter) is None else frame_number(path, cell, delimiter, 0)
    kind = row.get("kind", "").strip().lower()
    if kind not in ("", *KINDS):
        raise InputError(f"{path} has a row of the kind '{kind}'; expected {' or '.join(KINDS)}")
    if kind == "tool" or (not kind and (tool in poses or any(row.get(k, "").strip() for k in QUATERNION))):
        matrix = quaternion_pose(np.array([value(name) for name in QUATERNION]), position)
        error_mm = number(row.get("error", ""), delimiter)
        if matrix is None and status == OK:
            status = NO_POSE
        return ToolReading(index, tool, matrix, value("time"), error_mm, status)
    if status == OK:
        status = place_status([row.get(axis, "") for axis in "xyz"], position, delimiter)
    written = row.get("sigma", "").strip(BLANKS)
    sigma = number(written, delimiter)
    if (
        status == OK
        and written.lower() not in NOT_STATED
        and not SMALLEST_SIGMA_MM <= (sigma or 0.0) < LARGEST_SIGMA_MM
    ):
        status = f"sigma is '{printable(written, 40)}' mm"
    label = _name(row, POINT_NAMES)
    return PointReading(index, position, label, value("time"), sigma, status)


def _name(row: Mapping[str, str], columns: Sequence[str]) -> str:
    return next((unescaped(row[name].strip()) for name in columns if row.get(name, "").strip()), "")


def _coordinate_frame(path: Path, cells: list[dict[str, str]], delimiter: str) -> Frame:
    texts = {row["frame"].strip() for row in cells if "frame" in row}
    told = {text for text in texts if text.lower() not in MISSING}
    named = {text for text in told if number(text, delimiter) is None}
    mixed = named if len(named) > 1 else told if named and told - named else set()
    stated = {row.get(name, "").strip() for row in cells for name in SYSTEM_COLUMNS}
    systems = {text for text in stated if text.lower() not in MISSING}
    mixed = mixed or (systems if len(systems) > 1 else set())
    if mixed:
        shown = ", ".join(printable(name, LONGEST_FRAME_NAME) for name in sorted(mixed)[:MOST_SHOWN])
        raise FrameMismatchError(f"{path} mixes readings of the frames {shown}; expected one frame")
    expected = "a whole number or a name" if named else "a name, such as RAS"
    named = named or systems
    for name in named:
        if not (name[0].isalpha() and name.isprintable() and len(name) <= LONGEST_FRAME_NAME):
            raise InputError(f"{path} has the frame '{printable(name, LONGEST_FRAME_NAME)}'; expected {expected}")
    return Frame(named.pop()) if named else OTS


def _cell(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else repr(float(value))


def _pose_cells(matrix: FloatArray | None) -> list[str]:
    if matrix is None:
        return [""] * 7
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(matrix[:3, :3]).as_quat(scalar_first=True)
    return [_cell(v) for v in (*matrix[:3, 3], *quaternion)]
