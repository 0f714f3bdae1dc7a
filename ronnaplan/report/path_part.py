"""The report's trajectories: cuts, measures, distances, and what is wrong with a path."""

from __future__ import annotations

from ronnaplan.case.folder import Case
from ronnaplan.documents.plan_measures import measures_document
from ronnaplan.planning import Measures, Trajectory, Verdict
from ronnaplan.planning.rows import (
    Rows,
    distance_rows,
    error_rows,
    place,
    shape_rows,
    value_and_limit,
    verdict_sentence,
)
from ronnaplan.report.html import element, picture, table, unseen
from ronnaplan.report.part import Part
from ronnaplan.report.path_cuts import path_picture

TITLE = "Trajectories"
VERDICTS = ("held against limits", "value", "limit", "", "verdict", "")


def paths_part(case: Case) -> Part:
    """Judge and draw every trajectory of the plan in the scan, and hold what `plan check` writes of them."""
    if case.plan is None or not case.plan.trajectories:
        return Part(TITLE)
    if case.volume is None:
        return Part(
            TITLE, [table(("", "entry LPS mm", "target LPS mm", "length mm"), map(_ends, case.plan.trajectories))]
        )
    around = case.surroundings
    part = Part(TITLE, warnings=list(around.doubts))
    judgements = around.judge_all(case.plan)
    for trajectory, judged in zip(case.plan.trajectories, judgements, strict=True):
        part.body.append(element("h3", trajectory.name))
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
    measured = [judged.measures for judged in judgements if judged.measures is not None]
    verdicts = [verdict for judged in judgements for verdict in judged.verdicts]
    part.body.append(unseen("measures", measures_document(case.plan, measured, verdicts)))
    return part


def _ends(trajectory: Trajectory) -> list[str]:
    return [
        trajectory.name,
        place(trajectory.entry_mm),
        place(trajectory.target_mm),
        f"{trajectory.length_mm:.2f}",
    ]


def _measures(one: Measures) -> Rows:
    path = one.trajectory
    rows = [
        ("entry, LPS mm", place(path.entry_mm)),
        ("target, LPS mm", place(path.target_mm)),
        (
            "instrument",
            f"{path.instrument.name}, {path.instrument.diameter_mm:g} x {path.instrument.length_mm:g} mm",
        ),
    ]
    return [*rows, *shape_rows(one), *distance_rows(one), *error_rows(one)]


def _verdict(one: Verdict) -> list[str]:
    value, limit = value_and_limit(one)
    return [one.measure, value, limit, one.unit, "pass" if one.passes else "FAIL", one.remark]


def _fault(one: Verdict) -> str:
    return f"trajectory {one.trajectory}: {verdict_sentence(one)}"
