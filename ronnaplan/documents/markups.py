"""3D Slicer's markups (.mrk.json, schema 1.0.3): fiducials as a point list, coordinates in LPS."""

from __future__ import annotations

from typing import Any, Final

from ronnaplan.documents.fiducials import FiducialEntry, FiducialsDocument
from ronnaplan.documents.reading import plain_json

SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
MARKUPS_ENDINGS: Final[tuple[str, ...]] = (".mrk.json", ".json")
"""By which Slicer, and `ronnaplan plan import`, tell a file of markups."""
LPS_AXES = [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0]
"""Slicer's axes (RAS) seen from LPS: the orientation that a plain point carries."""


def markups(document: FiducialsDocument) -> str:
    """Express the fiducials as a Slicer markups file (JSON text)."""
    points = [_control_point(number, entry) for number, entry in enumerate(document.fiducials, start=1)]
    markup = {
        "type": "Fiducial",
        "name": "CT fiducials",
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": True,
        "fixedNumberOfControlPoints": False,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": len(points),
        "controlPoints": points,
    }
    return plain_json({"@schema": SCHEMA, "markups": [markup]})


def _control_point(number: int, entry: FiducialEntry) -> dict[str, Any]:
    error_mm = sum(entry.covariance[axis][axis] for axis in range(3)) ** 0.5
    doubts = f"; {', '.join(entry.flags)}" if entry.flags else ""
    return {
        "id": str(number),
        "label": entry.label,
        "description": f"sphere {entry.diameter_mm:.2f} mm, error {error_mm:.3f} mm RMS{doubts}",
        "associatedNodeID": "",
        "position": list(entry.center),
        "orientation": LPS_AXES,
        "selected": True,
        "locked": True,
        "visibility": True,
        "positionStatus": "defined",
    }
