"""Trajectories from and to other tools: 3D Slicer's line markups, and CSV tables."""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ronnaplan.documents.files import read_json
from ronnaplan.documents.markups import LPS_AXES, SCHEMA
from ronnaplan.documents.table import plain_text
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, Frame
from ronnaplan.planning.plan import Plan
from ronnaplan.planning.trajectory import Instrument, Trajectory, instrument_named

LPS_FROM_RAS = np.array([-1.0, -1.0, 1.0])
"""RAS and LPS differ in the sign of the first two axes, either way."""

SYSTEMS = ("LPS", "RAS")

CSV_HEADER = (
    *("name", "entry_x", "entry_y", "entry_z", "target_x", "target_y", "target_z"),
    *("instrument", "diameter_mm", "length_mm", "colour", "locked", "notes", "coordinate_system"),
    "frame_of_reference_uid",
)
NEEDED = CSV_HEADER[:7]


def to_lps(points_mm: FloatArray, system: str) -> FloatArray:
    """Return points (..., 3) of ``system`` ("LPS" or "RAS") in LPS, or back; raises `InputError` for another."""
    if system not in SYSTEMS:
        raise InputError(f"the coordinate system is {system!r}; expected LPS or RAS")
    return points_mm * LPS_FROM_RAS if system == "RAS" else points_mm


def line_markups(plan: Plan) -> str:
    """Express the trajectories as Slicer line markups (JSON text, LPS): entry first, then target, so labelled."""
    lines = [_line(trajectory) for trajectory in plan.trajectories]
    return json.dumps({"@schema": SCHEMA, "markups": lines}, indent=2) + "\n"


def read_line_markups(
    path: str | os.PathLike[str],
    frame: Frame,
    instrument: Instrument,
    *,
    system: str | None = None,
    first: Literal["entry", "target"] | None = None,
) -> list[Trajectory]:
    """Read the lines of a Slicer markups file (.mrk.json).

    The file itself says LPS or RAS; a ``system`` that says otherwise is refused. Points labelled ``entry`` and
    ``target`` are taken as such; for other labels ``first`` must say what the first point is, for tools differ.
    Raises `InputError`.
    """
    content = read_json(path)
    try:
        lines = [markup for markup in content["markups"] if markup["type"] == "Line"]
        found = [_from_line(line, frame, instrument, system, first) for line in lines]
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(f"{os.fspath(path)} does not hold Slicer line markups ({error!r})") from error
    if not found:
        raise InputError(f"{os.fspath(path)} holds no line; export the trajectories as line markups")
    return found


def plan_table(plan: Plan) -> str:
    """Write the trajectories as CSV, one row each, LPS mm."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(CSV_HEADER)
    for one in plan.trajectories:
        places = [f"{value:.6f}" for value in (*one.entry_mm, *one.target_mm)]
        instrument = one.instrument
        writer.writerow(
            [
                plain_text(one.name),
                *places,
                plain_text(instrument.name),
                f"{instrument.diameter_mm:g}",
                f"{instrument.length_mm:g}",
                one.colour,
                "yes" if one.locked else "no",
                plain_text(one.notes),
                "LPS",
                plain_text(plan.frame.uid or ""),
            ]
        )
    return stream.getvalue()


def read_plan_table(
    path: str | os.PathLike[str], frame: Frame, instrument: Instrument, *, system: str | None = None
) -> list[Trajectory]:
    """Read trajectories from CSV with the columns `NEEDED`; the others are optional.

    The column ``coordinate_system`` or ``system`` says whether the numbers are LPS or RAS; neither, both unlike,
    or another frame of reference is refused (`InputError`, `FrameMismatchError`).
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read {os.fspath(path)} as text ({error}); give a CSV file") from error
    rows = list(csv.DictReader(io.StringIO(text)))
    if not rows:
        raise InputError(f"{os.fspath(path)} holds no trajectory; expected a header and rows")
    missing = [column for column in NEEDED if column not in rows[0]]
    if missing:
        raise InputError(f"{os.fspath(path)} lacks the columns {', '.join(missing)}; expected {', '.join(NEEDED)}")
    return [_from_row(row, number, path, frame, instrument, system) for number, row in enumerate(rows, start=2)]


def _line(trajectory: Trajectory) -> dict[str, Any]:
    points = [
        {
            "id": str(number),
            "label": label,
            "description": "",
            "associatedNodeID": "",
            "position": [float(value) for value in place],
            "orientation": LPS_AXES,
            "selected": True,
            "locked": trajectory.locked,
            "visibility": True,
            "positionStatus": "defined",
        }
        for number, (label, place) in enumerate(
            (("entry", trajectory.entry_mm), ("target", trajectory.target_mm)), start=1
        )
    ]
    shade = [int(trajectory.colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    return {
        "type": "Line",
        "name": trajectory.name,
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": trajectory.locked,
        "fixedNumberOfControlPoints": False,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": 2,
        "controlPoints": points,
        "display": {"visibility": True, "color": shade, "selectedColor": shade},
    }


def _from_line(
    line: dict[str, Any], frame: Frame, instrument: Instrument, system: str | None, first: str | None
) -> Trajectory:
    name, points = str(line.get("name") or "line"), line["controlPoints"]
    if len(points) != 2:
        raise ValueError(f"the line {name} has {len(points)} points, expected 2")
    stated = str(line.get("coordinateSystem", "absent")).upper()
    if system not in (None, stated):
        raise InputError(f"the line {name} is in {stated} but {system} was asked for; leave it to the file")
    labels = [str(point.get("label", "")).strip().lower() for point in points]
    if sorted(labels) == ["entry", "target"]:
        target = labels.index("target")
    elif first is not None:
        target = 0 if first == "target" else 1
    else:
        raise InputError(
            f"the points of line {name} are not labelled entry and target; state which of them comes first"
        )
    places = to_lps(np.array([point["position"] for point in points], dtype=np.float64), stated)
    colour = line.get("display", {}).get("selectedColor")
    options = {"colour": "#" + "".join(f"{round(255 * float(part)):02x}" for part in colour)} if colour else {}
    return Trajectory(
        name,
        places[1 - target],
        places[target],
        frame,
        instrument,
        locked=bool(line.get("locked", False)),
        **options,
    )


def _from_row(
    row: dict[str, str], number: int, path: Any, frame: Frame, instrument: Instrument, system: str | None
) -> Trajectory:
    stated = (row.get("coordinate_system") or system or "").strip().upper()
    if not stated or system not in (None, stated):
        said = f"says {stated} but {system} was asked for" if stated else "does not say whether it is LPS or RAS"
        raise InputError(f"{os.fspath(path)} line {number} {said}; state the coordinate system")
    uid = (row.get("frame_of_reference_uid") or "").strip().lstrip("'")
    if uid:
        frame.require(Frame("CT", uid))
    try:
        numbers = np.array([float(row[column]) for column in NEEDED[1:]]).reshape(2, 3)
        if row.get("diameter_mm") and row.get("length_mm"):
            name = (row.get("instrument") or "instrument").lstrip("'")
            instrument = Instrument(name, float(row["diameter_mm"]), float(row["length_mm"]))
        elif row.get("instrument"):
            instrument = instrument_named(row["instrument"])
    except (TypeError, ValueError) as error:
        raise InputError(f"{os.fspath(path)} line {number} holds something that is no number ({error})") from error
    entry, target = to_lps(numbers, stated)
    options = {"colour": row["colour"]} if row.get("colour") else {}
    return Trajectory(
        row["name"].lstrip("'"),
        entry,
        target,
        frame,
        instrument,
        locked=(row.get("locked") or "").strip().lower() in ("yes", "true", "1"),
        notes=(row.get("notes") or "").lstrip("'"),
        **options,
    )
