"""``ronnaplan node``: the DICOM node."""

from __future__ import annotations

import argparse
from pathlib import Path

from ronnaplan.extras import require_packages

HELP = "Run the DICOM node: take scans from scanners, find their markers, send the answers to the archive."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("--config", required=True, metavar="FILE", help="node.toml: peers, rules, limits")
    parser.add_argument("--init", action="store_true", help="write an annotated example to FILE and end")


def run(arguments: argparse.Namespace) -> int:
    """Run the node until it is told to stop."""
    import signal
    import threading

    path = Path(arguments.config)
    if arguments.init:
        from ronnaplan.documents.files import write_new
        from ronnaplan.node.config import EXAMPLE

        write_new(path, EXAMPLE)
        return 0
    require_packages("the node", "node", "pynetdicom", "highdicom", "dicomweb_client")
    from ronnaplan.node.hub import run_node
    from ronnaplan.node.logs import Log

    stop = threading.Event()
    # Ctrl-C, too: raised amid a pass it would end that where it is
    heeded = {one: signal.signal(one, lambda *_: stop.set()) for one in (signal.SIGINT, signal.SIGTERM)}
    try:
        run_node(path, stop, Log())
    finally:
        for one, handler in heeded.items():
            signal.signal(one, handler)
    return 0
