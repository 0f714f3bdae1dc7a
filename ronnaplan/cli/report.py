"""``ronnaplan report``: what was found in a case and how far it can be trusted, on one page or in a table."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ronnaplan.cli.case_options import USUAL_PAPER, rules, with_paper, with_rules
from ronnaplan.cli.output import warn

if TYPE_CHECKING:
    from ronnaplan.case.folder import Case
    from ronnaplan.report.overview import View
    from ronnaplan.report.quality import Paper

HELP = "Write the quality report of a case as one HTML page or a PDF, or its trajectories' measures as CSV."
ENDINGS = (".html", ".pdf", ".csv")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "case", metavar="CASE", help="a folder with fiducials.json, registration.json and plan.json, any of them"
    )
    parser.add_argument("--ct", metavar="PATH", help="the scan (default: CASE/ct, or the images in CASE)")
    parser.add_argument("--series", metavar="UID", help="the series to use, where there are several")
    with_rules(parser)
    parser.add_argument("--name", metavar="TEXT", help="what the case is called (default: as its folder)")
    with_paper(parser)
    parser.add_argument(
        "-o", "--output", required=True, metavar="FILE", help="report.html, report.pdf or measures.csv"
    )


def run(arguments: argparse.Namespace) -> int:
    """Read the case and write its report."""
    from ronnaplan.case.folder import CaseFiles, read_case, read_scan
    from ronnaplan.documents.files import check_target, write_atomically
    from ronnaplan.errors import UsageError
    from ronnaplan.text import printable

    kind = Path(arguments.output).suffix.lower()
    if kind not in ENDINGS:
        raise UsageError(f"the report was to be written to {arguments.output}; give a name in .html, .pdf or .csv")
    if arguments.paper and kind == ".csv":
        raise UsageError(
            "a table of measures is printed on no paper; leave out --paper, or give a name in .html or .pdf"
        )
    check_target(arguments.output)
    files = CaseFiles.of_folder(arguments.case)
    if arguments.limits:
        files = replace(files, limits=Path(arguments.limits))
    case = read_case(
        files,
        lambda: read_scan(arguments.case, arguments.ct, arguments.series, progress=True),
        rules(arguments),
        arguments.no_go,
    )
    name = printable(Path(arguments.case).resolve().name if arguments.name is None else arguments.name)
    write_atomically(arguments.output, _content(case, name, kind, arguments.paper or USUAL_PAPER))
    return 0


def _content(case: Case, name: str, kind: str, paper: Paper) -> str | bytes:
    from ronnaplan.report.measures_file import measures_csv
    from ronnaplan.report.pdf import print_pdf
    from ronnaplan.report.quality import quality_report

    if kind == ".csv":
        return measures_csv(case, name)
    printed = kind == ".pdf"
    html = quality_report(case, name, _seen(case), turns=not printed, paper=paper)
    return print_pdf(html) if printed else html


def _seen(case: Case) -> View | None:
    """Return what there is to see of the case in 3-D; None without its scan, or where it cannot be made."""
    from ronnaplan.errors import InputError
    from ronnaplan.report.overview import view_of

    if case.volume is None:
        warn("the scan is not at hand, so that the report shows and measures nothing in it; give it with --ct")
        return None
    try:
        return view_of(case)
    except InputError as error:
        warn(f"the report shows no head in 3-D: {error}")
        return None
