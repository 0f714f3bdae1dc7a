"""``ronnaplan robot``: from the tracker to the robot; one module an action, ``ronnaplan.cli.robot_<action>``."""

from __future__ import annotations

import argparse
from importlib import import_module
from types import ModuleType

from ronnaplan.text import NOTICE

HELP = "Calibrate the robot's tools, follow the chain to the robot, and find where it shall stand."

ACTIONS = ("pivot", "hand-eye", "stereo-calibrate", "relocate", "chain", "watch", "place", "export")
"""Each has a module with ``HELP``, ``configure(parser)`` and ``run(arguments)``, like a verb."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the actions."""
    verbs = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for name in ACTIONS:
        module = _module(name)
        sub = verbs.add_parser(name, help=module.HELP, description=module.HELP, epilog=NOTICE)
        module.configure(sub)


def run(arguments: argparse.Namespace) -> int:
    """Run the chosen action."""
    status: int = _module(arguments.action).run(arguments)
    return status


def _module(name: str) -> ModuleType:
    return import_module(f"ronnaplan.cli.robot_{name.replace('-', '_')}")
