"""What stands in each panel of the page, as plain values: markers, trajectories, registration, AC-PC, proposals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ronnaplan.case.judgement import Judgement
from ronnaplan.case.placed import placement_doubts
from ronnaplan.documents.registration import LabelPair, RegistrationDocument
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.following import told
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import LANDMARKS
from ronnaplan.planning.angles import acpc_from_lps
from ronnaplan.planning.electrodes import NO_ELECTRODE
from ronnaplan.planning.limits import Verdict, is_near
from ronnaplan.planning.proposals import Proposal
from ronnaplan.planning.rows import (
    coordinates,
    error_table,
    number,
    placement_sentence,
    shape_rows,
    verdict_sentence,
)
from ronnaplan.text import chance, counted, told_apart

MOST_RIVALS = 4
"""Pairings shown beside each other."""

OUTCOMES = ("FAIL", "near", "pass")
"""Of a limit: what is looked at first."""

MEASURING = "measuring ..."
"""Stands for what is wrong with a trajectory until that is known."""

NO_MARKERS = "no expected error: there are no markers"
"""Stands where errors would be expected."""

LAST_LETTERS = 10
"""Of a long name in the list of trajectories: they are always seen."""

SAME_NATS = 0.05
"""Pairings whose log evidence differs by less are shown as equally probable."""


def marker_rows(state: PlannerState) -> list[dict[str, str]]:
    """Return one row a marker."""
    rows = []
    for one in state.case.fiducials.fiducials if state.case.fiducials else ():
        error, flags = f"{1e3 * one.error_rms_mm:.0f}", "; ".join(one.doubts)
        rows.append({"label": one.label, "center": coordinates(one.center), "error": error, "flags": flags})
    return rows


def rejected_rows(state: PlannerState) -> list[dict[str, Any]]:
    """Return one row a rejected candidate; those that a person turned down can be accepted."""
    return [
        {"center": coordinates(one.center), "reason": one.reason, "acceptable": one.marker is not None}
        for one in (state.case.fiducials.rejected if state.case.fiducials else ())
    ]


def path_rows(state: PlannerState) -> list[dict[str, Any]]:
    """Return one row a trajectory; its verdict is empty until it was measured, and while it is dragged."""
    plan = state.case.plan
    return [
        {
            "name": one.name,
            "parts": _beginning_and_end(one.name),
            "colour": one.colour,
            "locked": one.locked,
            "selected": one.name == state.look.selected,
            "length": f"{one.length_mm:.1f}",
            "verdict": ("", "") if judged is None else _in_a_word(judged),
        }
        for one, judged in zip(plan.trajectories, state.case.surroundings.glance(plan), strict=True)
    ]


def _beginning_and_end(name: str) -> tuple[str, str]:
    """Return a name in two parts: of a long one the page shortens the first, so that both its ends are seen."""
    return (name, "") if len(name) < 2 * LAST_LETTERS else (name[:-LAST_LETTERS], name[-LAST_LETTERS:])


def _in_a_word(judged: Judgement) -> tuple[str, str]:
    """Return what a list of trajectories says of one, and which of the outcomes that looks like."""
    fail, near, kept = OUTCOMES
    if judged.problem:
        return "not judged", fail
    if judged.broken:
        return f"breaks {len(judged.broken)}", fail
    if judged.doubts:
        return "doubted", near
    outcomes = {_outcome(one) for one in judged.verdicts}
    return (near, near) if near in outcomes else ("kept", kept)


def chosen_path(state: PlannerState, judged: Judgement | None) -> dict[str, Any]:
    """Return the selected trajectory with its ends to the micrometre, measures and verdicts."""
    one = state.look.chosen
    if one is None or judged is None:
        return {"name": "", "measures": [], "errors": [], "verdicts": []}
    landmarks, expected = state.case.plan.landmarks, state.case.surroundings.expected
    unexplained = judged.measures is not None and expected.counted is None and not expected.remarks
    return {
        "name": one.name,
        "locked": one.locked,
        "colour": one.colour,
        "instrument": one.instrument.name,
        "diameter": one.instrument.diameter_mm,
        "length": one.instrument.length_mm,
        "electrode": one.electrode.name if one.electrode else NO_ELECTRODE,
        "notes": one.notes,
        "entry": one.entry_mm.round(3).tolist(),
        "target": one.target_mm.round(3).tolist(),
        "acpc": [] if landmarks is None else acpc_from_lps(landmarks, one.target_mm).round(3).tolist(),
        "problem": judged.problem,
        "measuring": judged.problem == MEASURING,
        "spoken": "" if state.case.dragging else _spoken(one.name, judged),
        "doubts": list(judged.doubts),
        "remarks": list(expected.remarks),
        "wanting": NO_MARKERS if unexplained else "",
        "measures": shape_rows(judged.measures) if judged.measures else [],
        "errors": error_table(judged.measures) if judged.measures else [],
        "verdicts": [
            (verdict.measure, verdict_sentence(verdict).removeprefix(f"{verdict.measure} "), _outcome(verdict))
            for verdict in sorted(judged.verdicts, key=lambda one: OUTCOMES.index(_outcome(one)))
        ],
    }


def _outcome(verdict: Verdict) -> str:
    if not verdict.passes:
        return OUTCOMES[0]
    return OUTCOMES[1] if is_near(verdict) else OUTCOMES[2]


def _spoken(name: str, judged: Judgement) -> str:
    """Return the verdict on a trajectory and its doubts in one sentence, for those who listen to the page."""
    if not judged.verdicts:
        return ""
    broken = ", ".join(verdict.measure for verdict in judged.broken)
    limits = counted(len(judged.verdicts), "limit")
    kept = f"breaks {len(judged.broken)} of {limits}: {broken}" if broken else f"keeps {limits}"
    return "; ".join([f"{name} {kept}", *judged.doubts])


def registration_panel(state: PlannerState) -> dict[str, Any]:
    """Return pairs and residuals, or the refusal with its rivals, and the expected errors."""
    found = state.case.registration
    if found is None:
        return {"status": ""}
    if state.case.outdated:
        return {"status": "outdated", "summary": f"outdated: {state.case.outdated}"}
    errors = state.registering.expected_errors_mm()
    shown = told_apart(errors)
    fre = (
        ""
        if found.fre_rms is None
        else f"FRE {found.fre_rms:.3f} mm RMS, probability {chance(found.probability, 6)}"
    )
    return {
        "status": found.status,
        "summary": f"{found.status}: {found.reason or fre}",
        "pairs": [(p.ct, p.ots, f"{p.residual:.2f}", number(p.leave_one_out)) for p in found.pairs],
        "rivals": [
            (", ".join(f"{p.ct}={p.ots}" for p in rival.pairs), f"{rival.log_evidence_below:.1f}")
            for rival in found.rivals
        ],
        "basis": str(state.case.surroundings.expected.registered or ""),
        "errors": [(shown[name], f"{error:.3f}") for name, error in errors.items()],
        "doubts": [*found.notes, *found.doubts],
    }


def following_panel(state: PlannerState) -> dict[str, Any]:
    """Return whether tools are followed, and a line on each that is seen, or that none is."""
    following = state.following
    lines = [told(one, state.look.chosen) for one in following.seen]
    return {"active": following.active, "lines": lines or ["no tool is seen"] * following.active}


def pointing_panel(state: PlannerState) -> dict[str, Any]:
    """Return the readings, what was pointed at so far, and the rivals beside each other."""
    readings = state.registering.readings_mm
    rows = zip(readings.labels, readings.positions_mm, strict=True) if readings is not None else ()
    return {
        "asked": state.registering.pointing,
        "marker": state.registering.pointed_marker or "",
        "reading": state.registering.pointed_reading or "",
        "touch": (state.registering.touch or "") if state.registering.pointing else "",
        "known": ", ".join(f"{ct} is {ots}" for ct, ots in state.registering.known_pairs.items()),
        "readings": [(label, ", ".join(f"{value:.1f}" for value in place)) for label, place in rows],
        **(
            _rivals(state.case.registration)
            if state.case.registration and not state.case.outdated
            else {"heads": [], "rivals": []}
        ),
    }


def _rivals(found: RegistrationDocument) -> dict[str, Any]:
    """Return one row a CT marker: its reading in each pairing, and whether the pairings differ in it."""
    answers: list[tuple[str, dict[str, str]]] = []
    if found.status == "unique":
        answers.append(("taken", _by_marker(found.pairs)))
    for rival in found.rivals:
        answers.append((_behind(rival.log_evidence_below, not answers), _by_marker(rival.pairs)))
    shown = answers[: MOST_RIVALS + 1]
    if len(shown) < 2:
        return {"heads": [], "rivals": []}
    labels = dict.fromkeys(label for _, answer in shown for label in answer)
    rows = [(label, [answer.get(label, "-") for _, answer in shown]) for label in labels]
    return {
        "heads": [head for head, _ in shown],
        "rivals": [(label, cells, len(set(cells)) > 1) for label, cells in rows],
        "more": len(answers) - len(shown),
    }


def _behind(nats: float, first: bool) -> str:
    if first:
        return "most probable"
    return f"{nats:.1f} nats below" if nats >= SAME_NATS else "as probable"


def _by_marker(pairs: Sequence[LabelPair]) -> dict[str, str]:
    return {pair.ct: pair.ots for pair in pairs}


def place_line(state: PlannerState, place_mm: FloatArray) -> str:
    """Return the HU at a place (3,), interpolated, and where that is in LPS and RAS."""
    value = float(state.look.scan.values_hu(place_mm[np.newaxis])[0])
    known = "outside the scan" if np.isnan(value) else f"{value:.0f} HU"
    x, y, z = place_mm
    return f"{known}   LPS {x:z.1f}, {y:z.1f}, {z:z.1f}   RAS {-x:z.1f}, {-y:z.1f}, {z:z.1f}"


def robot_doubts(state: PlannerState) -> list[str]:
    """Return what the robot's place in the case does not hold for, or what blocks it, a sentence each."""
    case = state.case
    return [] if case.placement is None else placement_doubts(case.placement, case.plan, case.fiducials)


def landmark_rows(state: PlannerState) -> list[dict[str, Any]]:
    """Return one row a point of the AC-PC frame: its name, and its place in LPS mm, empty where it is not set."""
    known = state.landmarks_mm
    return [
        {
            "name": name,
            "place": coordinates(known[name]) if name in known else "",
        }
        for name in LANDMARKS
    ]


def proposal_rows(state: PlannerState) -> dict[str, Any]:
    """Return one row a proposed entry, best first, with what it can be sorted by; or that there is none."""
    found = state.offers.proposals
    if found is None:
        return {"rows": [], "none": ""}
    rows = [_proposal_row(number, one) for number, one in enumerate(found.best, start=1)]
    return {"rows": rows, "none": "" if rows else "no entry keeps every limit"}


def _proposal_row(number: int, one: Proposal) -> dict[str, Any]:
    nearest = min((near.clearance_mm for near in one.measures.clearances), default=None)
    error = one.measures.error
    return {
        "number": number,
        "score": round(one.score, 2),
        "length": round(one.measures.length_mm, 1),
        "angle": None if one.measures.skull_angle_deg is None else round(one.measures.skull_angle_deg, 1),
        "distance": None if nearest is None else round(nearest, 1),
        "error": None if error is None else round(error.target_rms_mm, 2),
        "reasons": "; ".join(one.reasons),
    }


def placement_line(state: PlannerState) -> str:
    """Return in words what the proposed places for markers promise, empty where there are none."""
    placed = state.offers.placement
    if placed is None:
        return ""
    told = f"{len(placed.centers_mm)} places, shown in magenta in the 3-D view: {placement_sentence(placed)}"
    return f"{told}; {placed.doubt}" if placed.doubt else told
