"""The node as it is, but for its workers: those of `tests.node.killed_work`."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path

from ronnaplan.node.hub import run_node
from ronnaplan.node.logs import Log

if __name__ == "__main__":
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    run_node(Path(sys.argv[1]), stop, Log(), "tests.node.killed_work")
