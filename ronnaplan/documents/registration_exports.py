"""A registration for other tools: Slicer markups whose colour and description tell the residual, CSV, and .tfm.

A transform file (.tfm) is ITK's, with 3D Slicer's conventions. ITK works in LPS and its transforms map points of the
*fixed* (output) space to the *moving* one; Slicer, reading a .tfm, takes it as "from parent". A file that should move
CT data into the tracker's space in Slicer therefore holds ``ct_from_ots``, the inverse of what is applied to points.
See Slicer's documentation, "Transforms: file formats".
"""

from __future__ import annotations

import csv
import io
from typing import Any

from ronnaplan.documents.markups import LPS_AXES, SCHEMA
from ronnaplan.documents.reading import plain_json
from ronnaplan.documents.registration import PairEntry, RegistrationDocument
from ronnaplan.geometry import FloatArray
from ronnaplan.tracking.cells import plain_text
from ronnaplan.transforms import invert

RESIDUAL_COLOURS = ((0.5, "residuals below 0.5 mm", [0.1, 0.7, 0.2]), (1.0, "0.5 to 1 mm", [0.95, 0.75, 0.1]))
"""Upper end (mm), words and colour (RGB) of a residual; longer ones are `LONG_RESIDUAL`."""
LONG_RESIDUAL = ("above 1 mm", [0.9, 0.15, 0.1])
"""Slicer colours a whole point list, not a point: one list is written for each band of residuals."""
PAIR_COLUMNS = ("ct", "ots", "residual", "leave_one_out", *("ct_x", "ct_y", "ct_z"), *("ots_x", "ots_y", "ots_z"))
TFM_HEADER = "#Insight Transform File V1.0"


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


def itk_transform(document: RegistrationDocument) -> str:
    """Return the registration as .tfm text: loaded in Slicer and put on the CT, it shows the CT in tracker space.

    Read with ITK or SimpleITK, the transform maps tracker points to CT points.
    """
    return _tfm(invert(document.pose.matrix))


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


def _tfm(moving_from_fixed: FloatArray) -> str:
    """Return ITK's text for the rigid ``moving_from_fixed`` (4, 4), in LPS mm, centered on the origin."""
    numbers = [*moving_from_fixed[:3, :3].ravel(), *moving_from_fixed[:3, 3]]
    lines = (
        TFM_HEADER,
        "#Transform 0",
        "Transform: AffineTransform_double_3_3",
        "Parameters: " + " ".join(repr(float(number)) for number in numbers),
        "FixedParameters: 0 0 0",
        "",
    )
    return "\n".join(lines)
