"""Child processes: their lines are read, and none outlives its parent."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping

from ronnaplan.pipes import environment
from ronnaplan.portable import OWN_GROUP, kill_group

END_S = 10.0
"""How long a child may take to finish what it holds when its parent stops."""


class Child:
    """``python -m module arguments``, of this very package, with variables ``added`` to its environment.

    ``line`` is called, in a thread, with each line that it writes.
    """

    def __init__(
        self,
        module: str,
        arguments: list[str],
        line: Callable[[str], None],
        added: Mapping[str, str],
    ) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
            env={**environment(), **added},
            **OWN_GROUP,
        )
        self._line = line
        self._reader = threading.Thread(target=self._read, name=module, daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Its number in the system."""
        return self._process.pid

    @property
    def status(self) -> int | None:
        """Its exit status once it ended and all it wrote was read; None before."""
        return None if self._reader.is_alive() else self._process.wait()

    def say(self, line: str) -> None:
        """Write a line to it; one that ended hears nothing."""
        with contextlib.suppress(OSError, ValueError):
            if self._process.stdin is not None:
                self._process.stdin.write(f"{line}\n")
                self._process.stdin.flush()

    def kill(self) -> None:
        """End it at once, and what it began, such as a browser that prints for it."""
        kill_group(self._process)

    def end(self) -> None:
        """Let it finish, at most `END_S`."""
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.kill()
        self._reader.join()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _read(self) -> None:
        if self._process.stdout is not None:
            for line in self._process.stdout:
                self._line(line)


def end_with_parent(line: Callable[[str], None] | None = None) -> None:
    """Wait until the parent closes this process's standard input, or is gone; ``line`` is given what it says."""
    while said := sys.stdin.readline():
        if line is not None:
            line(said)
