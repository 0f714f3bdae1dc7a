"""Trajectories from and to other tools: 3D Slicer's line markups, and CSV tables."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ronnaplan.documents.files import TABLE_ENDINGS
from ronnaplan.documents.markups import LPS_AXES, MARKUPS_ENDINGS, SCHEMA
from ronnaplan.documents.reading import plain_json
from ronnaplan.errors import InputError
from ronnaplan.geometry import LPS_FROM_RAS, FloatArray, Frame
from ronnaplan.planning.electrodes import electrode_named
from ronnaplan.planning.plan import Plan
from ronnaplan.planning.trajectory import Instrument, Trajectory, instrument_named
from ronnaplan.text import BLANKS
from ronnaplan.tracking.cells import number, plain_text, unescaped
from ronnaplan.tracking.slicer import LINE, Markup, read_markups_file
from ronnaplan.tracking.tables import read_rows, require_table

SYSTEMS = ("LPS", "RAS")

CSV_HEADER = (
    *("name", "entry_x", "entry_y", "entry_z", "target_x", "target_y", "target_z"),
    *("instrument", "diameter_mm", "length_mm", "colour", "locked", "notes", "coordinate_system"),
    *("frame_of_reference_uid", "electrode"),
)
CONTACTS_HEADER = (
    *("name", "electrode", "contact", "x", "y", "z", "depth_mm", "coordinate_system", "frame_of_reference_uid"),
)
NEEDED = CSV_HEADER[:7]
ENDINGS = {"markups": MARKUPS_ENDINGS, "csv": TABLE_ENDINGS, "contacts": TABLE_ENDINGS}
"""What files must be called where the program that reads them goes by the name."""
POINTS_ENDING = ".fcsv"
"""Slicer's older lists of points, of which none holds a line."""

LOCKED = {"": False, "no": False, "false": False, "0": False, "yes": True, "true": True, "1": True}


def to_lps(points_mm: FloatArray, system: str) -> FloatArray:
    """Return points (..., 3) of ``system`` ("LPS" or "RAS") in LPS, or back; raises `InputError` for another."""
    if system not in SYSTEMS:
        raise InputError(f"the coordinate system is {system!r}; expected LPS or RAS")
    return points_mm * LPS_FROM_RAS if system == "RAS" else points_mm


def line_markups(plan: Plan) -> str:
    """Express the trajectories as Slicer line markups (JSON text, LPS): entry first, then target, so labelled.

    Raises `InputError` where there is none.
    """
    plan.require_trajectories()  # without any neither Slicer nor `plan import` would read it
    lines = [_line(trajectory) for trajectory in plan.trajectories]
    return plain_json({"@schema": SCHEMA, "markups": lines})


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
    ``target`` are taken as such; for other labels ``first`` must say what the first point is, for tools differ. A line
    without a name, as Slicer writes them, is called as the file, as Slicer calls it when it reads that.
    Raises `InputError`.
    """
    lines = [markup for markup in read_markups_file(Path(path)) if markup.type == LINE]
    if not lines:
        raise InputError(f"{os.fspath(path)} holds no line; export the trajectories as line markups")
    return [_from_line(line, line.name or _named(path), frame, instrument, system, first) for line in lines]


def _named(path: str | os.PathLike[str]) -> str:
    """Return a file's name without its ending."""
    name = Path(path).name
    ending = next((one for one in MARKUPS_ENDINGS if name.lower().endswith(one)), "")
    return name[: len(name) - len(ending)]


def plan_table(plan: Plan) -> str:
    """Write the trajectories as CSV, one row each, LPS mm; raises `InputError` where there is none."""
    plan.require_trajectories()  # without any neither Slicer nor `plan import` would read it
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
                plain_text(one.electrode.name if one.electrode else ""),
            ]
        )
    return stream.getvalue()


def contacts_table(plan: Plan) -> str:
    """Write the contacts of the plan's electrodes as CSV, the deepest first: middles in LPS mm, depths from entries.

    Raises `InputError` where no trajectory has an electrode.
    """
    if all(one.electrode is None for one in plan.trajectories):
        raise InputError("no trajectory of the plan has an electrode; choose one, as by 'plan edit --electrode'")
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(CONTACTS_HEADER)
    for one in plan.trajectories:
        if one.electrode is None:
            continue
        depths = one.length_mm - one.electrode.from_tip_mm
        for contact, (place, depth) in enumerate(zip(one.contacts_mm, depths, strict=True), start=1):
            where = [f"{value:.6f}" for value in (*place, depth)]
            named = (plain_text(one.name), plain_text(one.electrode.name), contact)
            writer.writerow([*named, *where, "LPS", plain_text(plan.frame.uid or "")])
    return stream.getvalue()


def read_plan_table(
    path: str | os.PathLike[str], frame: Frame, instrument: Instrument, *, system: str | None = None
) -> list[Trajectory]:
    """Read trajectories from CSV with the columns `NEEDED`; the others are optional.

    The column ``coordinate_system`` or ``system`` says whether the numbers are LPS or RAS; neither, both unlike,
    or another frame of reference is refused (`InputError`, `FrameMismatchError`).
    """
    if Path(path).suffix.lower() == POINTS_ENDING:
        raise InputError(
            f"{os.fspath(path)} is a list of points, which does not say which of them make a trajectory; save lines in "
            "Slicer (.mrk.json), or write a table (CSV)"
        )
    header, rows, delimiter = read_rows(Path(path))
    require_table(Path(path), header, rows)
    if not rows:
        raise InputError(f"{os.fspath(path)} holds no trajectory; expected a header and rows")
    missing = [column for column in NEEDED if column not in header]
    if missing:
        raise InputError(f"{os.fspath(path)} lacks the columns {', '.join(missing)}; expected {', '.join(NEEDED)}")
    found = []
    for line, cells in enumerate(rows, start=2):
        row = {name: cell.strip(BLANKS) for name, cell in zip(header, cells, strict=False)}
        found.append(_from_row(row, delimiter, f"{os.fspath(path)} line {line}", frame, instrument, system))
    return found


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
        "type": LINE,
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
    line: Markup, name: str, frame: Frame, instrument: Instrument, system: str | None, first: str | None
) -> Trajectory:
    are_set = [point.position and point.positionStatus == "defined" for point in line.controlPoints]
    if len(are_set) != 2 or not all(are_set):
        raise InputError(f"the line {name} has not two points that are set; expected its entry and its target")
    if system not in (None, line.coordinateSystem):
        raise InputError(
            f"the line {name} is in {line.coordinateSystem} but {system} was asked for; leave it to the file"
        )
    labels = [point.label.strip().lower() for point in line.controlPoints]
    if sorted(labels) == ["entry", "target"]:
        target = labels.index("target")
    elif first is not None:
        target = 0 if first == "target" else 1
    else:
        raise InputError(
            f"the points of line {name} are not labelled entry and target; state which of them comes first "
            "(--first entry, or --first target)"
        )
    shade = line.display.selectedColor
    colour = "#" + "".join(f"{round(255 * part):02x}" for part in shade) if shade else ""
    entry_mm, target_mm = line.positions_mm[1 - target], line.positions_mm[target]
    return Trajectory(name, entry_mm, target_mm, frame, instrument, colour, line.locked)


def _from_row(
    row: dict[str, str], delimiter: str, place: str, frame: Frame, instrument: Instrument, system: str | None
) -> Trajectory:
    stated = (row.get("coordinate_system") or system or "").upper()
    if not stated or system not in (None, stated):
        said = f"says {stated} but {system} was asked for" if stated else "does not say whether it is LPS or RAS"
        raise InputError(f"{place} {said}; state the coordinate system (--coordinates LPS, or RAS)")
    uid = unescaped(row.get("frame_of_reference_uid", ""))
    if uid:
        frame.require(Frame("CT", uid))

    def value(column: str) -> float:
        found = number(row.get(column, ""), delimiter)
        if found is None:
            raise InputError(f"{place} holds no number under {column}; expected mm")
        return found

    places = np.array([value(column) for column in NEEDED[1:]]).reshape(2, 3)
    has_diameter, has_length = (bool(row.get(column)) for column in ("diameter", "length"))
    if has_diameter != has_length:
        raise InputError(f"{place} states only one of an instrument's diameter and length; state both, or neither")
    if has_diameter:
        name = unescaped(row.get("instrument", "")) or "instrument"
        instrument = Instrument(name, value("diameter"), value("length"))
    elif row.get("instrument"):
        instrument = instrument_named(unescaped(row["instrument"]))
    locked = row.get("locked", "").lower()
    if locked not in LOCKED:
        raise InputError(f"{place} says '{locked}' under locked; expected yes or no")
    entry, target = to_lps(places, stated)
    return Trajectory(
        unescaped(row["name"]),
        entry,
        target,
        frame,
        instrument,
        row.get("colour") or "",
        LOCKED[locked],
        unescaped(row.get("notes", "")),
        electrode_named(unescaped(row["electrode"])) if row.get("electrode") else None,
    )
