"""Plans, measures and verdicts as tables for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ronnaplan.geometry import FloatArray
from ronnaplan.planning.limits import Verdict
from ronnaplan.planning.measures import Measures
from ronnaplan.planning.placement import Placement
from ronnaplan.planning.plan import Plan
from ronnaplan.planning.proposals import Proposals
from ronnaplan.planning.rows import frame_sentence, number, value_and_limit
from ronnaplan.planning.uncertainty import Expectation
from ronnaplan.text import chance, table, told_apart


def plan_list(plan: Plan) -> str:
    """Return one row a trajectory, ends in LPS mm, length, instrument, lock; and the AC-PC frame, where it is set."""
    rows = [
        [
            one.name,
            _place(one.entry_mm),
            _place(one.target_mm),
            f"{one.length_mm:.1f}",
            f"{one.instrument.name} ({one.instrument.diameter_mm:g} x {one.instrument.length_mm:g})",
            one.electrode.name if one.electrode else "",
            "locked" if one.locked else "",
            one.notes,
        ]
        for one in plan.trajectories
    ]
    header = ["name", "entry LPS mm", "target LPS mm", "length mm", "instrument mm", "electrode", "", "notes"]
    frame = "" if plan.landmarks is None else f"\n\n{frame_sentence(plan.landmarks)}"
    return f"{_table(header, rows)}{frame}"


def history_list(plan: Plan) -> str:
    """Return one row a change."""
    rows = []
    for change in plan.history:
        name = getattr(change.after or change.before, "name", "AC-PC")
        rows.append([change.time.strftime("%Y-%m-%d %H:%M:%S"), change.action, name])
    return _table(["time (UTC)", "change", "of"], rows)


def measures_table(measured: Sequence[Measures], expected: Expectation) -> str:
    """Return what was measured, one row a trajectory, and below it what the expected errors rest on."""
    header = ["name", "length", "below scalp", "below skull", "skull", "angle", "arc", "ring", "sagittal"]
    header += ["coronal", "nearest", "TRE entry", "TRE target", "turn", "chance"]
    units = ["", "mm", "mm", "mm", "mm", "deg", "deg", "deg", "deg", "deg", "mm", "mm", "mm", "deg", ""]
    shown = told_apart(one.trajectory.name for one in measured)
    table = _table(header, [units, *([shown[one.trajectory.name], *_values(one)] for one in measured)])
    return "\n".join([table, *_bases(measured, expected)])


def _bases(measured: Sequence[Measures], expected: Expectation) -> list[str]:
    """Say what the expected error is that counts and, where there are two, what the other one is."""
    lines = [f"expected error (TRE) {expected.counted}"] if expected.counted else []
    if expected.beside:
        errors = ", ".join(
            f"{one.trajectory.name} {one.planned_error.entry_rms_mm:.2f} and {one.planned_error.target_rms_mm:.2f} mm"
            for one in measured
            if one.planned_error is not None
        )
        lines.append(f"{expected.beside} it would be, at entry and target: {errors}")
    return lines


def _values(one: Measures) -> list[str]:
    nearest = min((clearance.clearance_mm for clearance in one.clearances), default=None)
    acpc, error = one.acpc, one.error
    return [
        number(one.length_mm, 1),
        number(one.depth_below_scalp_mm, 1),
        number(one.depth_below_skull_mm, 1),
        number(one.skull_thickness_mm, 1),
        number(one.skull_angle_deg, 1),
        number(one.arc.arc_deg, 1),
        number(one.arc.ring_deg, 1),
        number(acpc.sagittal_deg if acpc else None, 1),
        number(acpc.coronal_deg if acpc else None, 1),
        number(nearest, 1),
        number(error.entry_rms_mm if error else None, 2),
        number(error.target_rms_mm if error else None, 2),
        number(error.angular_rms_deg if error else None, 2),
        chance(error.probability if error else None),
    ]


def verdict_table(verdicts: Sequence[Verdict]) -> str:
    """Return one row a verdict, with its value, limit and whether it passes."""
    names = told_apart(one.trajectory for one in verdicts)
    measures = told_apart(one.measure for one in verdicts)
    rows = [
        [
            names[one.trajectory],
            measures[one.measure],
            *value_and_limit(one),
            one.unit,
            "pass" if one.passes else "FAIL",
            one.remark,
        ]
        for one in verdicts
    ]
    return _table(["trajectory", "measure", "value", "limit", "unit", "verdict", "remark"], rows)


def proposals_table(found: Proposals, expected: Expectation) -> str:
    """Return the proposed entries with score and reasons, and what kept the other ways out."""
    rows = [
        [str(n), f"{one.score:.3f}", _place(one.trajectory.entry_mm), "; ".join(one.reasons)]
        for n, one in enumerate(found.best, start=1)
    ]
    table = _table(["", "score", "entry LPS mm", "reasons"], rows)
    excluded = ", ".join(f"{number} {reason}" for reason, number in found.excluded.items()) or "none"
    tried = f"{len(found.scores)} ways tried; excluded: {excluded}"
    return "\n".join([table, tried, *([f"expected error {expected.counted}"] if expected.counted else [])])


def placement_table(placed: Placement, targets: Sequence[str]) -> str:
    """Return the proposed markers, and the error to expect at each target."""
    rows = [
        [f"M{n + 1}", _place(scalp), _place(center)]
        for n, (scalp, center) in enumerate(zip(placed.scalp_mm, placed.centers_mm, strict=True))
    ]
    markers = _table(["marker", "on the scalp LPS mm", "center LPS mm"], rows)
    errors = [[name, f"{error:.3f}"] for name, error in zip(targets, placed.tre_rms_mm, strict=True)]
    return f"{markers}\n\n{_table(['target', 'expected TRE mm'], errors)}"


def _place(place_mm: FloatArray) -> str:
    return " ".join(f"{value:.2f}" for value in place_mm)


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    return "\n".join(table([header, *(list(map(str, row)) for row in rows)]))
