"""The process that receives: it moves bytes, and loads nothing that draws, computes or decodes."""

from __future__ import annotations

import sys
import threading

from ronnaplan.errors import InputError
from ronnaplan.jobs.processes import end_with_parent
from ronnaplan.node.lean import load_pydicom


def main(config_path: str) -> int:
    """Receive until the parent process closes this one's standard input, or dies."""
    load_pydicom()
    from ronnaplan.node.config import read_config
    from ronnaplan.node.logs import Log
    from ronnaplan.node.receiver import Receiver

    log = Log(sys.stdout)
    receiver = Receiver(read_config(config_path), log)
    try:
        receiver.start()
    except InputError as error:
        log.tell("cannot receive", reason=str(error))
        return error.exit_status
    threading.Thread(target=receiver.serve, name="serve", daemon=True).start()
    end_with_parent()
    receiver.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
