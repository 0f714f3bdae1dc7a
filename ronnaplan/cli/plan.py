"""``ronnaplan plan``: trajectories in a plan file, measures and limits, entry proposals, marker places."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NamedTuple

from ronnaplan.cli import plan_actions as actions
from ronnaplan.cli import plan_checks as checks
from ronnaplan.cli import plan_options as options
from ronnaplan.cli import plan_template
from ronnaplan.text import NOTICE

HELP = "Plan trajectories, check them against limits, propose entries and marker places."


class Action(NamedTuple):
    """A sub-verb: its help, its own arguments, and the function that runs it."""

    help: str
    configure: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    verbs = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for name, action in ACTIONS.items():
        sub = verbs.add_parser(name, help=action.help, description=action.help, epilog=NOTICE)
        action.configure(sub)


def run(arguments: argparse.Namespace) -> int:
    """Run the chosen sub-verb."""
    return ACTIONS[arguments.action].run(arguments)


ACTIONS = {
    "new": Action("Start an empty plan on a scan.", options.configure_new, actions.run_new),
    "add": Action("Add a trajectory.", options.configure_add, actions.run_add),
    "edit": Action("Change a trajectory.", options.configure_edit, actions.run_edit),
    "remove": Action("Remove a trajectory.", options.with_name, actions.run_remove),
    "lock": Action("Lock a trajectory against change.", options.with_name, actions.run_lock),
    "unlock": Action("Unlock a trajectory.", options.with_name, actions.run_lock),
    "undo": Action("Take the last change back.", options.with_plan, actions.run_undo),
    "redo": Action("Make the change again that was taken back last.", options.with_plan, actions.run_undo),
    "landmarks": Action("State AC, PC and a midline point.", options.configure_landmarks, actions.run_landmarks),
    "list": Action("List the trajectories, or the changes.", options.configure_list, actions.run_list),
    "import": Action(
        "Add trajectories from Slicer line markups or CSV.", options.configure_import, actions.run_import
    ),
    "export": Action(
        "Write the trajectories as Slicer line markups or CSV.", options.configure_export, actions.run_export
    ),
    "check": Action(
        "Measure all trajectories; exit 3 when a limit is broken.", options.configure_check, checks.run_check
    ),
    "propose": Action("Propose entries for a target.", options.configure_propose, checks.run_propose),
    "markers": Action("Propose places for the markers.", options.configure_markers, checks.run_markers),
    "template": Action(plan_template.HELP, plan_template.configure, plan_template.run),
}
