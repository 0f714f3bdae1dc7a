"""The panels where something is settled by hand, as plain values: rivals of a pairing, readings, AC-PC points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ronnaplan.documents.registration import LabelPair, RegistrationDocument
from ronnaplan.planner.state import LANDMARKS, PlannerState

MOST_RIVALS = 4
"""Pairings shown beside each other."""

SAME_NATS = 0.05
"""Pairings whose log evidence differs by less are shown as equally probable."""


def pointing_panel(state: PlannerState) -> dict[str, Any]:
    """Return the readings, what was pointed at so far, and the rivals beside each other."""
    readings = state.readings_mm
    rows = zip(readings.labels, readings.positions_mm, strict=True) if readings is not None else ()
    return {
        "asked": state.pointing,
        "marker": state.pointed_marker or "",
        "reading": state.pointed_reading or "",
        "touch": (state.touch or "") if state.pointing else "",
        "known": ", ".join(f"{ct} is {ots}" for ct, ots in state.known_pairs.items()),
        "readings": [(label, ", ".join(f"{value:.1f}" for value in place)) for label, place in rows],
        **(
            _rivals(state.registration)
            if state.registration and not state.outdated
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


def landmark_rows(state: PlannerState) -> list[dict[str, Any]]:
    """Return one row a point of the AC-PC frame: its name, and its place in LPS mm, empty where it is not set."""
    known = state.landmarks_mm
    return [
        {
            "name": name,
            "place": ", ".join(f"{value:.2f}" for value in known[name]) if name in known else "",
        }
        for name in LANDMARKS
    ]


def proposal_rows(state: PlannerState) -> list[tuple[str, str]]:
    """Return one row a proposed entry, best first: its score and the reasons."""
    found = state.proposals
    if found is None:
        return []
    return [(f"{one.score:.2f}", "; ".join(one.reasons)) for one in found.best] or [
        ("-", "no entry keeps every limit")
    ]


def placement_line(state: PlannerState) -> str:
    """Return in words what the proposed places for markers promise, empty where there are none."""
    placed = state.placement
    if placed is None:
        return ""
    return (
        f"{len(placed.centres_mm)} places, shown in blue in the 3-D view: largest expected error "
        f"{placed.largest_tre_mm:.2f} mm ({placed.even_tre_mm:.2f} mm when spread evenly)"
    )
