"""``ronnaplan schema``: the JSON Schema of a file, for other programs that read or write it."""

from __future__ import annotations

import argparse

HELP = (
    "Print the JSON Schema of fiducials, registration, plan, limits, measures, template, phantom_check, placement, "
    "room, pivot, hand_eye, rig, spheres, chain or robot_points."
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("name", metavar="NAME", help="one of these names")
    parser.add_argument("-o", "--output", metavar="FILE", help="where to write (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Write the schema."""
    from ronnaplan.documents.files import write_result
    from ronnaplan.documents.reading import plain_json
    from ronnaplan.documents.schemas import schema

    write_result(arguments.output, plain_json(schema(arguments.name)))
    return 0
