"""``ronnaplan study``: the Monte Carlo studies, on all cores or a Dask cluster."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ronnaplan.cli.values import whole
from ronnaplan.text import NOTICE

HELP = "Run a Monte Carlo study: its table goes to standard output, plots and results to a folder; resumable."


class Study(NamedTuple):
    """A sub-verb: its help, its own arguments, and the function that runs it."""

    help: str
    configure: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs and the arguments that all studies share."""
    studies = parser.add_subparsers(dest="study", metavar="STUDY", required=True)
    for name, study in STUDIES.items():
        sub = studies.add_parser(name, help=study.help, description=study.help, epilog=NOTICE)
        sub.add_argument(
            "-o",
            "--output",
            type=Path,
            default=Path(f"study-{name}"),
            metavar="FOLDER",
            help="results and plots; what an earlier run left there counts (default %(default)s)",
        )
        sub.add_argument(
            "--seed",
            type=whole(0),
            default=2018,
            metavar="N",
            help="the results depend on it and on nothing else (default %(default)s)",
        )
        sub.add_argument("--workers", type=whole(1), metavar="N", help="threads; default: all cores")
        sub.add_argument("--scheduler", metavar="ADDRESS", help="run on this Dask cluster (ronnaplan[cluster])")
        study.configure(sub)


def run(arguments: argparse.Namespace) -> int:
    """Run the chosen study."""
    return STUDIES[arguments.study].run(arguments)


def _configure_simulation(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--tests", type=whole(1), default=10_000, metavar="N", help="tests a cell (default %(default)s)"
    )
    parser.add_argument(
        "--protocol-only", action="store_true", help="leave out the cells beyond the paper's protocol"
    )


def _run_simulation(arguments: argparse.Namespace) -> int:
    from ronnaplan.studies.simulation import run_simulation
    from ronnaplan.studies.tables import tables

    by_cell = run_simulation(
        arguments.output,
        arguments.tests,
        arguments.seed,
        further=not arguments.protocol_only,
        workers=arguments.workers,
        scheduler=arguments.scheduler,
    )
    print(tables(by_cell))
    return 0


def _run_tracking(arguments: argparse.Namespace) -> int:
    from ronnaplan.studies.tracking import run_tracking, tracking_table

    results = run_tracking(
        arguments.output, arguments.seed, workers=arguments.workers, scheduler=arguments.scheduler
    )
    print(tracking_table(results))
    return 0


def _configure_chain(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--sessions", type=whole(1), default=400, metavar="N", help="sessions a scan (default %(default)s)"
    )


def _run_chain(arguments: argparse.Namespace) -> int:
    from ronnaplan.studies.chain import chain_table, run_chain

    rows = run_chain(
        arguments.output,
        arguments.sessions,
        arguments.seed,
        workers=arguments.workers,
        scheduler=arguments.scheduler,
    )
    print(chain_table(rows))
    return 0


def _no_arguments(_: argparse.ArgumentParser) -> None:
    """Add nothing to the shared arguments."""


STUDIES = {
    "simulation": Study(
        "Correspondence on simulated heads with outliers: the paper's 900,000 tests for both algorithms (Fig. 7).",
        _configure_simulation,
        _run_simulation,
    ),
    "tracking": Study(
        "Correspondence of 17 CT scans with 1,415 tracker readings of the x-shaped frame (Figs. 8 and 9).",
        _no_arguments,
        _run_tracking,
    ),
    "chain": Study(
        "From the CT of a phantom to a target in the robot's frame: predicted and observed error by source.",
        _configure_chain,
        _run_chain,
    ),
}
