"""Asks a process of its own to do what VTK does (`ronnaplan.scene.workshop`)."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from typing import Any

from numpy.typing import NDArray

from ronnaplan.errors import InputError
from ronnaplan.extras import require_packages
from ronnaplan.pipes import environment, receive, send

Arrays = dict[str, NDArray[Any]]

LONGEST_S = 300.0
"""A task that takes longer is given up."""

NEEDS_PYVISTA = ("a scene in 3-D", "scene", "pyvista")
"""Who needs it, and which extra has it, as `require_packages` is told."""


class NoGraphicsError(InputError):
    """VTK could not do a task, for want of a graphics library, say."""


class Workshop:
    """A process for tasks, one after the other, until its context ends.

    It loads its libraries from when it is begun, which takes as long as many a task.
    """

    def __init__(self) -> None:
        self._failed = ""
        self._told = tempfile.TemporaryFile()  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "ronnaplan.scene.workshop"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._told,
            env=environment(),
        )

    def __enter__(self) -> Workshop:
        return self

    def __exit__(self, *_: object) -> None:
        """End it, whether it was needed or not."""
        self.end()

    def end(self) -> None:
        """End it; a task that another thread waits for fails."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._told):
            if stream is not None:
                with suppress(OSError):  # what was not yet written goes nowhere
                    stream.close()

    def answer(self, task: str, given: dict[str, Any]) -> Any:
        """Return the answer to a task; raises `NoGraphicsError` where it, or one before it, could not be done."""
        if self._failed:
            raise NoGraphicsError(self._failed)
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        late = threading.Timer(LONGEST_S, process.kill)
        late.start()
        try:
            send(process.stdin, (task, given))
            return receive(process.stdout)
        except (EOFError, OSError, ValueError) as error:  # the last one where it was ended meanwhile
            with suppress(OSError):
                process.stdin.close()
            status = process.wait()
            how = f"status {status}" if late.is_alive() else f"not done after {LONGEST_S:g} s"
            reason = self._last_words() or how
            self._failed = f"VTK could not make {task} ({reason}); see docs/planner.md, 3-D"
            raise NoGraphicsError(self._failed) from error
        finally:
            late.cancel()

    def _last_words(self) -> str:
        """Return the last line that it told, empty where nobody listens any more."""
        with suppress(ValueError):
            self._told.seek(0)
            return self._told.read().decode(errors="replace").strip().rpartition("\n")[2]
        return ""

    def arrays(self, task: str, given: Arrays) -> Arrays:
        """Return the answer to a task that needs pyvista; raises `InputError` where that is not installed."""
        require_packages(*NEEDS_PYVISTA)
        answer: Arrays = self.answer(task, given)
        return answer
