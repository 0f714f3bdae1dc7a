"""``ronnaplan cohort``: the markers of all series below roots, on this machine or a Dask cluster."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from ronnaplan.cli.output import ended_gently, tell
from ronnaplan.cli.values import whole

if TYPE_CHECKING:
    from ronnaplan.cohort.cohort import Counts

HELP = "Find the markers of every series below roots, resumably: tables of markers and series, and a page."
MOST_SHOWN = 5


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "roots", nargs="*", metavar="ROOT", help="a folder, zip archive, DICOMDIR or URL (s3://, gs:// ...)"
    )
    parser.add_argument("-o", "--output", metavar="OUT", help="folder of index, tables, page and results")
    parser.add_argument("--rules", metavar="FILE", help="rules.toml: what is looked for in which series")
    parser.add_argument("--init", action="store_true", help="write annotated example rules to FILE and end")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="ADDRESS", help="work on the Dask cluster of this scheduler")
    where.add_argument("--workers", type=whole(1, 1024), metavar="N", help="processes here; default: all cores")
    parser.add_argument("--as-listed", action="store_true", help="take the last listing, look at no root")
    parser.add_argument("--again", action="store_true", help="try once more what was set aside")


@ended_gently()
def run(arguments: argparse.Namespace) -> int:
    """Run the cohort, or write example rules."""
    from ronnaplan.errors import UsageError

    if arguments.init:
        return _init(arguments)
    if arguments.output is None or (not arguments.roots and not arguments.as_listed):
        raise UsageError("a ROOT and -o OUT are needed; --rules FILE --init writes example rules")
    from ronnaplan.cohort.places import is_url

    if is_url(arguments.output):
        raise UsageError(f"-o {arguments.output} is a URL; name a folder of this machine, and copy it there then")
    from tqdm.contrib.logging import logging_redirect_tqdm

    from ronnaplan.cohort.cohort import run_cohort
    from ronnaplan.cohort.rules import Rules, read_rules

    rules = Rules() if arguments.rules is None else read_rules(arguments.rules)
    with logging_redirect_tqdm([logging.getLogger("ronnaplan")]):  # warnings are shown, above the bar
        counts = run_cohort(
            arguments.roots,
            Path(arguments.output),
            rules,
            scheduler=arguments.scheduler,
            workers=arguments.workers,
            list_roots=not arguments.as_listed,
            again=arguments.again,
            progress=True,
        )
    tell(_told(counts, arguments.output))
    return 0


def _init(arguments: argparse.Namespace) -> int:
    from ronnaplan.cohort.rules import EXAMPLE
    from ronnaplan.documents.files import write_new
    from ronnaplan.errors import UsageError

    if arguments.rules is None:
        raise UsageError("--init needs --rules FILE, the file to write")
    run = ("roots", "output", "scheduler", "workers", "as_listed", "again")
    if any(getattr(arguments, name) for name in run):
        raise UsageError("--init writes --rules FILE and lists nothing; leave all else out")
    write_new(arguments.rules, EXAMPLE)
    return 0


def _told(counts: Counts, out: str) -> str:
    from ronnaplan.text import counted

    listed = counts.listed
    lines = [f"not looked at: {one}" for one in listed.skipped[:MOST_SHOWN]]
    if len(listed.skipped) > MOST_SHOWN:
        lines.append(f"and {len(listed.skipped) - MOST_SHOWN} more")
    lines += [f"no series goes by the rule '{name}'" for name in counts.idle_rules]
    if listed.files:
        files = counted(listed.files, "file")
        lines.append(f"{files}, {listed.changed} of them new, changed or not read before")
    lines.append(
        f"{counts.worked} series worked on; in all {counts.done} done, {counts.refused} refused, {counts.unusable} "
        f"unusable, {counts.aside} set aside, {counts.left} that no rule fits: {Path(out) / 'index.html'}"
    )
    return "\n".join(lines)
