"""Run by a test, in a process with one thread: counts in a file and is killed at every system call in turn."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import filelock  # noqa: F401  (imported before the system calls are counted)

from ronnaplan.documents.files import change_document, read_json, write_atomically
from tests.faults import killed_at


def count_up(path: Path) -> int:
    found: int = change_document(path, read_json, lambda number: number + 1, json.dumps)
    return found


def main(path: Path, step: int) -> None:
    """Kill at every ``step``-th stop; print the killed, those whose change was acknowledged, and what was wrong."""
    write_atomically(path, "0")
    acknowledged_by, tell = os.pipe()
    os.set_blocking(acknowledged_by, False)
    killed, acknowledged, wrong = 0, 0, []
    while killed_at(killed * step + 1, lambda: os.write(tell, b"%d" % count_up(path))):
        killed += 1
        before = read_json(path)
        try:
            told = int(os.read(acknowledged_by, 100))
        except BlockingIOError:
            told = 0
        acknowledged += told > 0
        after = count_up(path)
        left = sorted(one.name for one in path.parent.iterdir())
        if told > before or after != before + 1 or left != [path.name]:
            wrong.append([killed, told, before, after, left])
    print(json.dumps({"killed": killed, "acknowledged": acknowledged, "wrong": wrong}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
