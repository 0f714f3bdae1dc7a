"""What each action of ``ronnaplan plan`` does: read, call one library function, print or write."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from ronnaplan.cli.output import warn
from ronnaplan.cli.plan_options import SIDES, VISIBLE_DEG

if TYPE_CHECKING:
    from collections.abc import Callable

    from ronnaplan.ct import CTVolume
    from ronnaplan.geometry import FloatArray
    from ronnaplan.planning import Instrument, Plan


def run_new(arguments: argparse.Namespace) -> int:
    """Start a plan."""
    from ronnaplan.documents.plan import write_plan
    from ronnaplan.planning import Plan

    _require_none_lost(arguments.output)
    write_plan(arguments.output, Plan.of_scan(_volume(arguments)))
    return 0


def run_add(arguments: argparse.Namespace) -> int:
    """Add a trajectory."""
    from ronnaplan.planning import Trajectory

    entry_mm, target_mm = (_lps(place, arguments.coordinates) for place in (arguments.entry, arguments.target))
    instrument = _instrument(arguments) or Trajectory.instrument
    further = {"colour": arguments.colour or "", "notes": arguments.notes or "", **_electrode(arguments)}

    def add(plan: Plan) -> Plan:
        return plan.add(Trajectory(arguments.name, entry_mm, target_mm, plan.frame, instrument, **further))

    return _changed_in_head(arguments, add)


def run_edit(arguments: argparse.Namespace) -> int:
    """Change a trajectory."""
    from ronnaplan.errors import UsageError

    stated: dict[str, Any] = {
        "name": arguments.rename,
        "entry_mm": arguments.entry and _lps(arguments.entry, arguments.coordinates),
        "target_mm": arguments.target and _lps(arguments.target, arguments.coordinates),
        "instrument": _instrument(arguments),
        "colour": arguments.colour,
        "notes": arguments.notes,
    }
    changes = {key: value for key, value in stated.items() if value is not None} | _electrode(arguments)
    if not changes:
        raise UsageError(
            f"nothing is to be changed in {arguments.name}; give --entry, --target, --instrument, --electrode, "
            "--colour, --notes or --rename"
        )
    return _changed_in_head(arguments, lambda plan: plan.edit(arguments.name, **changes))


def run_remove(arguments: argparse.Namespace) -> int:
    """Remove a trajectory."""
    return _changed(arguments, lambda plan: plan.remove(arguments.name))


def run_lock(arguments: argparse.Namespace) -> int:
    """Lock or unlock a trajectory."""
    return _changed(arguments, lambda plan: plan.lock(arguments.name, arguments.action == "lock"))


def run_undo(arguments: argparse.Namespace) -> int:
    """Take a change back, or make it again."""
    return _changed(arguments, lambda plan: plan.undo() if arguments.action == "undo" else plan.redo())


def run_landmarks(arguments: argparse.Namespace) -> int:
    """State AC, PC and midline."""
    from ronnaplan.planning import Landmarks

    points = [_lps(place, arguments.coordinates) for place in (arguments.ac, arguments.pc, arguments.midline)]
    return _changed(arguments, lambda plan: plan.with_landmarks(Landmarks(*points)))


def run_list(arguments: argparse.Namespace) -> int:
    """List trajectories or changes."""
    from ronnaplan.planning.tables import history_list, plan_list

    plan = _plan(arguments)
    print(history_list(plan) if arguments.history else plan_list(plan))
    return 0


def run_import(arguments: argparse.Namespace) -> int:
    """Add trajectories from a file."""
    from ronnaplan.documents.plan_exchange import ENDINGS, read_line_markups, read_plan_table
    from ronnaplan.errors import UsageError
    from ronnaplan.planning import Trajectory

    is_markups = arguments.file.lower().endswith(ENDINGS["markups"])
    if arguments.first and not is_markups:
        raise UsageError("--first is of a line's points; a table names entry and target by its columns")
    plan = _plan(arguments)
    instrument = _instrument(arguments) or Trajectory.instrument
    if is_markups:
        read = read_line_markups(
            arguments.file, plan.frame, instrument, system=arguments.coordinates, first=arguments.first
        )
    else:
        read = read_plan_table(arguments.file, plan.frame, instrument, system=arguments.coordinates)

    def add_all(plan: Plan) -> Plan:
        for trajectory in read:
            plan = plan.add(trajectory)
        return plan

    return _changed_in_head(arguments, add_all)


def run_export(arguments: argparse.Namespace) -> int:
    """Write trajectories for other tools."""
    from ronnaplan.documents.files import require_ending, write_result
    from ronnaplan.documents.plan_exchange import ENDINGS, contacts_table, line_markups, plan_table

    if arguments.output is not None:
        require_ending(arguments.output, arguments.to, ENDINGS[arguments.to])
    writer = {"markups": line_markups, "csv": plan_table, "contacts": contacts_table}[arguments.to]
    write_result(arguments.output, writer(_plan(arguments)))
    return 0


def run_check(arguments: argparse.Namespace) -> int:
    """Measure every trajectory and hold it against the limits."""
    from ronnaplan.cli.case_options import read_named_case, unnamed_documents
    from ronnaplan.documents.plan_measures import measures_document
    from ronnaplan.errors import InputError
    from ronnaplan.planning.limits import all_pass
    from ronnaplan.planning.tables import measures_table, verdict_table

    case = read_named_case(arguments)
    assert case.plan is not None
    judged = case.surroundings.judge_all(case.plan)
    for one in judged:
        if one.problem:
            raise InputError(one.problem)
    measured = [one.measures for one in judged if one.measures is not None]
    verdicts = [verdict for one in judged for verdict in one.verdicts]
    if arguments.output:
        from ronnaplan.documents.files import write_atomically

        write_atomically(arguments.output, measures_document(case.plan, measured, verdicts))
    warn(*unnamed_documents(arguments), *case.surroundings.doubts)
    warn(*(f"{one.trajectory.name}: {doubt}" for one in measured for doubt in one.doubts))
    print(f"{measures_table(measured, case.surroundings.expected)}\n\n{verdict_table(verdicts)}")
    if not measured:
        warn("the plan holds no trajectories; nothing was checked")
    if all_pass(verdicts):
        return 0
    broken = sum(not verdict.passes for verdict in verdicts)
    print(f"ronnaplan: {broken} of {len(verdicts)} limits are broken", file=sys.stderr)
    return 3


def run_propose(arguments: argparse.Namespace) -> int:
    """Propose entries for a target."""
    from ronnaplan.cli.case_options import read_named_case, unnamed_documents
    from ronnaplan.errors import RefusedError
    from ronnaplan.planning import Trajectory
    from ronnaplan.planning.tables import proposals_table

    case = read_named_case(arguments)
    plan = case.plan
    assert plan is not None
    found = case.surroundings.propose(
        _lps(arguments.target, arguments.coordinates),
        plan,
        name=arguments.name,
        instrument=_instrument(arguments) or Trajectory.instrument,
        count=arguments.count,
    )
    warn(*unnamed_documents(arguments), *case.surroundings.doubts)
    print(proposals_table(found, case.surroundings.expected))
    if not found.best:
        raise RefusedError("no entry keeps every limit; loosen a limit or choose another target")
    if arguments.add:
        best = found.best[0].trajectory
        warn(*(f"{best.name}: {doubt}" for doubt in found.best[0].measures.doubts))

        def add(now: Plan) -> Plan:
            if now.revision != plan.revision:
                raise RefusedError("the plan was changed while entries were proposed; propose them again")
            return now.add(best)

        return _changed(arguments, add)
    return 0


def run_markers(arguments: argparse.Namespace) -> int:
    """Propose places for the markers."""
    from ronnaplan.case.surroundings import Rules, Surroundings, Terrain
    from ronnaplan.documents.files import write_atomically
    from ronnaplan.documents.plan_measures import placement_markups
    from ronnaplan.errors import UsageError
    from ronnaplan.planning import Plan
    from ronnaplan.planning.rows import placement_sentence
    from ronnaplan.planning.sites import PlacementRules
    from ronnaplan.planning.tables import placement_table

    if arguments.visible is not None and not arguments.tracker:
        raise UsageError("--visible is how far a marker may lean away from the tracker; it needs --tracker")
    volume = _scan_of_plan(arguments)
    plan = _plan(arguments) if arguments.plan else Plan.of_scan(volume)
    targets = [_lps(target, arguments.coordinates) for target in arguments.target or ()]
    names = [one.name for one in plan.trajectories] + [f"target {n + 1}" for n in range(len(targets))]
    rules = PlacementRules(
        diameter_mm=arguments.diameter,
        base_mm=arguments.base,
        least_apart_mm=arguments.apart,
        least_from_entries_mm=arguments.from_entries,
        tracker=SIDES[arguments.tracker] if arguments.tracker else None,
        visible_deg=VISIBLE_DEG if arguments.visible is None else arguments.visible,
        lowest_mm=arguments.lowest,
    )
    around = Surroundings(Terrain(volume), Rules(sigma_ct_mm=arguments.sigma_ct, sigma_ots_mm=arguments.sigma_ots))
    placed = around.place_markers(plan, arguments.count, rules, targets)
    warn(*around.doubts)
    print(f"{placement_table(placed, names)}\n{placement_sentence(placed)}")
    if arguments.output:
        write_atomically(arguments.output, placement_markups(placed))
    return 0


def _require_none_lost(path: str) -> None:
    """Raise `InputError` where a plan with trajectories lies at ``path``: its history would be lost with it."""
    from ronnaplan.documents.plan import read_plan
    from ronnaplan.errors import InputError

    try:
        count = len(read_plan(path).trajectories)
    except InputError:  # there is no plan
        return
    if count:
        raise InputError(
            f"{path} holds a plan of {count} {'trajectory' if count == 1 else 'trajectories'}, which would be lost; "
            "go on with it ('plan add'), name another file with -o, or delete it first"
        )


def _volume(arguments: argparse.Namespace) -> CTVolume:
    from ronnaplan.ct import read_ct

    return read_ct(arguments.ct, arguments.series, progress=True)


def _scan_of_plan(arguments: argparse.Namespace) -> CTVolume:
    """Read the scan and require that it is the plan's, if there is a plan."""
    volume = _volume(arguments)
    if arguments.plan:
        _plan(arguments).require_scan(volume)
    return volume


def _plan(arguments: argparse.Namespace) -> Plan:
    from ronnaplan.documents.plan import read_plan

    return read_plan(arguments.plan)


def _changed(arguments: argparse.Namespace, change: Callable[[Plan], Plan]) -> int:
    from ronnaplan.documents.plan import change_plan

    change_plan(arguments.plan, change)
    return 0


def _changed_in_head(arguments: argparse.Namespace, change: Callable[[Plan], Plan]) -> int:
    """Make a change to the plan if the ends that are new in it lie in the head; warn of what makes them doubtful."""
    from ronnaplan.case.edits import sound
    from ronnaplan.documents.plan import change_plan
    from ronnaplan.planning import Head
    from ronnaplan.planning.crossings import find_crossings
    from ronnaplan.planning.measures import entry_doubt
    from ronnaplan.planning.sides import side_doubt

    change(_plan(arguments))  # what is wrong without the scan is told before it is read
    head = Head.of(_scan_of_plan(arguments))
    changed = change_plan(arguments.plan, lambda plan: sound(plan, change(plan), head))
    for one in changed.trajectories:
        above = find_crossings(head, one.target_mm, -one.inward)
        doubts = (entry_doubt(one, above), side_doubt(one, head, changed.landmarks))
        warn(*(f"{one.name}: {doubt}" for doubt in doubts if doubt is not None))
    return 0


def _lps(place: list[float], system: str | None) -> FloatArray:
    import numpy as np

    from ronnaplan.documents.plan_exchange import to_lps
    from ronnaplan.errors import UsageError

    if system is None:
        raise UsageError("coordinates need --coordinates LPS or --coordinates RAS")
    return to_lps(np.array(place, dtype=np.float64), system)


def _electrode(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the electrode that was chosen by name, as a trajectory takes it; nothing where none was named."""
    from ronnaplan.planning.electrodes import electrode_chosen

    return {} if arguments.electrode is None else {"electrode": electrode_chosen(arguments.electrode)}


def _instrument(arguments: argparse.Namespace) -> Instrument | None:
    from ronnaplan.errors import UsageError
    from ronnaplan.planning import Instrument
    from ronnaplan.planning.trajectory import instrument_named

    if (arguments.diameter is None) != (arguments.length is None):
        raise UsageError("an instrument of your own needs both --diameter and --length")
    if arguments.diameter is not None:
        return Instrument(arguments.instrument or "instrument", arguments.diameter, arguments.length)
    return instrument_named(arguments.instrument) if arguments.instrument else None
