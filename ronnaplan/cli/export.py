"""``ronnaplan export``: a result in another tool's format."""

from __future__ import annotations

import argparse

HELP = "Turn a fiducials document into Slicer markups or CSV."
FORMATS = ("markups", "csv")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("file", metavar="FILE", help="a fiducials.json")
    parser.add_argument("--to", required=True, choices=FORMATS, help="the format to write")
    parser.add_argument("-o", "--output", metavar="OUT", help="file to write (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Export ``arguments.file``."""
    from ronnaplan.documents.export import export
    from ronnaplan.documents.files import write_result

    write_result(arguments.output, export(arguments.file, arguments.to))
    return 0
