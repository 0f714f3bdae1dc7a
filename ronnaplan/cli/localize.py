"""``ronnaplan localize``: the markers of a scan, as fiducials.json."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ronnaplan.localization import Fiducials

HELP = "Find the spherical markers of a CT and write their centres with covariances."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("path", metavar="PATH", help="a DICOM folder, file or zip archive, or an image file")
    parser.add_argument("--diameter", type=float, required=True, metavar="MM", help="diameter of the markers")
    parser.add_argument("--expected", type=int, metavar="N", help="refuse (exit 3) unless N markers are found")
    parser.add_argument("--series", metavar="UID", help="the series to use, where PATH holds several")
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="fiducials.json to write (default: standard output)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Localize the markers below ``arguments.path``."""
    from ronnaplan.ct import read_ct
    from ronnaplan.documents.fiducials import fiducials_document, to_json
    from ronnaplan.documents.files import write_result
    from ronnaplan.localization import check_request, localize

    check_request(arguments.diameter, arguments.expected)
    volume = read_ct(arguments.path, arguments.series, progress=True)
    found = localize(volume, diameter_mm=arguments.diameter, expected=arguments.expected)
    for flag in volume.flags:
        print(f"ronnaplan: warning: {flag}", file=sys.stderr)
    print(_summary(found), file=sys.stderr)
    write_result(arguments.output, to_json(fiducials_document(found)))
    return 0


def _summary(found: Fiducials) -> str:
    from ronnaplan.report.tables import fiducials_table

    count = f"{len(found)} markers of {found.diameter_mm:g} mm; {len(found.rejected)} candidates rejected"
    return f"{fiducials_table(found)}\n{count}" if len(found) else count
