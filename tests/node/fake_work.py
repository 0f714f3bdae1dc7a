"""A worker for tests: does with each order what its series is known for."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from pathlib import Path

from ronnaplan.jobs.processes import end_with_parent
from ronnaplan.portable import limit_memory


def tell(**facts: object) -> None:
    print(json.dumps(facts), flush=True)


def obey(line: str) -> None:
    order = json.loads(line)  # `Order` takes four times as long to load as all else
    job, output, kind = order["job"], Path(order["output"]), Path(order["folder"]).name
    if kind == "1.4.1":
        time.sleep(600)
    if kind == "1.4.2":
        os._exit(7)
    if kind == "1.4.3":
        try:
            tell(event="ended", job=job, state="done", reason=f"{len(bytearray(1 << 30))} bytes")
        except MemoryError as error:
            tell(event="ended", job=job, state="broken", reason=f"too much memory {error}")
    elif kind == "1.4.4":
        tell(event="ended", job=job, state="refused", reason="no marker")
    elif (Path(order["home"]) / "full").exists():
        tell(event="ended", job=job, state="broken", reason="no room", passes=True)
    else:
        output.mkdir(parents=True)
        os.write(1, b"what a library written in C prints\n0.5\n")
        for name in ("x.dcm", "x.dcm.half"):  # one of them by a worker that was killed
            (output / name).write_bytes(b"x")
        path = str(output / "x.dcm")
        tell(event="left empty", job=job, reason="no birth date")
        tell(event="left out", job=job, answer="pdf", reason="no browser")
        tell(event="answer", job=job, kind="sr", sop_uid="1.9", sop_class="1.2", path=path)
        tell(event="ended", job=job, state="done", reason="6 markers")


if __name__ == "__main__":
    limit_memory(int(sys.argv[1]) << 20)
    tell(event="ready")
    end_with_parent(lambda line: threading.Thread(target=obey, args=(line,), daemon=True).start())
