"""The actions of ``ronnaplan plan`` that judge: measures against limits, entries and marker places proposed."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ronnaplan.cli.output import tell, warn
from ronnaplan.cli.plan_inputs import (
    change_named,
    lps,
    read_named_plan,
    require_places,
    scan_of_plan,
    stated_instrument,
    stated_target,
)
from ronnaplan.cli.plan_options import SIDES

if TYPE_CHECKING:
    from ronnaplan.planning import Plan


def run_check(arguments: argparse.Namespace) -> int:
    """Measure every trajectory and hold it against the limits."""
    from ronnaplan.cli.case_options import read_named_case, unnamed_documents
    from ronnaplan.documents.plan_measures import measures_document
    from ronnaplan.errors import InputError
    from ronnaplan.planning.limits import all_pass
    from ronnaplan.planning.tables import measures_table, verdict_table

    case = read_named_case(arguments)
    assert case.plan is not None
    case.plan.require_trajectories("to check")
    judged = case.judgements
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
    if all_pass(verdicts):
        return 0
    broken = sum(not verdict.passes for verdict in verdicts)
    tell(f"ronnaplan: {broken} of {len(verdicts)} limits are broken")
    return 3


def run_propose(arguments: argparse.Namespace) -> int:
    """Propose entries for a target."""
    from ronnaplan.cli.case_options import read_named_case, unnamed_documents
    from ronnaplan.errors import RefusedError
    from ronnaplan.planning import Trajectory
    from ronnaplan.planning.tables import proposals_table

    require_places(arguments, "target")
    target = stated_target(arguments)
    assert target is not None
    case = read_named_case(arguments)
    plan = case.plan
    assert plan is not None
    found = case.surroundings.propose(
        target(plan),
        plan,
        name=arguments.name,
        instrument=stated_instrument(arguments) or Trajectory.instrument,
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

        return change_named(arguments, add)
    return 0


def run_markers(arguments: argparse.Namespace) -> int:
    """Propose places for the markers."""
    from ronnaplan.case.surroundings import Rules, Surroundings, Terrain
    from ronnaplan.documents.files import check_target, write_atomically
    from ronnaplan.documents.plan_measures import placement_markups
    from ronnaplan.documents.registration_made import target_names
    from ronnaplan.errors import UsageError
    from ronnaplan.planning import Plan
    from ronnaplan.planning.lengths import VISIBLE_DEG
    from ronnaplan.planning.rows import placement_sentence
    from ronnaplan.planning.sites import PlacementRules
    from ronnaplan.planning.tables import placement_table

    if arguments.visible is not None and not arguments.tracker:
        raise UsageError("--visible is how far a marker may lean away from the tracker; it needs --tracker")
    require_places(arguments, "target")
    if arguments.output:
        check_target(arguments.output)
    volume = scan_of_plan(arguments)
    plan = read_named_plan(arguments) if arguments.plan else Plan.of_scan(volume)
    targets = [lps(target, arguments.coordinates) for target in arguments.target or ()]
    names = [*(one.name for one in plan.trajectories), *target_names(len(targets))]
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
    low = [f"{placed.doubt}, or leave out what lies lower than you want (--lowest Z)"] if placed.doubt else []
    warn(*around.doubts, *low)
    print(f"{placement_table(placed, names)}\n{placement_sentence(placed)}")
    if arguments.output:
        write_atomically(arguments.output, placement_markups(placed))
    return 0
