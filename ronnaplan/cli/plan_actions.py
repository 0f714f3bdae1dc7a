"""The actions of ``ronnaplan plan`` on a plan's file: begin, change, list and exchange it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from ronnaplan.cli.plan_inputs import (
    change_in_head,
    change_named,
    lps,
    read_named_plan,
    read_scan,
    require_places,
    stated_electrode,
    stated_instrument,
    stated_target,
)

if TYPE_CHECKING:
    from ronnaplan.planning import Plan


def run_new(arguments: argparse.Namespace) -> int:
    """Start a plan."""
    from ronnaplan.documents.plan import write_plan
    from ronnaplan.planning import Plan

    _require_none_lost(arguments.output)
    write_plan(arguments.output, Plan.of_scan(read_scan(arguments)))
    return 0


def run_add(arguments: argparse.Namespace) -> int:
    """Add a trajectory."""
    from ronnaplan.planning import Trajectory

    entry_mm, target = lps(arguments.entry, arguments.coordinates), stated_target(arguments)
    assert target is not None
    instrument = stated_instrument(arguments) or Trajectory.instrument
    further = {"colour": arguments.colour or "", "notes": arguments.notes or "", **stated_electrode(arguments)}

    def add(plan: Plan) -> Plan:
        return plan.add(Trajectory(arguments.name, entry_mm, target(plan), plan.frame, instrument, **further))

    return change_in_head(arguments, add)


def run_edit(arguments: argparse.Namespace) -> int:
    """Change a trajectory."""
    from ronnaplan.errors import UsageError

    require_places(arguments, "entry", "target")
    stated: dict[str, Any] = {
        "name": arguments.rename,
        "entry_mm": arguments.entry and lps(arguments.entry, arguments.coordinates),
        "instrument": stated_instrument(arguments),
        "colour": arguments.colour,
        "notes": arguments.notes,
    }
    changes = {key: value for key, value in stated.items() if value is not None} | stated_electrode(arguments)
    target = stated_target(arguments)
    if not changes and target is None:
        raise UsageError(
            f"nothing is to be changed in {arguments.name}; give --entry, --target, --target-acpc, --instrument, "
            "--electrode, --colour, --notes or --rename"
        )

    def edit(plan: Plan) -> Plan:
        placed = {} if target is None else {"target_mm": target(plan)}
        return plan.edit(arguments.name, **changes, **placed)

    return change_in_head(arguments, edit)


def run_remove(arguments: argparse.Namespace) -> int:
    """Remove a trajectory."""
    return change_named(arguments, lambda plan: plan.remove(arguments.name))


def run_lock(arguments: argparse.Namespace) -> int:
    """Lock or unlock a trajectory."""
    return change_named(arguments, lambda plan: plan.lock(arguments.name, arguments.action == "lock"))


def run_undo(arguments: argparse.Namespace) -> int:
    """Take a change back, or make it again."""
    return change_named(arguments, lambda plan: plan.undo() if arguments.action == "undo" else plan.redo())


def run_landmarks(arguments: argparse.Namespace) -> int:
    """State AC, PC and midline."""
    from ronnaplan.planning import Landmarks

    points = [lps(place, arguments.coordinates) for place in (arguments.ac, arguments.pc, arguments.midline)]
    return change_named(arguments, lambda plan: plan.with_landmarks(Landmarks(*points)))


def run_list(arguments: argparse.Namespace) -> int:
    """List trajectories or changes."""
    from ronnaplan.planning.tables import history_list, plan_list

    plan = read_named_plan(arguments)
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
    plan = read_named_plan(arguments)
    instrument = stated_instrument(arguments) or Trajectory.instrument
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

    return change_in_head(arguments, add_all)


def run_export(arguments: argparse.Namespace) -> int:
    """Write trajectories for other tools."""
    from ronnaplan.documents.files import require_ending, write_result
    from ronnaplan.documents.plan_exchange import ENDINGS, contacts_table, line_markups, plan_table

    if arguments.output is not None:
        require_ending(arguments.output, arguments.to, ENDINGS[arguments.to])
    writer = {"markups": line_markups, "csv": plan_table, "contacts": contacts_table}[arguments.to]
    write_result(arguments.output, writer(read_named_plan(arguments)))
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
