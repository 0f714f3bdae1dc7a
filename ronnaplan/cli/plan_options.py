"""The arguments of each action of ``ronnaplan plan``."""

from __future__ import annotations

import argparse

from ronnaplan.cli.case_options import with_documents, with_rules, with_sigmas
from ronnaplan.cli.values import colour, number, whole
from ronnaplan.planning.lengths import (
    BASE_MM,
    ENTRIES,
    LEAST_APART_MM,
    LEAST_FROM_ENTRIES_MM,
    USUAL_DIAMETER_MM,
    VISIBLE_DEG,
)

SIDES = {
    "left": (1.0, 0.0, 0.0),
    "right": (-1.0, 0.0, 0.0),
    "posterior": (0.0, 1.0, 0.0),
    "anterior": (0.0, -1.0, 0.0),
    "superior": (0.0, 0.0, 1.0),
}
"""Directions from the head to the tracker, LPS."""

PLACES = {
    "entry": "the entry",
    "target": "the target",
    "ac": "the anterior commissure",
    "pc": "the posterior commissure",
    "midline": "a point of the midsagittal plane, well off the line through both",
}
"""What each option with coordinates is."""


def with_plan(parser: argparse.ArgumentParser) -> None:
    """Declare what every action on a plan needs."""
    parser.add_argument("plan", metavar="PLAN", help="the plan file")


def with_name(parser: argparse.ArgumentParser) -> None:
    """Declare what every action on a trajectory needs."""
    with_plan(parser)
    parser.add_argument("name", metavar="NAME", help="the trajectory's name")


def _with_scan(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--ct", required=True, metavar="PATH", help="the scan that the plan is tied to")
    parser.add_argument("--series", metavar="UID", help="the series to use, where PATH holds several")


def _with_place(parser: argparse._ActionsContainer, name: str, *, required: bool = False) -> None:
    parser.add_argument(
        f"--{name}",
        nargs=3,
        type=number,
        metavar=("X", "Y", "Z"),
        required=required,
        help=f"{PLACES[name]}, in mm",
    )


def _with_target(parser: argparse.ArgumentParser, *, required: bool) -> None:
    target = parser.add_mutually_exclusive_group(required=required)
    _with_place(target, "target")
    target.add_argument(
        "--target-acpc",
        nargs=3,
        type=number,
        metavar=("RIGHT", "ANTERIOR", "SUPERIOR"),
        help="the target from the mid-commissural point, in mm (negative: left, posterior, inferior)",
    )


def _with_coordinates(parser: argparse.ArgumentParser, *names: str, required: bool) -> None:
    for name in names:
        _with_place(parser, name, required=required)
    parser.add_argument(
        "--coordinates", choices=("LPS", "RAS"), required=required, help="the system of the coordinates given"
    )


def _with_instrument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--instrument", metavar="NAME", help="one of the catalogue, or a name of your own")
    parser.add_argument("--diameter", type=number, metavar="MM", help="diameter of an instrument of your own")
    parser.add_argument("--length", type=number, metavar="MM", help="usable length of an instrument of your own")


def _with_electrode(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--electrode", metavar="MODEL", help="the electrode that stays, its tip at the target ('none': none)"
    )


def _with_looks(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--colour", type=colour, metavar="#RRGGBB", help="colour in views")
    parser.add_argument("--notes", metavar="TEXT", help="free text")


def configure_new(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan new``."""
    parser.add_argument("ct", metavar="CT", help="the scan to plan on")
    parser.add_argument("--series", metavar="UID", help="the series to use, where CT holds several")
    parser.add_argument("-o", "--output", required=True, metavar="PLAN", help="the plan file to write")


def _with_trajectory(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Declare what makes a trajectory; whether its ends are ``required``."""
    with_name(parser)
    _with_scan(parser)
    _with_target(parser, required=required)
    _with_coordinates(parser, "entry", required=required)
    _with_instrument(parser)
    _with_electrode(parser)
    _with_looks(parser)


def configure_add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan add``."""
    _with_trajectory(parser, required=True)


def configure_edit(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan edit``."""
    _with_trajectory(parser, required=False)
    parser.add_argument("--rename", metavar="NAME", help="a new name")


def configure_landmarks(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan landmarks``."""
    with_plan(parser)
    _with_coordinates(parser, "ac", "pc", "midline", required=True)


def configure_list(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan list``."""
    with_plan(parser)
    parser.add_argument("--history", action="store_true", help="list the changes instead")


def configure_import(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan import``."""
    with_plan(parser)
    parser.add_argument("file", metavar="FILE", help="Slicer line markups (.mrk.json) or CSV")
    _with_scan(parser)
    _with_coordinates(parser, required=False)
    _with_instrument(parser)
    parser.add_argument("--first", choices=("entry", "target"), help="what an unlabelled line's first point is")


def configure_export(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan export``."""
    with_plan(parser)
    parser.add_argument(
        "--to",
        choices=("markups", "csv", "contacts"),
        required=True,
        help="Slicer line markups, CSV, or a CSV of the electrodes' contacts",
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="file to write (default: standard output)")


def configure_check(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan check``."""
    with_plan(parser)
    _with_scan(parser)
    with_documents(parser)
    with_rules(parser)
    parser.add_argument("-o", "--output", metavar="FILE", help="also write all measures and verdicts as JSON")


def configure_propose(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan propose``."""
    with_name(parser)
    _with_scan(parser)
    _with_target(parser, required=True)
    _with_coordinates(parser, required=False)
    _with_instrument(parser)
    with_documents(parser)
    with_rules(parser)
    parser.add_argument(
        "--count", type=whole(1), default=ENTRIES, metavar="N", help="proposals (default %(default)s)"
    )
    parser.add_argument("--add", action="store_true", help="add the best one to the plan")


def configure_markers(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan markers``."""
    parser.add_argument("--plan", metavar="PLAN", help="a plan whose targets count and whose entries stay free")
    _with_scan(parser)
    parser.add_argument("--count", type=whole(3), required=True, metavar="N", help="markers to place")
    parser.add_argument(
        "--target",
        nargs=3,
        type=number,
        action="append",
        metavar=("X", "Y", "Z"),
        help="another target; repeatable",
    )
    parser.add_argument("--coordinates", choices=("LPS", "RAS"), help="the system of the targets given")
    parser.add_argument("--tracker", choices=tuple(SIDES), help="side of the head on which the tracker stands")
    parser.add_argument(
        "--visible",
        type=number,
        metavar="DEG",
        help=f"how far a marker may lean away from it (default {VISIBLE_DEG:g})",
    )
    for name, default, text in (
        ("apart", LEAST_APART_MM, "least distance between markers"),
        ("from-entries", LEAST_FROM_ENTRIES_MM, "least distance from entries"),
        ("diameter", USUAL_DIAMETER_MM, "diameter of a marker"),
        ("base", BASE_MM, "height of its base and post above the scalp"),
    ):
        parser.add_argument(
            f"--{name}", type=number, default=default, metavar="MM", help=f"{text} (default %(default)s)"
        )
    with_sigmas(parser)
    parser.add_argument("--lowest", type=number, metavar="Z", help="no marker below this z (LPS mm)")
    parser.add_argument("-o", "--output", metavar="FILE", help="also write the markers as Slicer markups")
