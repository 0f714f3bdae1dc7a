"""``ronnaplan pull``: scans from an archive."""

from __future__ import annotations

import argparse
import sys

HELP = "Fetch studies from an archive (C-FIND and C-GET, or DICOMweb) into a folder."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "--from",
        dest="peer",
        required=True,
        metavar="PEER",
        help="a peer's name in the configuration, TITLE@HOST:PORT, or an address of DICOMweb",
    )
    parser.add_argument("--config", metavar="FILE", help="node.toml: peers, this side's AE title, certificates")
    parser.add_argument("--study", default="", metavar="UID", help="the study's UID")
    parser.add_argument("--patient", default="", metavar="ID", help="the patient's ID")
    parser.add_argument("--date", default="", metavar="DATE", help="YYYYMMDD, or two of them with a - between")
    parser.add_argument("-o", "--output", required=True, metavar="FOLDER", help="where to write the instances")


def run(arguments: argparse.Namespace) -> int:
    """Fetch what is asked for."""
    from ronnaplan.errors import InputError

    try:
        from ronnaplan.node.config import Config, read_config
        from ronnaplan.node.pull import Wanted, peer_at, pull
    except ModuleNotFoundError as error:
        raise InputError(f"fetching needs {error.name}; install ronnaplan[node]") from error
    config = read_config(arguments.config) if arguments.config else Config()
    wanted = Wanted(arguments.study, arguments.patient, arguments.date)
    count = pull(config, peer_at(arguments.peer, config), wanted, arguments.output)
    print(f"{count} instances in {arguments.output}", file=sys.stderr)
    return 0
