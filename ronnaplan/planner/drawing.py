"""The planner's state as plain values for the page: what is drawn over each cut, and what stands in each panel."""

from __future__ import annotations

from typing import Any

import numpy as np

from ronnaplan.case.surroundings import Judgement
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fiducials import FiducialFlag
from ronnaplan.planner.cuts import Cut
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Measures, Trajectory
from ronnaplan.planning.uncertainty import PathError

MARKER_COLOUR, REJECTED_COLOUR, POINT_COLOUR = "#ff9f1c", "#ff5252", "#b2ff59"

NEAR_MM = 3.0
"""A trajectory with an end this near to the plane is drawn in full, others faintly."""

TITLES = {"inline": "in line with {}", "probe": "probe's eye, {:.1f} mm deep"}
LEFT_RIGHT = {"axial": "axial  R | L", "coronal": "coronal  R | L", "sagittal": "sagittal  A | P"}


def over_cut(state: PlannerState, view: str, show_rejected: bool) -> dict[str, Any]:
    """Return what is drawn over a view, in mm from its middle; empty for a path view without a trajectory."""
    if view not in LEFT_RIGHT and state.chosen is None:
        return {
            "box": "-1 -1 2 2",
            "half": 1,
            "title": "select a trajectory",
            "markers": [],
            "points": [],
            "paths": [],
        }
    cut = state.cut(view)
    half = cut.field_mm / 2
    return {
        "box": f"{-half} {-half} {2 * half} {2 * half}",
        "half": half,
        "title": _title(state, view, cut),
        "cross": _pair(cut, state.crosshair_mm) if view in LEFT_RIGHT else None,
        "markers": _markers(state, cut, show_rejected),
        "points": _points(state, cut),
        "paths": [_path(one, cut, one.name == state.selected) for one in state.plan.trajectories],
    }


def _title(state: PlannerState, view: str, cut: Cut) -> str:
    if view in LEFT_RIGHT:
        return f"{LEFT_RIGHT[view]}   {state.crosshair_mm @ np.abs(cut.away):.1f} mm"
    assert state.chosen is not None
    depth = float((cut.centre_mm - state.chosen.entry_mm) @ state.chosen.inward)
    return TITLES[view].format(state.chosen.name if view == "inline" else depth)


def balls(state: PlannerState, show_rejected: bool) -> list[tuple[str, tuple[float, float, float], float, str]]:
    """Return label, centre and radius (mm), and colour of each marker, and of what was rejected where it is shown."""
    found = state.fiducials
    if found is None:
        return []
    shown = [(one.label, one.center, one.diameter_mm / 2, MARKER_COLOUR) for one in found.fiducials]
    if show_rejected:
        radius = found.marker.diameter_mm / 2
        shown += [(f"x{n + 1}", one.center, radius, REJECTED_COLOUR) for n, one in enumerate(found.rejected)]
    return shown


def _markers(state: PlannerState, cut: Cut, show_rejected: bool) -> list[dict[str, Any]]:
    """Return the circles that the plane cuts out of the markers."""
    drawn = []
    for label, center, radius, colour in balls(state, show_rejected):
        x, y, away = cut.on_screen_mm(np.array(center))
        if abs(away) < radius and max(abs(x), abs(y)) < cut.field_mm / 2:
            r = float(np.sqrt(radius**2 - away**2))
            selected = label == state.marker
            drawn.append(
                {"label": label, "x": float(x), "y": float(y), "r": r, "colour": colour}
                | {"selected": selected, "ring": True}
            )
    return drawn


def _points(state: PlannerState, cut: Cut) -> list[dict[str, Any]]:
    """Return the points of the AC-PC frame that lie in the plane."""
    drawn = []
    for name, place in state.landmarks_mm.items():
        x, y, away = cut.on_screen_mm(place).tolist()
        if abs(away) < NEAR_MM and max(abs(x), abs(y)) < cut.field_mm / 2:
            drawn.append({"label": name, "x": x, "y": y, "colour": POINT_COLOUR})
    return drawn


def _path(one: Trajectory, cut: Cut, selected: bool) -> dict[str, Any]:
    ends = cut.on_screen_mm(np.stack([one.entry_mm, one.target_mm]))
    near = bool(np.abs(ends[:, 2]).min() < NEAR_MM or ends[0, 2] * ends[1, 2] < 0)
    places = {"entry": ends[0, :2].tolist(), "target": ends[1, :2].tolist()}
    look = {"selected": selected, "near": near, "width": 2.5 if selected else 1.5}
    return {"name": one.name, "colour": one.colour, **look, **places}


def _pair(cut: Cut, place_mm: FloatArray) -> list[float]:
    pair: list[float] = cut.on_screen_mm(place_mm)[:2].tolist()
    return pair


def marker_rows(state: PlannerState) -> list[dict[str, str]]:
    """Return one row a marker."""
    rows = []
    for one in state.fiducials.fiducials if state.fiducials else ():
        error_um = 1e3 * float(np.sqrt(np.trace(np.array(one.covariance))))
        known = FiducialFlag.__members__
        flags = "; ".join(str(known.get(flag.upper(), flag)) for flag in one.flags)
        rows.append({"label": one.label, "centre": _place(one.center), "error": f"{error_um:.0f}", "flags": flags})
    return rows


def rejected_rows(state: PlannerState) -> list[dict[str, Any]]:
    """Return one row a rejected candidate; those that a person turned down can be accepted."""
    return [
        {"centre": _place(one.center), "reason": one.reason, "acceptable": one.marker is not None}
        for one in (state.fiducials.rejected if state.fiducials else ())
    ]


def path_rows(state: PlannerState) -> list[dict[str, Any]]:
    """Return one row a trajectory."""
    return [
        {
            "name": one.name,
            "colour": one.colour,
            "locked": one.locked,
            "selected": one.name == state.selected,
            "length": f"{one.length_mm:.1f}",
        }
        for one in state.plan.trajectories
    ]


def chosen_path(state: PlannerState, judged: Judgement | None) -> dict[str, Any]:
    """Return the selected trajectory with its ends to the micrometre, measures and verdicts."""
    one = state.chosen
    if one is None or judged is None:
        return {"name": "", "measures": [], "verdicts": []}
    return {
        "name": one.name,
        "locked": one.locked,
        "colour": one.colour,
        "instrument": one.instrument.name,
        "diameter": one.instrument.diameter_mm,
        "length": one.instrument.length_mm,
        "notes": one.notes,
        "entry": one.entry_mm.round(3).tolist(),
        "target": one.target_mm.round(3).tolist(),
        "problem": judged.problem,
        "doubts": [*state.surroundings.expected.remarks, *(judged.measures.doubts if judged.measures else ())],
        "measures": _measures(judged.measures) if judged.measures else [],
        "verdicts": [
            (verdict.measure, f"{_number(verdict.value)} {verdict.unit} {verdict.remark}", verdict.passes)
            for verdict in sorted(judged.verdicts, key=lambda verdict: verdict.passes)
        ],
    }


def _measures(one: Measures) -> list[tuple[str, str]]:
    rows = [
        ("length", f"{one.length_mm:.2f} mm"),
        ("target below scalp", f"{_number(one.depth_below_scalp_mm)} mm"),
        ("target below skull", f"{_number(one.depth_below_skull_mm)} mm"),
        ("bone along the path", f"{_number(one.skull_thickness_mm)} mm"),
        ("angle to the skull's normal", f"{_number(one.skull_angle_deg)} deg"),
    ]
    rows.append(("arc, ring of a frame square to the scan", f"{one.arc.arc_deg:.1f}, {one.arc.ring_deg:.1f} deg"))
    if one.acpc is not None:
        rows += [
            ("AC-PC sagittal, coronal angle", f"{one.acpc.sagittal_deg:.1f}, {one.acpc.coronal_deg:.1f} deg"),
            (
                "target from mid-commissure, R A S",
                ", ".join(f"{value:.1f}" for value in one.acpc.target_mm) + " mm",
            ),
        ]
    return rows + [row for error in (one.error, one.planned_error) if error is not None for row in _errors(error)]


def _errors(error: PathError) -> list[tuple[str, str]]:
    basis = error.expected.basis
    return [
        (f"expected error, as {basis}", str(error.expected)),
        (f"at the entry, as {basis}", f"{error.entry_rms_mm:.2f} mm RMS"),
        (f"at the target, as {basis}", f"{error.target_rms_mm:.2f} mm RMS"),
        (f"of the angle, as {basis}", f"{error.angular_rms_deg:.2f} deg RMS"),
        (f"chance within {error.tolerance_mm:g} mm, as {basis}", f"{error.probability:.3f}"),
    ]


def registration_panel(state: PlannerState) -> dict[str, Any]:
    """Return pairs and residuals, or the refusal with its rivals, and the expected errors."""
    found = state.registration
    if found is None:
        return {"status": ""}
    if state.outdated:
        return {"status": "outdated", "summary": f"outdated: {state.outdated}"}
    fre = "" if found.fre_rms is None else f"FRE {found.fre_rms:.3f} mm RMS, probability {found.probability:.6f}"
    return {
        "status": found.status,
        "summary": f"{found.status}: {found.reason or fre}",
        "pairs": [(p.ct, p.ots, f"{p.residual:.2f}", _number(p.leave_one_out)) for p in found.pairs],
        "rivals": [
            (", ".join(f"{p.ct}={p.ots}" for p in rival.pairs), f"{rival.log_evidence_below:.1f}")
            for rival in found.rivals
        ],
        "basis": str(state.surroundings.expected.registered or ""),
        "errors": [(name, f"{error:.2f}") for name, error in state.expected_errors_mm().items()],
    }


def _place(place_mm: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.2f}" for value in place_mm)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
