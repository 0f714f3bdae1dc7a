"""Threads of an association that sleep until there is something to do.

pynetdicom's two threads for each association look a thousand times a second whether there is; with some dozens of
associations that takes a processor. Here what puts something into their queues wakes them.
"""

from __future__ import annotations

import queue
import select
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from pynetdicom.association import Association

LONGEST_SLEEP_S = 0.25
"""After which a thread looks all the same: for timeouts, and for an end that nobody tells."""


class Bell:
    """Something to wait for beside a socket."""

    def __init__(self) -> None:
        self._hears, self._rings = socket.socketpair()
        for end in (self._hears, self._rings):
            end.setblocking(False)

    def ring(self) -> None:
        """Wake the thread that waits."""
        with suppress(OSError):  # it rings already, or nobody is there any more
            self._rings.send(b"\0")

    def wait(self, connection: socket.socket, seconds: float) -> bool:
        """Wait until ``connection`` can be read, the bell rings, or so long; whether it can be read."""
        found, _, _ = select.select([connection, self._hears], [], [], seconds)
        if self._hears in found:
            with suppress(OSError):
                self._hears.recv(4096)
        return connection in found

    def close(self) -> None:
        """Let go of both ends."""
        self._hears.close()
        self._rings.close()


class _Told(queue.Queue[Any]):
    """A queue that tells of what is put into it."""

    def __init__(self, tell: Callable[[], None]) -> None:
        super().__init__()
        self._tell = tell

    def _put(self, item: Any) -> None:
        super()._put(item)
        self._tell()


class _Checkpoint(threading.Event):
    """Where an association's own thread comes by each time before it looks for messages."""

    def __init__(self) -> None:
        super().__init__()
        self.news = threading.Event()
        self.set()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the thread may go on, and has a reason to."""
        passed = super().wait(timeout)
        self.news.wait(LONGEST_SLEEP_S)
        self.news.clear()
        return passed


def let_sleep(association: Association, bell: Bell) -> None:
    """Have both threads of an association that has not begun wait for news."""
    checkpoint = _Checkpoint()
    association._reactor_checkpoint = checkpoint
    association.dimse.msg_queue = _Told(checkpoint.news.set)
    association.dul.to_user_queue = _Told(checkpoint.news.set)
    association.dul.to_provider_queue = _Told(bell.ring)
    association.dul._run_loop_delay = 0.0001
