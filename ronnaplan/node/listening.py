"""The process that receives and delivers: it moves bytes, and loads nothing that draws, computes or decodes."""

from __future__ import annotations

import sys
import threading
import warnings

from ronnaplan.errors import InputError
from ronnaplan.jobs.processes import end_with_parent
from ronnaplan.node.lean import load_pydicom


def main(config_path: str) -> int:
    """Receive and deliver until the parent process closes this one's standard input, or dies."""
    warnings.simplefilter("ignore")  # of what peers send the log tells, and its lines are JSON
    load_pydicom()
    from ronnaplan.node.config import read_config
    from ronnaplan.node.logs import Log
    from ronnaplan.node.receiver import Receiver
    from ronnaplan.node.sender import senders_of

    log, config = Log(sys.stdout), read_config(config_path)
    receiver, senders = Receiver(config, log), senders_of(config, log)
    try:
        receiver.start()
    except InputError as error:
        log.tell("cannot receive", reason=str(error))
        return error.exit_status
    threading.Thread(target=receiver.serve, name="serve", daemon=True).start()
    for sender in senders:
        sender.start()
    end_with_parent()
    receiver.stop()
    for sender in senders:
        sender.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
