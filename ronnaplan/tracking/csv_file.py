"""Readings as CSV with a header: x, y, z, and optionally label, frame, time, sigma, status and a quaternion."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import FloatArray, Frame
from ronnaplan.tracking.recording import (
    FARTHEST_MM,
    OK,
    OTS,
    PointReading,
    Recording,
    ToolReading,
    quaternion_pose,
)
from ronnaplan.tracking.tables import MISSING, number, read_rows

LABEL_NAMES = ("label", "name", "marker", "id")
QUATERNION_NAMES = ("q0", "qx", "qy", "qz")
COLUMNS = ("frame", "time_s", "label", "x", "y", "z", "q0", "qx", "qy", "qz", "sigma", "status")


def read_csv(path: Path) -> Recording:
    """Read ``path``; columns are found by name, in any order, with ``,``, ``;`` or tab between them.

    ``frame`` is the tracker's frame number; words there name the coordinate frame, which must be one for all rows
    (`FrameMismatchError`). A row with q0, qx, qy, qz is a tool's pose. Rows without a position are kept, flagged.
    Raises `InputError` for a file without a header or without x, y, z, with two columns of one name, or with a
    row longer than the header.
    """
    header, rows, delimiter = read_rows(path)
    missing = [axis for axis in "xyz" if axis not in header]
    if missing:
        raise InputError(
            f"{path} has columns {', '.join(header)} but no {', '.join(missing)}; expected x, y, z in mm"
        )
    _require_table(path, header, rows)
    cells = [dict(zip(header, row, strict=False)) for row in rows]
    frame = _coordinate_frame(path, cells)
    points: list[PointReading] = []
    tools: list[ToolReading] = []
    for row in cells:
        reading = _reading(row, delimiter)
        if isinstance(reading, ToolReading):
            tools.append(reading)
        else:
            points.append(reading)
    return Recording(str(path), tuple(points), tuple(tools), frame)


def write_csv(recording: Recording) -> str:
    """Return ``recording`` as CSV text that `read_csv` reads back with nothing lost."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for point in recording.points:
        start = [point.frame, _cell(point.time_s), point.label, *map(_cell, point.position_mm)]
        table.writerow([*start, "", "", "", "", _cell(point.sigma_mm), point.status])
    for tool in recording.tools:
        table.writerow([tool.frame, _cell(tool.time_s), tool.tool, *_pose_cells(tool.matrix), "", tool.status])
    return text.getvalue()


def _require_table(path: Path, header: list[str], rows: list[list[str]]) -> None:
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


def _reading(row: Mapping[str, str], delimiter: str) -> PointReading | ToolReading:
    def value(name: str) -> float:
        found = number(row.get(name, ""), delimiter)
        return np.nan if found is None else found

    position = np.array([value(axis) for axis in "xyz"])
    label = next((row[name].strip() for name in LABEL_NAMES if row.get(name, "").strip()), "")
    status = row.get("status", "").strip().lower() or OK
    if status == OK and not np.isfinite(position).all():
        status = "no position"
    frame = value("frame")
    index = int(frame) if np.isfinite(frame) else 0
    quaternion = np.array([value(name) for name in QUATERNION_NAMES])
    if set(QUATERNION_NAMES) <= row.keys() and (np.isfinite(quaternion).any() or status == "no pose"):
        matrix = quaternion_pose(quaternion, position)
        return ToolReading(
            index, label, matrix, value("time"), None, "no pose" if matrix is None and status == OK else status
        )
    sigma = number(row.get("sigma", ""), delimiter)
    if status == OK and sigma is not None and not 0 < sigma < FARTHEST_MM:
        status = f"sigma is {sigma:g} mm"
    return PointReading(index, position, label, value("time"), sigma, status)


def _coordinate_frame(path: Path, cells: list[dict[str, str]]) -> Frame:
    named = {row["frame"].strip() for row in cells if "frame" in row and number(row["frame"]) is None}
    named = {name for name in named if name.lower() not in MISSING}
    if len(named) > 1:
        raise FrameMismatchError(
            f"{path} mixes readings of the frames {', '.join(sorted(named))}; expected one frame"
        )
    return Frame(named.pop()) if named else OTS


def _cell(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else repr(float(value))


def _pose_cells(matrix: FloatArray | None) -> list[str]:
    if matrix is None:
        return [""] * 7
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(matrix[:3, :3]).as_quat(scalar_first=True)
    return [_cell(v) for v in (*matrix[:3, 3], *quaternion)]
