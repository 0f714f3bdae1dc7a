"""A registration for other tools: Slicer markups whose colour and description tell the residual, and CSV."""

from __future__ import annotations

import csv
import io
from typing import Any

from ronnaplan.documents.markups import LPS_AXES, SCHEMA
from ronnaplan.documents.reading import plain_json
from ronnaplan.documents.registration import PairEntry, RegistrationDocument
from ronnaplan.tracking.cells import plain_text

RESIDUAL_COLOURS = ((0.5, "residuals below 0.5 mm", [0.1, 0.7, 0.2]), (1.0, "0.5 to 1 mm", [0.95, 0.75, 0.1]))
"""Upper end (mm), words and colour (RGB) of a residual; longer ones are `LONG_RESIDUAL`."""
LONG_RESIDUAL = ("above 1 mm", [0.9, 0.15, 0.1])
"""Slicer colours a whole point list, not a point: one list is written for each band of residuals."""
PAIR_COLUMNS = ("ct", "ots", "residual", "leave_one_out", *("ct_x", "ct_y", "ct_z"), *("ots_x", "ots_y", "ots_z"))


def registration_markups(document: RegistrationDocument) -> str:
    """Return the paired CT markers as Slicer markups (JSON text, LPS), one list for each colour.

    Raises `InputError` for a registration that was refused.
    """
    document.require_unique()
    bands: dict[str, tuple[list[float], list[PairEntry]]] = {}
    for pair in document.pairs:
        words, colour = _band(pair.residual)
        bands.setdefault(words, (colour, []))[1].append(pair)
    markups = [_list(words, colour, pairs) for words, (colour, pairs) in bands.items()]
    return plain_json({"@schema": SCHEMA, "markups": markups})


def registration_csv(document: RegistrationDocument) -> str:
    """Return the pairs as CSV: labels, residuals, places in CT (LPS) and in the tracker's frame, mm.

    Raises `InputError` for a registration that was refused.
    """
    document.require_unique()
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(PAIR_COLUMNS)
    for pair in document.pairs:
        out = "" if pair.leave_one_out is None else f"{pair.leave_one_out:.6f}"
        places = [f"{value:.6f}" for value in (*pair.center, *pair.reading)]
        table.writerow([plain_text(pair.ct), plain_text(pair.ots), f"{pair.residual:.6f}", out, *places])
    return text.getvalue()


def _band(residual: float) -> tuple[str, list[float]]:
    return next(((words, colour) for limit, words, colour in RESIDUAL_COLOURS if residual < limit), LONG_RESIDUAL)


def _list(words: str, colour: list[float], pairs: list[PairEntry]) -> dict[str, Any]:
    return {
        "type": "Fiducial",
        "name": f"registered markers, {words}",
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": True,
        "controlPoints": [_point(number, pair) for number, pair in enumerate(pairs, start=1)],
        "display": {"visibility": True, "color": colour, "selectedColor": colour},
    }


def _point(number: int, pair: PairEntry) -> dict[str, Any]:
    out = "" if pair.leave_one_out is None else f", {pair.leave_one_out:.2f} mm from what the others predict"
    return {
        "id": str(number),
        "label": pair.ct,
        "description": f"reading {pair.ots}: residual {pair.residual:.2f} mm{out}",
        "associatedNodeID": "",
        "position": list(pair.center),
        "orientation": LPS_AXES,
        "selected": True,
        "locked": True,
        "visibility": True,
        "positionStatus": "defined",
    }
