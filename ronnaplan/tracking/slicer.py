"""Readings kept as 3D Slicer markups: ``.mrk.json`` and the older ``.fcsv``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.tracking.recording import OK, PointReading, Recording
from ronnaplan.tracking.tables import number, read_text

LPS_FROM_RAS = np.array([-1.0, -1.0, 1.0])
FCSV_SYSTEMS = {"0": "RAS", "1": "LPS", "RAS": "RAS", "LPS": "LPS"}


def read_markups(path: Path) -> Recording:
    """Read the control points of every markup in ``path`` (``.mrk.json``), in LPS; undefined ones are flagged."""
    try:
        document = json.loads(read_text(path))
        markups = document["markups"]
        points = [point for markup in markups for point in _control_points(markup)]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path} is not a Slicer markups file ({error!r}); expected markups with controlPoints"
        ) from error
    return Recording(str(path), tuple(points))


def read_fcsv(path: Path) -> Recording:
    """Read a ``.fcsv`` fiducial list, in LPS. Raises `InputError` without its ``# columns`` and system header."""
    lines = [line.strip() for line in read_text(path).splitlines() if line.strip()]
    settings = dict(_setting(line) for line in lines if line.startswith("#") and "=" in line)
    system = FCSV_SYSTEMS.get(settings.get("CoordinateSystem", "").upper())
    columns = [name.strip() for name in settings.get("columns", "").split(",")]
    if system is None or not {"x", "y", "z"} <= set(columns):
        raise InputError(
            f"{path} lacks the header of a Slicer .fcsv; expected '# CoordinateSystem' and '# columns'"
        )
    points = []
    for line in lines:
        if line.startswith("#"):
            continue
        row = dict(zip(columns, line.split(","), strict=False))
        numbers = [number(row.get(axis, "")) for axis in "xyz"]
        points.append(_point(numbers, row.get("label", ""), system, OK))
    return Recording(str(path), tuple(points))


def _control_points(markup: dict[str, Any]) -> list[PointReading]:
    system = str(markup.get("coordinateSystem", "")).upper()
    if system not in ("LPS", "RAS"):
        raise ValueError(f"coordinateSystem is {system or 'absent'}")
    unit = markup.get("coordinateUnits", "mm")
    if unit not in ("mm", ["mm", "UCUM", "millimeter"]) and "mm" not in unit:
        raise ValueError(f"coordinateUnits are {unit}")
    points = []
    for point in markup["controlPoints"]:
        status = str(point.get("positionStatus", "defined"))
        position = point.get("position") or [None] * 3
        points.append(_point(position, str(point.get("label", "")), system, OK if status == "defined" else status))
    return points


def _point(numbers: list[float | None], label: str, system: str, status: str) -> PointReading:
    position: FloatArray = np.array([np.nan if v is None else float(v) for v in numbers], dtype=np.float64)
    if position.shape != (3,):
        raise ValueError(f"a position has {position.size} coordinates")
    if system == "RAS":
        position = position * LPS_FROM_RAS
    if status == OK and not np.isfinite(position).all():
        status = "no position"
    return PointReading(0, position, label.strip(), status=status)


def _setting(line: str) -> tuple[str, str]:
    key, _, value = line.lstrip("# ").partition("=")
    return key.strip(), value.strip()
