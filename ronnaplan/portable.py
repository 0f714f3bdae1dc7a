"""What only POSIX has, with what other systems have in its place."""

from __future__ import annotations

import errno
import mmap
import os
import re
import signal
import stat
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

OPENED_ELSEWHERE_S = 2.0
"""Windows replaces no file that another program has open: how long to wait until it has read it."""

GIVING_BACK = {"MALLOC_ARENA_MAX": "2", "MALLOC_MMAP_THRESHOLD_": "400000", "MALLOC_TRIM_THRESHOLD_": "400000"}
"""Environment of a process that stays: has glibc give back what is freed, where it would keep tens of megabytes; other
systems take no notice."""

GIVING_WAY = 5
"""Niceness of what works behind what a person waits for: a quarter of a processor that both want."""

OWN_GROUP: dict[str, Any] = {"process_group": 0}
"""How `subprocess.Popen` begins a process that does not hear a terminal's Ctrl-C: who began it hears it."""
if sys.platform == "win32":
    OWN_GROUP = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}

_SEEKING = threading.Lock()


def kill_group(process: subprocess.Popen[Any]) -> None:
    """End at once what was begun with `OWN_GROUP`, and on POSIX what it began, which would go on without it."""
    if process.poll() is not None:
        return
    if sys.platform == "win32":
        process.kill()
    else:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


class Killed(Protocol):
    """A process, of `subprocess` or of `asyncio`, that did not end yet."""

    @property
    def pid(self) -> int:
        """Its number in the system."""

    def kill(self) -> None:
        """End it at once."""


def kill_all(process: Killed) -> None:
    """End at once a process, and on Linux what it began, which would go on without it: some commands are scripts.

    It stays in the group of who began it, and ends with that.
    """
    begun = _begun_by(process.pid)
    with suppress(ProcessLookupError):
        process.kill()
    if sys.platform != "win32":
        for number in begun:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)


def _begun_by(parent: int) -> list[int]:
    """Return the numbers of the processes that ``parent`` began, and these; Linux tells."""
    begun: dict[int, list[int]] = {}
    for status in Path("/proc").glob("[0-9]*/stat") if sys.platform == "linux" else ():
        with suppress(OSError):  # it ended meanwhile
            told = status.read_text(encoding="utf-8", errors="replace").rpartition(")")[2]  # names hold anything
            begun.setdefault(int(told.split()[1]), []).append(int(status.parent.name))
    found = begun.get(parent, [])
    for number in found:  # those it began follow, too
        found += begun.get(number, [])
    return found


def read_at(descriptor: int, count: int, offset: int) -> bytes:
    """Return up to ``count`` bytes from ``offset`` of an open file, whatever other threads read of it."""
    if sys.platform != "win32":
        return os.pread(descriptor, count, offset)
    with _SEEKING:
        os.lseek(descriptor, offset, os.SEEK_SET)
        return os.read(descriptor, count)


def read_into(descriptor: int, target: memoryview, offset: int) -> int:
    """Fill ``target`` (bytes) from ``offset`` of an open file; return how many bytes there were."""
    done = 0
    while done < len(target):
        if hasattr(os, "preadv"):
            count = os.preadv(descriptor, [target[done:]], offset + done)
        else:
            content = read_at(descriptor, len(target) - done, offset + done)
            count = len(content)
            target[done : done + count] = content
        if count == 0:
            break
        done += count
    return done


def reserve(descriptor: int, count: int) -> None:
    """Make an open file ``count`` bytes long, on the disk where the system can; raises `OSError` where it is full."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, count)
    else:
        os.ftruncate(descriptor, count)


def give_back(room: mmap.mmap) -> None:
    """Hold the pages of a mapped file no longer, until they are touched; Windows does so by itself alone."""
    if sys.platform != "win32":
        room.madvise(mmap.MADV_DONTNEED)


def hold_singly(room: mmap.mmap) -> None:
    """Hold of a mapped file the pages that are touched, not the megabytes around each; Windows does so by itself."""
    if sys.platform != "win32":
        room.madvise(mmap.MADV_RANDOM)


def give_back_code() -> None:
    """Hold nothing of the program and its libraries that lies in their files as it is, until it is needed again.

    Linux keeps what it once read of code and constants, and tens of megabytes around that; other systems take no
    notice.
    """
    if sys.platform != "linux":
        return
    import ctypes

    advise = ctypes.CDLL(None).madvise
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    for begin, end in _as_in_files():
        advise(begin, end - begin, mmap.MADV_DONTNEED)


def _as_in_files() -> list[tuple[int, int]]:
    """Return where files lie that cannot be written and never were: addresses are put into the rest of a library."""
    found = []
    told = Path("/proc/self/smaps").read_text(encoding="utf-8", errors="replace")  # paths are in any encoding
    for part in re.split(r"^(?=[0-9a-f]+-)", told, flags=re.MULTILINE)[1:]:
        place, access, _, _, inode = part.split(maxsplit=5)[:5]
        if "w" not in access and inode != "0" and re.search(r"^Anonymous: +0 kB$", part, re.MULTILINE):
            begin, end = (int(one, 16) for one in place.split("-"))
            found.append((begin, end))
    return found


def give_way() -> None:
    """Let other processes have a processor first, where they want it; Windows knows other means."""
    if hasattr(os, "nice"):
        os.nice(GIVING_WAY)


def run_instead(arguments: list[str], *, keep: int) -> None:
    """Run another program in this process, which keeps its number, its pipes and the open file ``keep``.

    What it had loaded is gone. Windows cannot: there this returns.
    """
    if sys.platform == "win32":
        return
    os.set_inheritable(keep, True)
    os.execv(arguments[0], arguments)


def is_administrator() -> bool:
    """Whether the program runs as root; Windows has none."""
    return hasattr(os, "geteuid") and os.geteuid() == 0


def is_own_secret(status: os.stat_result) -> bool:
    """Whether a file belongs to this user and no other can read or write it; Windows tells by its folder alone."""
    if not hasattr(os, "geteuid"):
        return True
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IRWXG | stat.S_IRWXO)


def keep_access(handle: int, before: os.stat_result) -> None:
    """Give the open file ``handle`` the mode and the ownership ``before``, as far as this user may.

    Only an administrator can give a file to another user; the group is then kept by itself, where that is allowed.
    Windows gives a file the access of its folder.
    """
    if sys.platform == "win32":
        return
    now = os.fstat(handle)
    if (now.st_uid, now.st_gid) != (before.st_uid, before.st_gid):
        try:
            os.fchown(handle, before.st_uid, before.st_gid)
        except PermissionError:
            with suppress(PermissionError):
                os.fchown(handle, -1, before.st_gid)
    os.fchmod(handle, stat.S_IMODE(before.st_mode))


def replace(source: Path, target: Path) -> None:
    """Put ``source`` in the place of ``target``, which then holds the old or the new content and never a mixture."""
    last = time.monotonic() + OPENED_ELSEWHERE_S
    while True:
        try:
            source.replace(target)
        except PermissionError:
            if sys.platform != "win32" or time.monotonic() > last:
                raise
            time.sleep(0.02)
        else:
            return


def sync(descriptor: int) -> None:
    """Wait until what was written to an open file is on the disk.

    macOS would wait until the disk has it in its own memory, which a loss of power empties.
    """
    if sys.platform == "darwin":
        import fcntl

        with suppress(OSError):  # some file systems know of no more than that
            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
            return
    os.fsync(descriptor)


def sync_folder(folder: Path) -> None:
    """Wait until the names in ``folder`` are on the disk; Windows syncs them with the files."""
    if sys.platform == "win32":
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        sync(handle)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems sync no folders
            raise
    finally:
        os.close(handle)


def processors() -> int:
    """Return how many processors this process may use: a part of the machine's may be all that it was given."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def peak_memory_bytes() -> int | None:
    """Return the most memory that this process had at one time; Windows does not tell."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def limit_memory(most_bytes: int) -> None:
    """Let this process, and those it starts, hold at most so many bytes of data each; Windows has no such limit."""
    if sys.platform == "win32":
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = most_bytes if hard == resource.RLIM_INFINITY else min(most_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
