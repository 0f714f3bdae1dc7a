"""CSV recordings of NDI trackers (Tool Tracker and the Combined API samples), parsed by header name.

A line holds one or more tools; each has a pose (Q0 Qx Qy Qz Tx Ty Tz, with a status before and an error
behind) and its markers (State Tx Ty Tz, repeated). A pose by Euler angles (Rz Ry Rx Tx Ty Tz) keeps its place and
is not used. A header that names the marker columns once stands for as many as the lines hold. Markers of a tool
without a pose are stray markers.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.text import BLANKS
from ronnaplan.tracking.cells import (
    SEEN_COLUMNS,
    STATUS_COLUMNS,
    TRUTH_COLUMNS,
    frame_number,
    number,
    place_status,
    stated_status,
    tool_status,
)
from ronnaplan.tracking.recording import (
    NO_POSE,
    OK,
    QUATERNION,
    PointReading,
    Recording,
    ToolReading,
    quaternion_pose,
)
from ronnaplan.tracking.tables import passed_over, read_rows

ANGLES = frozenset({"rx", "ry", "rz"})
ROTATION = ANGLES.union(QUATERNION)
POSITION = ("tx", "ty", "tz")
TOOLS = ("tool", "toolinfo", "tool_id", "tool_name", "name", "port", "porthandle", "toolhandle", "tool_handle")
"""Columns that name the tool whose pose stands behind them; the nearest one behind the pose before counts."""
LABELS = ("label", "marker")
"""The same, where none of `TOOLS` stands there."""
ONE_TOOL = (*TOOLS, *LABELS)
"""Columns that name the tool of a row with one pose, where none stands before it; the first of these counts."""
TIMES = ("timespec", "timestamp", "time")
COUNTS = frozenset({"tools", "markers", "face"})
KNOWN_COLUMNS = frozenset(
    {*ROTATION, *POSITION, *TOOLS, *SEEN_COLUMNS, *TIMES, *COUNTS, "timespec_ns", "frame", "error"}
)


@dataclass(frozen=True)
class _Layout:
    """Column numbers: of each tool's pose and descriptions, and of each marker with the tool it belongs to."""

    poses: tuple[int, ...]
    """Columns of Tx."""
    names: tuple[int, ...]
    """Of each tool, the column that names it, or -1."""
    markers: tuple[tuple[int, int], ...]
    """(column of Tx, index of its tool)."""
    seen: tuple[tuple[int, ...], ...]
    """Of each tool, the columns that say how it is seen."""


def is_ndi(header: list[str]) -> bool:
    """Return whether normalized column names are those of an NDI recording."""
    posed = any(_told_by_quaternion(header, tx) for tx in _runs(header, POSITION))
    return posed or ("tx" in header and not set(STATUS_COLUMNS).isdisjoint(header))


def read_ndi(path: Path) -> Recording:
    """Read an NDI ``path``: tool poses, and every marker with its status.

    Markers that belong to a tool are labelled ``<tool>:<n>``; stray markers have no label. Raises `InputError`
    without poses or markers, and where rotations or states stand elsewhere than before the places.
    """
    header, rows, delimiter = read_rows(path)
    if not is_ndi(header):
        raise InputError(f"{path} has columns {', '.join(header[:8])}; expected NDI's Q0..Tz or State, Tx, Ty, Tz")
    layout = _layout(header)
    _require_layout(path, layout, header)
    _require_heard(path, layout, header)
    points: list[PointReading] = []
    tools: list[ToolReading] = []
    for index, row in enumerate(rows):
        _require_columns(path, layout, header, row, index)
        cells = _Row(header, row, delimiter, index, path)
        seen = [cells.tool(column, i, layout) for i, column in enumerate(layout.poses)]
        tools += seen
        for number_in_line, (column, owner) in enumerate(_markers(layout, header, row)):
            tool = seen[owner] if owner >= 0 else None
            points.append(cells.marker(column, tool, number_in_line))
    named = {header[column] for column in layout.names if column >= 0}
    notes = passed_over(header, rows, KNOWN_COLUMNS.union(named, filter(_is_heading, header)))
    return Recording(str(path), tuple(points), tuple(tools), notes=notes, numbered="frame" in header)


def _is_heading(name: str) -> bool:
    """Whether a column heads those that follow, as ``Port 1`` and ``Stray markers`` do."""
    return "stray" in name or name.startswith("port_")


@dataclass(frozen=True)
class _Row:
    header: list[str]
    cells: list[str]
    delimiter: str
    index: int
    path: Path

    def text(self, column: int) -> str:
        return self.cells[column].strip(BLANKS) if 0 <= column < len(self.cells) else ""

    def value(self, column: int) -> float:
        found = number(self.text(column), self.delimiter)
        return np.nan if found is None else found

    @property
    def frame(self) -> int:
        cell = self.text(self.header.index("frame") if "frame" in self.header else -1)
        return frame_number(self.path, cell, self.delimiter, self.index)

    @property
    def time_s(self) -> float:
        seconds = self.value(next((k for k, n in enumerate(self.header) if n in TIMES), -1))
        nanoseconds = self.value(self.header.index("timespec_ns")) if "timespec_ns" in self.header else 0.0
        return seconds + 1e-9 * nanoseconds

    def tool(self, column: int, order: int, layout: _Layout) -> ToolReading:
        name = self.text(layout.names[order])
        said = (_said(self.header[k], self.text(k)) for k in layout.seen[order])
        status = next((one for one in said if one != OK), OK)
        matrix = None
        if _told_by_quaternion(self.header, column):
            matrix = quaternion_pose(
                np.array([self.value(column + k) for k in range(-4, 0)]),
                np.array([self.value(column + k) for k in range(3)]),
            )
        elif status == OK:
            status = "a pose by Euler angles (record quaternions)"
        error = self.value(column + 3) if self.header[column + 3 : column + 4] == ["error"] else np.nan
        if matrix is None and status == OK:
            status = NO_POSE
        return ToolReading(
            self.frame,
            name or f"tool {order + 1}",
            matrix,
            self.time_s,
            float(error) if np.isfinite(error) else None,
            status,
        )

    def marker(self, column: int, tool: ToolReading | None, order: int) -> PointReading:
        position = np.array([self.value(column + k) for k in range(3)])
        status = tool_status(self.text(column - 1))
        if status == OK:
            status = place_status([self.text(column + k) for k in range(3)], position, self.delimiter)
        stray = tool is None or "stray" in tool.tool.lower()
        label = "" if stray or tool is None else f"{tool.tool}:{order + 1}"
        return PointReading(self.frame, position, label, self.time_s, None, status)


def _layout(header: list[str]) -> _Layout:
    places = _runs(header, POSITION)
    poses = [tx for tx in places if _told_by_quaternion(header, tx) or set(header[max(tx - 3, 0) : tx]) == ANGLES]
    markers = [tx for tx in places if tx not in poses]
    owners = [_owner(header, poses, start) for start in markers]
    begins = [0, *(tx + 3 for tx in poses)]
    names = tuple(_name_column(header, begins[k], tx, len(places) == 1) for k, tx in enumerate(poses))
    return _Layout(tuple(poses), names, tuple(zip(markers, owners, strict=True)), _seen(header, places, poses))


def _name_column(header: list[str], begin: int, tx: int, is_only_place: bool) -> int:
    """Return the column that names the tool whose place begins at ``tx``, or -1; those before ``begin`` name others."""
    before = range(tx - 1, begin - 1, -1)
    nearest = next((column for names in (TOOLS, LABELS) for column in before if header[column] in names), -1)
    if nearest >= 0 or not is_only_place:
        return nearest
    return next((header.index(name) for name in ONE_TOOL if name in header), -1)


def _seen(header: list[str], places: list[int], poses: list[int]) -> tuple[tuple[int, ...], ...]:
    """Return the columns that say how each tool is seen.

    They stand between the place before and its own, or are those of the tool before it; of a single tool they may stand
    behind it, too.
    """
    said = [column for column, name in enumerate(header) if name in SEEN_COLUMNS]
    if len(places) == 1:
        return (tuple(said),) * len(poses)
    found: list[tuple[int, ...]] = []
    for tx in poses:
        begin = max((place + 3 for place in places if place < tx), default=0)
        own = tuple(column for column in said if begin <= column < tx)
        found.append(own or (found[-1] if found else ()))
    return tuple(found)


def _told_by_quaternion(header: list[str], tx: int) -> bool:
    return tuple(header[max(tx - 4, 0) : tx]) == QUATERNION


def _owner(header: list[str], poses: list[int], start: int) -> int:
    """Return the index of the tool whose pose stands before the marker at ``start``; -1 for a stray marker."""
    owner = max((i for i, pose in enumerate(poses) if pose < start), default=-1)
    after = poses[owner] if owner >= 0 else 0
    return -1 if any("stray" in name for name in header[after:start]) else owner


def _require_layout(path: Path, layout: _Layout, header: list[str]) -> None:
    """Raise `InputError` for a rotation or a state that stands elsewhere: a tool would be taken for a marker.

    Angles beside quaternions tell nothing more, where all places are those of tools.
    """
    used = {column for tx in layout.poses for column in range(tx - 4, tx)}
    lost = [name for column, name in enumerate(header) if name in ROTATION and column not in used]
    if lost and not all(_told_by_quaternion(header, tx) for tx in _runs(header, POSITION)):
        raise InputError(
            f"{path} has {', '.join(lost)} of a rotation elsewhere than before a tool's tx; expected q0, qx, qy, qz, "
            "tx, ty, tz in this order"
        )
    for start, _ in layout.markers:
        before = header[start - 1] if start else "nothing"
        if before not in STATUS_COLUMNS:
            raise InputError(
                f"{path} has {before} before a tx; expected State before a marker's tx, ty, tz, or q0, qx, qy, qz "
                "before a tool's"
            )


def _require_heard(path: Path, layout: _Layout, header: list[str]) -> None:
    """Raise `InputError` for a column that may say that something was not seen, where nothing tells of what."""
    heard = {start - 1 for start, _ in layout.markers}
    if layout.seen and layout.seen[0]:  # else one between two poses may tell of either
        heard |= {column for columns in layout.seen for column in columns}
    unheard = [name for column, name in enumerate(header) if name in SEEN_COLUMNS and column not in heard]
    if unheard:
        raise InputError(
            f"{path} has {', '.join(dict.fromkeys(unheard))} elsewhere than before a tool's pose or a marker's tx; "
            "expected one State before each"
        )


def _require_columns(path: Path, layout: _Layout, header: list[str], row: list[str], index: int) -> None:
    """Raise `InputError` where a marker's state is a number, no word, or cells beyond the header are no markers'."""
    beyond = [column for column in range(len(header), len(row)) if row[column].strip()]
    first = layout.markers[-1][0] + 3 if layout.markers else 0
    named = [start - 1 for start, _ in layout.markers if 0 < start <= len(row)]
    states = [column for column in named if header[column] in STATUS_COLUMNS]
    states += [column for column in beyond if (column - first) % 4 == 0]
    if (beyond and not layout.markers) or any(number(row[column]) is not None for column in states):
        raise InputError(
            f"{path} row {index + 1} below the header has {len(row)} cells under {len(header)} columns, and no word "
            "where it should state how a marker is seen (State, Tx, Ty, Tz); numbers with a decimal comma need ';' "
            "between the columns"
        )


def _markers(layout: _Layout, header: list[str], row: list[str]) -> list[tuple[int, int]]:
    """Return the marker columns of ``row``, those beyond the header included while a line holds them."""
    found = list(layout.markers)
    if found:
        last, owner = found[-1]
        found += [(start, owner) for start in range(last + 4, len(row) - 2, 4) if start >= len(header)]
    return [(start, owner) for start, owner in found if any(cell.strip() for cell in row[start - 1 : start + 3])]


def _runs(header: list[str], names: tuple[str, ...]) -> list[int]:
    return [k for k in range(len(header)) if tuple(header[k : k + len(names)]) == names]


def _said(column: str, cell: str) -> str:
    """Return what a cell says of a tool: `OK` where it says nothing else."""
    return stated_status({column: cell}) if column in TRUTH_COLUMNS else tool_status(cell)
