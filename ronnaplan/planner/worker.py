"""Work that takes long, done in a process of its own: the page never waits for it, and it can be ended at once."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ronnaplan.errors import RonnaplanError, UsageError
from ronnaplan.pipes import environment, receive, send
from ronnaplan.portable import OWN_GROUP

Told = Callable[[float], None]
"""Is told which share of the work is done, 0 to 1."""


class CancelledError(RonnaplanError):
    """The work was ended before it was done."""


@dataclass(frozen=True)
class Job:
    """``what`` is done, in words; the call for another process; and what is done here with its answer.

    ``work`` and its answer can be pickled; with ``tells`` it takes a keyword ``progress``, a `Told`.
    """

    what: str
    work: Callable[..., Any]
    keep: Callable[[Any], None]
    tells: bool = False

    def do(self) -> None:
        """Do all of it here, and wait for it."""
        self.keep(self.work())


Start = Callable[[Job], None]
"""Sets a job going: at once and here, or in another process."""


class Worker:
    """Does one job at a time, until it is cancelled."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._cancelled = False

    @property
    def busy(self) -> bool:
        """Whether a job is under way."""
        return self._process is not None

    def answer(self, job: Job, told: Told) -> Any:
        """Return what the job's work returns, or raise what it raises; waits for it.

        Raises `UsageError` while another job is under way, `CancelledError` when this one is cancelled.
        """
        if self._process is not None:
            raise UsageError("something else is being worked on; wait for it or cancel it first")
        process = self._process = subprocess.Popen(
            [sys.executable, "-m", "ronnaplan.planner.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment(),
            **OWN_GROUP,
        )
        if self._cancelled:  # before it was there to be ended
            process.kill()
        try:
            with process:
                assert process.stdin is not None
                assert process.stdout is not None
                send(process.stdin, (job.work, job.tells))
                while isinstance(answer := receive(process.stdout), float):
                    told(answer)
        except (EOFError, OSError) as error:
            if self._cancelled:
                raise CancelledError(f"cancelled: {job.what}") from error
            raise RonnaplanError(
                f"{job.what} ended without an answer (status {process.returncode}); see what the planner printed"
            ) from error
        finally:
            self._process = None
        if isinstance(answer, RonnaplanError):
            raise answer
        return answer

    def cancel(self) -> None:
        """End the job that is under way, or the next one, as this one may be about to begin."""
        self._cancelled = True
        if (process := self._process) is not None:
            process.kill()


def main() -> None:
    """Do the work that comes in on standard input; what it prints goes to standard error."""
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as out:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        work, tells = receive(sys.stdin.buffer)
        threading.Thread(target=_end_with_parent, daemon=True).start()
        try:
            answer = work(progress=lambda share: send(out, float(share))) if tells else work()
        except RonnaplanError as error:
            answer = error
        send(out, answer)
    os._exit(0)  # the thread that waits for the parent's end would hold up any other


def _end_with_parent() -> None:
    sys.stdin.buffer.read(1)
    os._exit(1)


if __name__ == "__main__":
    main()
