"""Faults on purpose: a process killed at any system call of a piece of work (Linux), a folder that nobody may open."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # what is killed imports this, too
    import pytest

TRACEME, SYSCALL, SETOPTIONS, EXITKILL = 0, 24, 0x4200, 0x100000

available = sys.platform == "linux"
"""Whether processes can be stopped at their system calls here."""


def killed_at(stop: int, work: Callable[[], object]) -> bool:
    """Do ``work`` in a child and kill it at its ``stop``-th entry into or return from the system; False: it ended.

    The caller must have one thread only, as the child goes on from where it is.
    """
    with _traced(work) as child:
        for _ in range(stop):
            _ptrace(SYSCALL, child)
            if not _stopped(child):
                return False
        os.kill(child, signal.SIGKILL)
        while _stopped(child):
            pass
        return True


@contextmanager
def _traced(work: Callable[[], object]) -> Iterator[int]:
    """Yield a child that waits before its first step of ``work``."""
    child = os.fork()
    if child == 0:
        try:
            _ptrace(TRACEME, 0)
            os.kill(os.getpid(), signal.SIGSTOP)
            work()
        finally:
            os._exit(0)
    if not _stopped(child):
        raise RuntimeError("the child could not be traced")
    _ptrace(SETOPTIONS, child, EXITKILL)
    yield child


def _stopped(child: int) -> bool:
    _, status = os.waitpid(child, 0)
    return os.WIFSTOPPED(status)


def _ptrace(request: int, child: int, data: int = 0) -> None:
    call = ctypes.CDLL(None, use_errno=True).ptrace
    call.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    if call(request, child, None, data) == -1:
        raise OSError(ctypes.get_errno(), "cannot trace a process")


def shut(patch: pytest.MonkeyPatch, ending: str) -> None:
    """Have no folder opened whose path ends so; root may open those that nobody else may."""
    scan = os.scandir

    def refusing(path: str) -> object:
        if str(path).endswith(ending):
            raise PermissionError(13, "Permission denied")
        return scan(path)

    patch.setattr(os, "scandir", refusing)
