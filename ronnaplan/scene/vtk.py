"""Asks a process of its own to do what VTK does (`ronnaplan.scene.workshop`)."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ronnaplan.errors import InputError
from ronnaplan.pipes import receive, send

Arrays = dict[str, NDArray[Any]]

LONGEST_S = 300.0
"""A task that takes longer is given up."""

NEEDED = "pyvista"


class NoGraphicsError(InputError):
    """VTK could not do a task, for want of a graphics library, say."""


class Workshop:
    """A process for one task. It loads its libraries from when it is begun, which takes as long as many a task."""

    def __init__(self) -> None:
        self._told = tempfile.TemporaryFile()  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "ronnaplan.scene.workshop"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._told,
            env=_environment(),
        )

    def __enter__(self) -> Workshop:
        return self

    def __exit__(self, *_: object) -> None:
        """End it, whether it was needed or not."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._told):
            if stream is not None:
                stream.close()

    def answer(self, task: str, given: dict[str, Any]) -> Any:
        """Return the answer to a task, the only one; raises `NoGraphicsError` where it could not be done."""
        late = threading.Timer(LONGEST_S, self._process.kill)
        late.start()
        try:
            with self._process as process, self._told:
                assert process.stdin is not None
                assert process.stdout is not None
                try:
                    send(process.stdin, (task, given))
                    return receive(process.stdout)
                except (EOFError, OSError) as error:
                    with suppress(OSError):
                        process.stdin.close()
                    status = process.wait()
                    self._told.seek(0)
                    last = self._told.read().decode(errors="replace").strip().rpartition("\n")[2]
                    reason = last or (f"status {status}" if late.is_alive() else f"not done after {LONGEST_S:g} s")
                    raise NoGraphicsError(
                        f"VTK could not make {task} ({reason}); see docs/planner.md, 3-D"
                    ) from error
        finally:
            late.cancel()


def asked(task: str, arrays: Arrays) -> Arrays:
    """Return the answer to a task of the workshop.

    Raises `InputError` where pyvista is not installed, `NoGraphicsError` where the task could not be done.
    """
    if find_spec(NEEDED) is None:
        raise InputError(f"3-D surfaces need {NEEDED}; install ronnaplan[scene]")
    answer: Arrays = Workshop().answer(task, arrays)
    return answer


def _environment() -> dict[str, str]:
    """Return the environment in which the other process finds this very package."""
    here = str(Path(__file__).resolve().parents[2])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH")]))}
