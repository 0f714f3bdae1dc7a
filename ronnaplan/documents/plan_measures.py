"""What `plan check` and `plan markers` write: all measures and verdicts as JSON, proposed markers as markups."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from ronnaplan.documents.fields import SOFTWARE
from ronnaplan.documents.markups import LPS_AXES, SCHEMA
from ronnaplan.documents.reading import plain_json
from ronnaplan.planning.limits import Verdict
from ronnaplan.planning.measures import Measures
from ronnaplan.planning.placement import Placement
from ronnaplan.planning.plan import Plan
from ronnaplan.planning.surface import Surface
from ronnaplan.planning.uncertainty import PathError

FORMAT = "ronnaplan.measures"


def measures_document(
    plan: Plan, measured: Sequence[Measures], verdicts: Sequence[Verdict], *, indent: int | None = 2
) -> str:
    """Return the measures (JSON text): lengths in mm, angles in degrees, places in LPS mm."""
    document = {
        "format": FORMAT,
        "version": 1,
        "coordinate_system": "LPS",
        "unit": "mm",
        "source": {"frame_of_reference_uid": plan.frame.uid, "voxel_sha256": plan.voxel_sha256},
        "trajectories": [_measures(one) for one in measured],
        "verdicts": [asdict(verdict) for verdict in verdicts],
        "software": SOFTWARE,
    }
    return plain_json(document, indent=indent)


def _measures(one: Measures) -> dict[str, Any]:
    return {
        "name": one.trajectory.name,
        "length_mm": one.length_mm,
        "depth_below_scalp_mm": one.depth_below_scalp_mm,
        "depth_below_skull_mm": one.depth_below_skull_mm,
        "entry_below_scalp_mm": one.entry_below_scalp_mm,
        "skull_thickness_mm": one.skull_thickness_mm,
        "skull_angle_deg": one.skull_angle_deg,
        "scalp_angle_deg": one.scalp_angle_deg,
        "doubts": list(one.doubts),
        "way_out": one.crossings.way.name.lower(),
        "scalp": _surface(one.crossings.scalp),
        "outer_table": _surface(one.crossings.outer),
        "inner_table": _surface(one.crossings.inner),
        "profile": {"depth_mm": one.profile_mm.round(3).tolist(), "hu": one.profile_hu.round(1).tolist()},
        "clearances": [asdict(clearance) for clearance in one.clearances],
        "electrode": _electrode(one),
        "spacings": [asdict(spacing) for spacing in one.spacings],
        "arc_and_ring": asdict(one.arc),
        "ac_pc": asdict(one.acpc) if one.acpc else None,
        "expected_error": _error(one.error),
        "planned_error": _error(one.planned_error),
    }


def _electrode(one: Measures) -> dict[str, Any] | None:
    if one.trajectory.electrode is None:
        return None
    contacts = [
        {
            "number": contact.number,
            "center": contact.center_mm.tolist(),
            "depth_mm": contact.depth_mm,
            "inside": contact.inside,
            "clearances": [asdict(clearance) for clearance in contact.clearances],
        }
        for contact in one.contacts
    ]
    return {"model": one.trajectory.electrode.name, "contacts": contacts}


def _error(error: PathError | None) -> dict[str, Any] | None:
    if error is None:
        return None
    return {
        "basis": error.expected.basis.value,
        "markers": list(error.expected.markers),
        "sigma_ct_mm": error.expected.sigma_ct_mm,
        "sigma_ots_mm": error.expected.sigma_ots_mm,
        "depth_mm": error.depths_mm.round(3).tolist(),
        "tre_rms_mm": error.tre_rms_mm.tolist(),
        "tube_radius_mm": error.tube_mm.tolist(),
        "covariances_mm2": error.covariances_mm2.tolist(),
        "angular_rms_deg": error.angular_rms_deg,
        "tolerance_mm": error.tolerance_mm,
        "probability": error.probability,
    }


def _surface(surface: Surface | None) -> dict[str, Any] | None:
    if surface is None:
        return None
    return {
        "position": surface.position_mm.tolist(),
        "normal": surface.normal.tolist(),
        "standard_error_mm": surface.sd_mm,
        "clear": surface.clear,
    }


def placement_markups(placed: Placement) -> str:
    """Express proposed marker centers as a Slicer point list (JSON text, LPS)."""
    points = [
        {
            "id": str(n + 1),
            "label": f"M{n + 1}",
            "description": "proposed; on the scalp at " + " ".join(f"{value:.2f}" for value in scalp),
            "associatedNodeID": "",
            "position": center.tolist(),
            "orientation": LPS_AXES,
            "selected": True,
            "locked": True,
            "visibility": True,
            "positionStatus": "defined",
        }
        for n, (scalp, center) in enumerate(zip(placed.scalp_mm, placed.centers_mm, strict=True))
    ]
    markup = {
        "type": "Fiducial",
        "name": "proposed markers",
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": True,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": len(points),
        "controlPoints": points,
    }
    return plain_json({"@schema": SCHEMA, "markups": [markup]})
