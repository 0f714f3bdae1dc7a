"""Readings kept as 3D Slicer markups: ``.mrk.json``, the older ``.fcsv``, and tables of control points."""

from __future__ import annotations

import math
import re
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ronnaplan.errors import InputError
from ronnaplan.geometry import LPS_FROM_RAS, FloatArray, Frame
from ronnaplan.text import printable
from ronnaplan.tracking.cells import FALSE, number
from ronnaplan.tracking.recording import NO_POSITION, OK, PointReading, Recording
from ronnaplan.tracking.tables import read_rows, read_text, require_table, split_rows
from ronnaplan.untrusted import checked, parse_json, read_whole

SLICER = Frame("LPS")
"""The frame of what Slicer saves. A tracker that streams to it is taken to tell RAS, so that this is not the tracker's:
x and y have the other sign than in the tracker's own poses."""
FCSV_SYSTEMS = {"0": "RAS", "1": "LPS", "RAS": "RAS", "LPS": "LPS"}
FCSV_LAST = "associatedNodeID"
FCSV_UNNAMED = ("position status", "auto created")
"""What Slicer 5 writes behind the last column that the header of a ``.fcsv`` names."""
FCSV_STATUS = {"0": "undefined", "1": "preview", "2": OK, "3": "missing"}
TABLE_AXES = {"LPS": ("l", "p", "s"), "RAS": ("r", "a", "s")}
"""The columns of a table of control points, which name its coordinates."""
LINE = "Line"
"""The type of a markup that tells a path, as trajectories go to and from Slicer: two ends, not what a tracker read."""
LISTS = ("Fiducial", "")
"""Types of markups whose points are places by themselves."""
OTHERS = {
    LINE: "lines",
    "Curve": "curves",
    "ClosedCurve": "curves",
    "Plane": "planes",
    "Angle": "angles",
    "ROI": "boxes",
}
UNKNOWN = "markups of other types"
"""What the others are called."""
MOST_MARKUPS_BYTES = 2**26
OWN_BYTES, OWN_FORMAT = 200, re.compile(rb'"format"\s*:\s*"(ronnaplan\.\w+)"')
"""How documents of this program begin."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]


class ControlPoint(BaseModel):
    """A point of a markup, as far as it is used here."""

    model_config = ConfigDict(frozen=True)
    label: str = ""
    position: tuple[Finite, Finite, Finite] | tuple[()] | None = None
    positionStatus: str = "defined"  # noqa: N815 - Slicer's name


class Display(BaseModel):
    """How a markup is shown."""

    model_config = ConfigDict(frozen=True)
    selectedColor: tuple[Share, Share, Share] | None = None  # noqa: N815


class Markup(BaseModel):
    """A list of points or a line, as far as it is used here; what else Slicer writes is passed over."""

    model_config = ConfigDict(frozen=True)
    type: str = ""
    name: str = ""
    coordinateSystem: Literal["LPS", "RAS"]  # noqa: N815
    coordinateUnits: Literal["mm"] | tuple[Literal["mm"], Literal["UCUM"], str] = "mm"  # noqa: N815
    locked: bool = False
    controlPoints: tuple[ControlPoint, ...]  # noqa: N815
    display: Display = Display()

    @property
    def positions_mm(self) -> FloatArray:
        """The points (N, 3) in LPS; NaN for one that is not set."""
        given = [point.position or [math.nan] * 3 for point in self.controlPoints]
        positions: FloatArray = np.array(given, dtype=np.float64).reshape(-1, 3)
        return positions * LPS_FROM_RAS if self.coordinateSystem == "RAS" else positions


class MarkupsFile(BaseModel):
    """The whole of a ``.mrk.json``."""

    model_config = ConfigDict(frozen=True)
    markups: tuple[Markup, ...]


def read_markups_file(path: Path) -> tuple[Markup, ...]:
    """Return every markup of ``path`` (``.mrk.json``); raises `InputError` naming what is wrong."""
    content = read_whole(path, MOST_MARKUPS_BYTES, expected="a Slicer markups file")
    try:
        return checked(parse_json(content), MarkupsFile).markups
    except ValueError as error:
        own = OWN_FORMAT.search(content[:OWN_BYTES])
        if own:
            raise InputError(
                f"{path} is a document of this program ({own[1].decode()}); expected what another one wrote, such as "
                "Slicer's markups"
            ) from error
        raise InputError(
            f"{path} is not a Slicer markups file ({error}); expected markups with controlPoints, in mm, LPS or RAS"
        ) from error


def seems_markups(beginning: bytes) -> bool:
    """Whether a JSON text begins as a ``.mrk.json`` does: with a list of markups of which the first is no line."""
    found = re.search(rb'"markups"\s*:\s*\[', beginning)
    first = re.search(rb'"type"\s*:\s*"(\w*)"', beginning[found.end() :]) if found else None
    return found is not None and (first is None or first[1] != LINE.encode())


def read_markups(path: Path) -> Recording:
    """Read the control points of the markups in ``path`` (``.mrk.json``), in LPS; undefined ones are flagged.

    Lines are left out, with a note, as what no tracker read: their ends are those of paths. So are planes, curves,
    angles and boxes, which their points only span. Raises `InputError` for such alone.
    """
    markups = read_markups_file(path)
    lists = [markup for markup in markups if markup.type in LISTS]
    others = Counter(OTHERS.get(markup.type, UNKNOWN) for markup in markups if markup.type not in LISTS)
    if others and not lists:
        raise InputError(f"{path} holds {' and '.join(others)} alone; expected a list of points")
    points = [
        _point(position_mm, point.label, OK if point.positionStatus == "defined" else point.positionStatus)
        for markup in lists
        for point, position_mm in zip(markup.controlPoints, markup.positions_mm, strict=True)
    ]
    notes = (f"{kind} that are not read: {count}" for kind, count in others.items())
    return Recording(str(path), tuple(points), frame=SLICER, notes=tuple(notes))


def read_fcsv(path: Path) -> Recording:
    """Read a ``.fcsv`` fiducial list, in LPS; points that are not set are flagged.

    Raises `InputError` without its ``# columns`` and system header.
    """
    text = read_text(path).replace("\r", "")  # Slicer 5 leaves some of a file's earlier line ends within the rows
    rows = split_rows(path, text, ",")
    comments = [",".join(row).lstrip("# ") for row in rows if row[0].startswith("#")]
    settings = [_setting(text) for text in comments if "=" in text]
    named = dict(settings)
    told = named.get("CoordinateSystem", "")
    system = FCSV_SYSTEMS.get(told.upper())
    columns = [name.strip() for name in named.get("columns", "").split(",")]
    if not told or not {"x", "y", "z"} <= set(columns) or len(settings) > len(named):
        raise InputError(
            f"{path} lacks the header of a Slicer .fcsv; expected '# CoordinateSystem' and '# columns', each once"
        )
    if system is None:
        raise InputError(
            f"{path} says CoordinateSystem = {printable(told)}; expected RAS or LPS (0 or 1), so save it as one of them"
        )
    data = [row for row in rows if not row[0].startswith("#")]
    if columns[-1] == FCSV_LAST and any(len(row) == len(columns) + len(FCSV_UNNAMED) for row in data):
        columns += FCSV_UNNAMED
    require_table(path, columns, data)
    sign = LPS_FROM_RAS if system == "RAS" else 1.0
    points = []
    for cells in data:
        row = dict(zip(columns, cells, strict=False))
        position = np.array([number(row.get(axis, "")) for axis in "xyz"], dtype=np.float64)
        points.append(_point(sign * position, row.get("label", ""), _fcsv_status(row.get(FCSV_UNNAMED[0], ""))))
    return Recording(str(path), tuple(points), frame=SLICER)


def has_control_points(header: list[str]) -> bool:
    """Return whether normalized column names are those of Slicer's table of control points, and not x, y and z."""
    return not {"x", "y", "z"} <= set(header) and any(set(axes) <= set(header) for axes in TABLE_AXES.values())


def read_control_points(path: Path) -> Recording:
    """Read a table of control points as Slicer exports it (``label,l,p,s,defined...``), in LPS; undefined are flagged.

    Raises `InputError` for two columns of one name or rows longer than the header.
    """
    header, rows, delimiter = read_rows(path)
    require_table(path, header, rows)
    system = next(system for system, axes in TABLE_AXES.items() if set(axes) <= set(header))
    sign = LPS_FROM_RAS if system == "RAS" else 1.0
    points = []
    for cells in rows:
        row = dict(zip(header, cells, strict=False))
        position = np.array(
            [number(row.get(axis, ""), delimiter) for axis in TABLE_AXES[system]], dtype=np.float64
        )
        status = "undefined" if row.get("defined", "").strip().lower() in FALSE else OK
        points.append(_point(sign * position, row.get("label", ""), status))
    return Recording(str(path), tuple(points), frame=SLICER)


def _fcsv_status(cell: str) -> str:
    code = cell.strip()
    return FCSV_STATUS.get(code, f"{FCSV_UNNAMED[0]} {code}") if code else OK


def _point(position_mm: FloatArray, label: str, status: str) -> PointReading:
    if status == OK and not np.isfinite(position_mm).all():
        status = NO_POSITION
    return PointReading(0, position_mm, label.strip(), status=status)


def _setting(text: str) -> tuple[str, str]:
    key, _, value = text.partition("=")
    return key.strip(), value.strip()
