"""``ronnaplan export``: a result in another tool's format."""

from __future__ import annotations

import argparse

HELP = "Turn fiducials or a registration into Slicer markups, CSV, DICOM or an ITK transform."
FORMATS = ("markups", "csv", "dicom", "itk")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("file", metavar="FILE", help="a fiducials.json or registration.json")
    parser.add_argument("--to", required=True, choices=FORMATS, help="the format to write")
    parser.add_argument(
        "--ct", metavar="PATH", help="the scan whose patient and study a DICOM object is to name (default: none)"
    )
    parser.add_argument("-o", "--output", metavar="OUT", help="file to write (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Export ``arguments.file``."""
    from ronnaplan.documents.export import export
    from ronnaplan.documents.files import write_atomically, write_result
    from ronnaplan.errors import UsageError

    exported = export(arguments.file, arguments.to, arguments.ct)
    if isinstance(exported, str):
        write_result(arguments.output, exported)
    elif arguments.output is None:
        raise UsageError("a DICOM object is not text; name its file with -o")
    else:
        write_atomically(arguments.output, exported)
    return 0
