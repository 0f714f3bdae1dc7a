"""``ronnaplan pull``: scans from an archive."""

from __future__ import annotations

import argparse

from ronnaplan.cli.output import ended_gently, tell
from ronnaplan.cli.peers import PEER, peer_of, with_config
from ronnaplan.cli.values import whole
from ronnaplan.text import counted

HELP = "Fetch studies from an archive (C-FIND with C-GET or C-MOVE, or DICOMweb) into a folder or straight to localize."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "--from",
        dest="peer",
        required=True,
        metavar="PEER",
        help=PEER,
    )
    with_config(parser)
    parser.add_argument("--study", default="", metavar="UID", help="the study's UID")
    parser.add_argument("--patient", default="", metavar="ID", help="the patient's ID")
    parser.add_argument("--date", default="", metavar="DATE", help="YYYYMMDD, or two of them with a - between")
    parser.add_argument(
        "--by",
        choices=["get", "move"],
        help="C-GET or C-MOVE (default: C-GET where the archive offers it); for C-MOVE it must know our title and port",
    )
    parser.add_argument(
        "--port", type=whole(1, 65_535), help="where C-MOVE brings the instances (default: the configuration's)"
    )
    parser.add_argument("-o", "--output", metavar="FOLDER", help="where to write the instances")
    parser.add_argument(
        "--localize",
        nargs=argparse.REMAINDER,
        metavar="OPTION",
        help="find the markers of what was fetched; all that follows are options of 'ronnaplan localize'",
    )


@ended_gently()
def run(arguments: argparse.Namespace) -> int:
    """Fetch what is asked for."""
    import tempfile

    from ronnaplan.cli import parse
    from ronnaplan.errors import UsageError

    if arguments.output is None and arguments.localize is None:
        raise UsageError("nothing says what is to become of the scan; name a folder with -o, or --localize it")
    with tempfile.TemporaryDirectory() as made:
        folder = arguments.output or made
        then = None if arguments.localize is None else parse(["localize", folder, *arguments.localize])
        count = _fetch(arguments, folder)
        tell(counted(count, "instance") + ("" if arguments.output is None else f" in {folder}"))
        return 0 if then is None else int(then.run(then))


def _fetch(arguments: argparse.Namespace, folder: str) -> int:
    config, peer = peer_of(arguments)
    from ronnaplan.node.pull import Wanted, pull

    if arguments.port is not None:
        config = config.model_copy(update={"port": arguments.port})
    wanted = Wanted(arguments.study, arguments.patient, arguments.date)
    return pull(config, peer, wanted, folder, by=arguments.by)
