"""The report's trajectories: cuts, measures, distances, and what is wrong with a path.

Of many other trajectories beside one the nearest are listed, and what is wrong with two is told once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from ronnaplan.case.folder import Case
from ronnaplan.ct import CTVolume
from ronnaplan.documents.plan_measures import measures_document
from ronnaplan.planning import Measures, Trajectory, Verdict
from ronnaplan.planning.contacts import ContactMeasures
from ronnaplan.planning.limits import is_near
from ronnaplan.planning.rows import (
    Rows,
    coordinates,
    distance_rows,
    error_values,
    errors_by_basis,
    shape_rows,
    value_and_limit,
    verdict_sentence,
)
from ronnaplan.report.html import Part, element, picture, table, unseen
from ronnaplan.report.path_cuts import path_picture
from ronnaplan.text import abridged, isolated, told_apart

STYLE = """
.beside { display: flex; flex-wrap: wrap; gap: 0 2.5rem; align-items: start } .beside p { max-width: 26rem }
.beside > * { max-width: 100% }
@media print {
  .path { font-size: 8.5pt } .path + .measured, h2:has(+ .measured) { break-before: page }
  .beside { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 0 1.5rem }
  .path th, .path td { padding: 0 .6rem 0 0 }
  .path:has(.limits tr:nth-child(25)) img { max-height: 62mm }
  .beside:has(.contacts) { font-size: 7pt }
  .limits, .contacts { grid-column: 1 / -1; columns: 2; column-gap: .7rem; font-size: 7pt; margin-top: .3rem }
  :is(.limits, .contacts) table { width: 100%; margin: 0; break-inside: auto }
  .contacts:not(:has(tr:nth-child(9))) table { break-inside: avoid } /* few rows stay below their head */
  :is(.limits, .contacts) :is(th, td) { padding-right: .25rem }
}
"""

TITLE = "Trajectories"
ENDS = ("", "entry LPS mm", "target LPS mm", "length mm")
ERRORS = ("expected error", "as planned", "as registered")
CONTACTS = ("no.", "contact, LPS mm", "depth, mm", "inside", "nearest, mm")
VERDICTS = ("held against limits", "value", "limit", "verdict", "")

NEAREST = 20
"""So many others are listed whatever their distance; who breaks a limit, or nearly so, always is."""


def paths_part(case: Case) -> Part:
    """Judge and draw every trajectory of the plan in the scan, and hold what `plan check` writes of them."""
    if case.plan is None or not case.plan.trajectories:
        return Part(TITLE)
    if case.volume is None:
        return Part(TITLE, [table(ENDS, map(_ends, case.plan.trajectories))])
    pieces: list[str] = []
    part = Part(TITLE, pieces, list(case.surroundings.doubts))
    told: set[frozenset[str]] = set()
    for trajectory, judged in zip(case.plan.trajectories, case.judgements, strict=True):
        body, look = [element("h3", isolated(trajectory.name))], "path"
        if judged.problem:
            part.warnings.append(f"trajectory {trajectory.name} could not be judged: {judged.problem}")
            body.append(element("p", f"could not be judged: {judged.problem}", "fail"))
        if judged.measures is None:
            body.append(table(ENDS, [_ends(trajectory)]))
        else:
            look = "path measured"
            body += _measured(case.volume, judged.measures, judged.verdicts)
            part.warnings.extend(f"trajectory {trajectory.name}: {doubt}" for doubt in judged.doubts)
            part.warnings.extend(map(_fault, _faults(judged.measures, judged.broken, told)))
        pieces.append(f'<div class="{look}">{"".join(body)}</div>')
    measured = [judged.measures for judged in case.judgements if judged.measures is not None]
    verdicts = [verdict for judged in case.judgements for verdict in judged.verdicts]
    pieces.append(unseen("measures", measures_document(case.plan, measured, verdicts, indent=None)))
    return part


def _measured(volume: CTVolume, one: Measures, verdicts: Sequence[Verdict]) -> list[str]:
    """Return the picture, and the tables of what was measured and judged; broken limits stand first.

    On paper the tables stand two beside each other, and limits and contacts in two columns each, so that a path with
    many limits and the contacts of its electrode fits a page.
    """
    name = one.trajectory.name
    drawn = picture(
        path_picture(volume, one), f"{abridged(name)}: two cuts along the path, at right angles; HU along it"
    )
    judged = sorted(_with_far_ones_gathered(one, verdicts), key=lambda verdict: verdict.passes)
    distances = [] if verdicts else _nearest_rows(one)  # every verdict tells its distance
    beside = table([], [*_path(one.trajectory), *shape_rows(one), *distances]) + _errors(one)
    if judged:
        beside += f'<div class="limits">{table(VERDICTS, _judged(judged))}</div>'
    if one.contacts:
        beside += f'<div class="contacts">{table(CONTACTS, _contacts(one.contacts))}</div>'
    return [drawn, f'<div class="beside">{beside}</div>']


def _contacts(contacts: Sequence[ContactMeasures]) -> list[list[str]]:
    shown = told_apart(near.name for one in contacts for near in one.clearances)
    return [_contact(one, shown) for one in contacts]


def _contact(one: ContactMeasures, shown: Mapping[str, str]) -> list[str]:
    nearest = min(one.clearances, key=lambda near: near.at_least_mm, default=None)
    told = "-" if nearest is None else f"{nearest.clearance_mm:.2f} to {isolated(shown[nearest.name])}"
    inside = {True: "yes", False: "no", None: "-"}[one.inside]
    return [str(one.number), coordinates(one.center_mm), f"{one.depth_mm:.2f}", inside, told]


def _errors(one: Measures) -> str:
    """Return the expected error as planned and as registered beside each other."""
    found = errors_by_basis(one)
    columns = [dict(error_values(error)) if error else {} for error in found]
    if not any(columns):
        return ""
    names = dict.fromkeys(name for column in columns for name in column)
    rows = [(name, *(column.get(name, "-") for column in columns)) for name in names]
    resting = "; ".join(f"as {error.expected.basis}: {error.expected.rests_on}" for error in found if error)
    return f"<div>{table(ERRORS, rows)}{element('p', resting, 'note')}</div>"


def _ends(trajectory: Trajectory) -> list[str]:
    return [
        isolated(trajectory.name),
        coordinates(trajectory.entry_mm),
        coordinates(trajectory.target_mm),
        f"{trajectory.length_mm:.2f}",
    ]


def _path(path: Trajectory) -> Rows:
    instrument = f"{path.instrument.name}, {path.instrument.diameter_mm:g} x {path.instrument.length_mm:g} mm"
    return [
        ("entry, LPS mm", coordinates(path.entry_mm)),
        ("target, LPS mm", coordinates(path.target_mm)),
        ("instrument", instrument),
        *([("electrode, its tip at the target", path.electrode.name)] if path.electrode else []),
        *([("notes", path.notes)] if path.notes else []),
    ]


def _judged(verdicts: Sequence[Verdict]) -> list[list[str]]:
    shown = told_apart(one.measure for one in verdicts)
    return [_verdict(one, shown[one.measure]) for one in verdicts]


def _verdict(one: Verdict, measure: str) -> list[str]:
    value, limit = value_and_limit(one)
    return [
        measure,
        value,
        f"{limit} {one.unit}".rstrip(),
        "pass" if one.passes else "FAIL",
        one.remark,
    ]


def _fault(one: Verdict) -> str:
    return f"trajectory {one.trajectory}: {verdict_sentence(one)}"


def _with_far_ones_gathered(one: Measures, verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Return the verdicts on a trajectory, those on others that are far from it as one: that on their nearest."""
    named = _others(one)
    on_others = [verdict for verdict in verdicts if (verdict.measure, verdict.value) in named]
    on_others.sort(key=lambda verdict: verdict.value or 0.0)
    far = [verdict for verdict in on_others[NEAREST:] if verdict.passes and not is_near(verdict)]
    if len(far) < 2:
        return list(verdicts)
    left_out = set(far)
    kept = [verdict for verdict in verdicts if verdict not in left_out]
    return [*kept, replace(far[0], measure=_called(len(far)), remark="the nearest of them")]


def _nearest_rows(one: Measures) -> Rows:
    """Return how near a trajectory comes to obstacles and to the nearest others, where no limit could be held."""
    by_distance = sorted(one.spacings, key=lambda near: near.clearance_mm)
    far = by_distance[NEAREST:]
    if len(far) < 2:
        return distance_rows(one)
    left_out = set(far)
    kept = tuple(near for near in one.spacings if near not in left_out)
    least = f"{far[0].clearance_mm:.2f} mm, the nearest of them"
    return [*distance_rows(replace(one, spacings=kept)), (_called(len(far)), least)]


def _faults(one: Measures, broken: Sequence[Verdict], told: set[frozenset[str]]) -> Iterator[Verdict]:
    """Yield what is ``broken`` of a trajectory; of two that come too near to each other once, as ``told`` keeps."""
    named = _others(one)
    for verdict in broken:
        other = named.get((verdict.measure, verdict.value))
        pair = frozenset((verdict.trajectory, other)) if other is not None else None
        if pair is None or pair not in told:
            yield verdict
        if pair is not None:
            told.add(pair)


def _others(one: Measures) -> dict[tuple[str, float | None], str]:
    """Return the other trajectories by measure and value of the verdicts on them."""
    return {(f"distance to {called}", near.clearance_mm): near.other for called, near in one.named_spacings}


def _called(count: int) -> str:
    return f"distance to {count} others"
