"""A Dask scheduler, two workers and a client, each a process: all are killed (SIGKILL) and started anew."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

POLL_S = 0.1


class UnderFire:
    """The processes; the command of the ``client`` is given, without the ``address`` of the scheduler."""

    def __init__(self, folder: Path, client: Sequence[str], threads: int = 1) -> None:
        self.folder = folder
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        dask = "distributed.cli.dask_"
        given = ["--no-dashboard", "--no-nanny", "--nthreads", str(threads)]
        self._commands = {
            "scheduler": ["-m", f"{dask}scheduler", "--host", self.address, "--no-dashboard"],
            "worker 1": ["-m", f"{dask}worker", self.address, *given, "--local-directory", str(folder / "1")],
            "worker 2": ["-m", f"{dask}worker", self.address, *given, "--local-directory", str(folder / "2")],
            "client": [*client, self.address],
        }
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self.killed: Counter[str] = Counter()

    @property
    def names(self) -> list[str]:
        """What can be killed: each process, or a child that works on a series."""
        return [*self._commands, "child"]

    @property
    def is_done(self) -> bool:
        """Whether the client has ended its work."""
        return "client" in self._processes and self._processes["client"].poll() == 0

    def tend(self) -> None:
        """Start what is not running."""
        with (self.folder / "log of processes").open("ab") as log:
            for name, command in self._commands.items():
                if name not in self._processes or self._processes[name].poll() is not None:
                    self._processes[name] = subprocess.Popen(
                        [sys.executable, *command], stderr=log, stdout=log, cwd=self.folder
                    )

    def pause(self, seconds: float) -> None:
        """Let them work so long, or until the client is done."""
        last = time.monotonic() + seconds
        while time.monotonic() < last and not self.is_done:
            time.sleep(POLL_S)

    def kill(self, name: str, draws: random.Random) -> None:
        """Kill one of `names`; of the children that there are, any."""
        pids = self._children() if name == "child" else [self._processes[name].pid]
        if pids:
            with suppress(ProcessLookupError):
                os.kill(draws.choice(pids), signal.SIGKILL)
                self.killed[name] += 1

    def _children(self) -> list[int]:
        workers = {process.pid for process in self._processes.values()}
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
                if parent in workers and b"_work" in (process / "cmdline").read_bytes().replace(b".", b"_"):
                    found.append(int(process.name))
        return found

    def close(self) -> None:
        """End all of them."""
        for process in self._processes.values():
            process.kill()
            process.wait()
