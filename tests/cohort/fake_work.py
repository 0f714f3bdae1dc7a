"""A child for tests: does with each series what its UID asks for, and notes in ``FAKE_LOG`` that it began."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

from ronnaplan.errors import RefusedError
from ronnaplan.jobs.serving import DONE, Tell, serve


def work(order: dict[str, Any], tell: Tell) -> None:
    uid = order["series_uid"]
    with Path(os.environ["FAKE_LOG"]).open("a") as log:
        log.write(f"{uid}\n")
    # no line of its own, as of a progress bar
    os.write(1, b"what a library written in C prints\n0.5")
    what = uid.rpartition(".")[2]
    if what == "1":
        time.sleep(600)
    if what == "2":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "3":
        bytearray(1 << 30)
    if what == "4":
        raise RefusedError("nothing of it is left")
    if what == "5":
        raise KeyError("a fault of ours")
    if "FAKE_OUTAGE" in os.environ:
        from ronnaplan.cohort.work import GONE  # only here: it takes six times as long to load as all else

        tell("ended", job=order["job"], state=GONE, reason="its disk is not there")
        return
    time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
    content = "".join(name for _, name, _ in order["files"])
    if order["known"].get(uid) == content:
        tell("part", job=order["job"], number=1, key=uid, state="unchanged", reason="", content=content, scan={})
    else:
        marker = {
            "label": "F1",
            "center": [float(what), len(order["files"]), 0.0],
            "covariance": [[1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-6]],
            **{
                "diameter_mm": order["rule"]["diameters"][0],
                "contrast_hu": 1000.0,
                "misfit": 0.01,
                "coverage": 1.0,
            },
            "flags": [],
        }
        told = {"found": 1, "expected": None, "markers": [marker], "rejected": [], "fiducials": "{}\n"}
        part = {"number": 1, "key": uid, "state": "done", "reason": "", "content": content, **told}
        part["scan"] = {"scan_flags": ["unreadable_files"] * order["troubled"]}
        tell("part", job=order["job"], **part)
    tell("ended", job=order["job"], state=DONE, reason="", peak_bytes=1)


if __name__ == "__main__":
    sys.exit(serve(int(sys.argv[1]), lambda: None, work))
