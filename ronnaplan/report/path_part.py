"""The report's trajectories: cuts, measures, distances, and what is wrong with a path."""

from __future__ import annotations

from collections.abc import Iterable

from ronnaplan.case.folder import Case
from ronnaplan.planning import Measures, Trajectory, Verdict
from ronnaplan.planning.uncertainty import PathError
from ronnaplan.report.html import element, picture, table
from ronnaplan.report.part import Part, number
from ronnaplan.report.path_cuts import path_picture

TITLE = "Trajectories"
VERDICTS = ("held against limits", "value", "limit", "", "verdict", "")


def paths_part(case: Case) -> Part:
    """Judge and draw every trajectory of the plan in the scan."""
    if case.plan is None or not case.plan.trajectories:
        return Part(TITLE)
    if case.volume is None:
        return Part(
            TITLE, [table(("", "entry LPS mm", "target LPS mm", "length mm"), map(_ends, case.plan.trajectories))]
        )
    around = case.surroundings
    part = Part(TITLE, warnings=list(around.expected.remarks))
    for trajectory in case.plan.trajectories:
        part.body.append(element("h3", trajectory.name))
        judged = around.judge(trajectory, case.plan)
        if judged.problem:
            part.warnings.append(f"trajectory {trajectory.name} could not be judged: {judged.problem}")
        if judged.measures is None:
            continue
        drawn = path_picture(case.volume, judged.measures)
        part.body.append(picture(drawn, f"{trajectory.name}: two cuts along the path"))
        part.body.append(table([], _measures(judged.measures)))
        part.body.append(table(VERDICTS, map(_verdict, judged.verdicts)))
        part.warnings.extend(f"trajectory {trajectory.name}: {doubt}" for doubt in judged.measures.doubts)
        part.warnings.extend(map(_fault, judged.broken))
    return part


def _ends(trajectory: Trajectory) -> list[str]:
    return [
        trajectory.name,
        _place(trajectory.entry_mm),
        _place(trajectory.target_mm),
        f"{trajectory.length_mm:.2f}",
    ]


def _measures(one: Measures) -> list[tuple[str, str]]:
    path = one.trajectory
    rows = [
        ("entry, LPS mm", _place(path.entry_mm)),
        ("target, LPS mm", _place(path.target_mm)),
        (
            "instrument",
            f"{path.instrument.name}, {path.instrument.diameter_mm:g} x {path.instrument.length_mm:g} mm",
        ),
        ("length", f"{one.length_mm:.2f} mm"),
        ("target below scalp", f"{number(one.depth_below_scalp_mm)} mm"),
        ("target below skull", f"{number(one.depth_below_skull_mm)} mm"),
        ("bone along the path", f"{number(one.skull_thickness_mm)} mm"),
        ("angle to the skull's normal", f"{number(one.skull_angle_deg, 1)} deg"),
    ]
    rows += [
        (
            f"distance to {near.name}",
            f"{near.clearance_mm:.2f} mm (at least {near.at_least_mm:.2f}) at depth {near.depth_mm:.1f} mm",
        )
        for near in one.clearances
    ]
    rows += [
        (f"distance to {near.other}", f"{near.clearance_mm:.2f} mm at depth {near.depth_mm:.1f} mm")
        for near in one.spacings
    ]
    rows.append(("arc, ring of the frame", f"{one.arc.arc_deg:.1f}, {one.arc.ring_deg:.1f} deg"))
    if one.acpc is not None:
        rows += [
            ("AC-PC sagittal, coronal angle", f"{one.acpc.sagittal_deg:.1f}, {one.acpc.coronal_deg:.1f} deg"),
            ("target from mid-commissure, R A S", f"{_place(one.acpc.target_mm)} mm"),
        ]
    return rows + [row for error in (one.error, one.planned_error) if error is not None for row in _errors(error)]


def _errors(error: PathError) -> list[tuple[str, str]]:
    basis = error.expected.basis
    return [
        (f"expected error, as {basis}, with", error.expected.rests_on),
        (f"at the entry, as {basis}", f"{error.entry_rms_mm:.2f} mm RMS"),
        (f"at the target, as {basis}", f"{error.target_rms_mm:.2f} mm RMS"),
        (f"of the angle, as {basis}", f"{error.angular_rms_deg:.2f} deg RMS"),
        (f"radius of the 95 % tube, as {basis}", f"at most {error.tube_mm.max():.2f} mm"),
        (f"chance to stay within {error.tolerance_mm:g} mm, as {basis}", f"{error.probability:.3f}"),
    ]


def _verdict(one: Verdict) -> list[str]:
    limit = "" if one.limit is None else f"{one.limit:g}"
    return [one.measure, number(one.value), limit, one.unit, "pass" if one.passes else "FAIL", one.remark]


def _fault(one: Verdict) -> str:
    return f"trajectory {one.trajectory}: {one.measure} {number(one.value)} {one.unit} {one.remark}".rstrip()


def _place(place_mm: Iterable[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in place_mm)
