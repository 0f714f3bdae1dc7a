"""Reading, writing and locking where nothing of POSIX is there, as on Windows."""

from __future__ import annotations

import ast
import errno
import mmap
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Self

import filelock
import numpy as np
import pytest

from ronnaplan import portable
from ronnaplan.ct import find_series, read_ct
from ronnaplan.documents import files, open_document
from ronnaplan.documents.fiducials import read_fiducials
from ronnaplan.documents.plan import change_plan, plan_text, read_plan
from ronnaplan.documents.revision import write_document
from ronnaplan.errors import InputError
from ronnaplan.tracking import read_recording
from tests import cases
from tests.ct.makers import write_series

ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell")

POSIX = frozenset(
    {
        *("chown", "chroot", "fchmod", "fchown", "fork", "forkpty", "fdatasync", "getegid", "geteuid", "getgid"),
        *("getloadavg", "getpgid", "getuid", "killpg", "lchown", "lockf", "mkfifo", "mknod", "nice", "openpty"),
        *("posix_fadvise", "posix_fallocate", "posix_spawn", "pread", "preadv", "pwrite", "pwritev", "readv"),
        *("sched_getaffinity", "sendfile", "setsid", "statvfs", "sync", "sysconf", "uname", "writev"),
        *("O_CLOEXEC", "O_DIRECTORY", "O_DSYNC", "O_NOCTTY", "O_NOFOLLOW", "O_NONBLOCK", "O_SYNC"),
    }
)
"""Names of `os` that Windows lacks (https://docs.python.org/3/library/os.html, "Availability")."""
METHODS = frozenset({"madvise"})
"""Of objects that `mmap` makes, which Windows lacks."""
MODULES = frozenset({"fcntl", "grp", "pty", "pwd", "resource", "termios"})
PACKAGE = Path(files.__file__).parents[1]


class FileLock:
    """A lock as `filelock` has it for Windows: a file that nobody else can make meanwhile."""

    def __init__(self, lock_file: str | Path, timeout: float = -1, **_: float) -> None:
        self.lock_file, self.timeout = str(lock_file), timeout

    def __enter__(self) -> Self:
        try:
            os.close(os.open(self.lock_file, os.O_CREAT | os.O_EXCL | os.O_RDWR))
        except FileExistsError as error:
            raise filelock.Timeout(self.lock_file) from error
        return self

    def __exit__(self, *_: object) -> None:
        Path(self.lock_file).unlink(missing_ok=True)


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A system without POSIX: what `os` has of it is gone, and locks are files."""
    monkeypatch.setattr(filelock, "FileLock", FileLock)
    monkeypatch.setattr(portable, "sys", SimpleNamespace(platform="win32"))
    for name in POSIX:
        monkeypatch.delattr(os, name, raising=False)


def test_only_one_module_names_what_only_posix_has() -> None:
    named = []
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and node.attr in METHODS:
                named += [f"{path.name}: {node.attr}"] * (path.name != "portable.py")
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "os":
                named += [f"{path.name}: os.{node.attr}"] * (node.attr in POSIX and path.name != "portable.py")
            elif isinstance(node, ast.Import | ast.ImportFrom):
                module = getattr(node, "module", None) or node.names[0].name
                named += [f"{path.name}: {module}"] * (module in MODULES and path.name != "portable.py")
    assert not named


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize("packed", [False, True])
def test_a_series_is_read(tmp_path: Path, packed: bool) -> None:
    path = write_series(tmp_path / "ct")
    if packed:
        with zipfile.ZipFile(tmp_path / "ct.zip", "w", zipfile.ZIP_DEFLATED) as archive:
            for each in path.iterdir():
                archive.write(each, each.name)
        path = tmp_path / "ct.zip"
    assert len(find_series(path, progress=False).usable) == 1
    assert np.array_equal(read_ct(path).voxels_hu[2].ravel()[:3], [-824, -823, -822])


@pytest.mark.usefixtures("elsewhere")
def test_documents_are_written_changed_and_kept(tmp_path: Path) -> None:
    path = cases.write_case(tmp_path) / "plan.json"
    mine = open_document.Kept(path, read_plan, plan_text)
    change_plan(path, lambda plan: plan.edit("left", notes="by another hand"))
    assert mine.look_again()
    assert mine.content is not None
    mine.write(mine.content.edit("left", notes="by mine"))
    assert read_plan(path).trajectory("left").notes == "by mine"
    write_document(tmp_path / "fiducials.json", cases.fiducials(), read_fiducials)
    assert not list(tmp_path.glob(".ronnaplan.*"))


@pytest.mark.usefixtures("elsewhere")
def test_a_writer_waits_for_another_and_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "LOCK_WAIT_S", 0.1)
    path = tmp_path / "result.json"
    files.write_atomically(path, "old")
    with files._locked(path), pytest.raises(InputError, match="another program holds it"):
        files.write_atomically(path, "new")
    files.write_atomically(path, "new")
    assert path.read_text() == "new"


@pytest.mark.usefixtures("elsewhere")
def test_a_file_that_another_program_reads_is_replaced_once_it_is_let_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused: list[Path] = []
    whole = Path.replace

    def held(source: Path, target: Path) -> Path:
        if len(refused) < 3:
            refused.append(source)
            raise PermissionError(13, "being used by another process")
        return whole(source, target)

    monkeypatch.setattr(Path, "replace", held)
    files.write_atomically(tmp_path / "result.json", "new")
    assert (tmp_path / "result.json").read_text() == "new"
    assert len(refused) == 3


@pytest.mark.usefixtures("elsewhere")
def test_readings_are_read(tmp_path: Path) -> None:
    assert len(read_recording(cases.write_readings(tmp_path / "readings.csv")).points) == len(cases.readings())


@pytest.mark.skipif(sys.platform == "win32", reason="nothing of POSIX is there")
@pytest.mark.parametrize("knows", [True, False])
def test_on_macos_the_disk_itself_is_waited_for_where_the_file_system_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, knows: bool
) -> None:
    import fcntl

    asked, flush, path = [], 51, tmp_path / "result.json"  # F_FULLFSYNC, which only macOS has

    def control(_: int, command: int) -> None:
        asked.append("disk" if command == flush else "other")
        if not knows:
            raise OSError(errno.ENOTSUP, "not supported")

    monkeypatch.setattr(portable, "sys", SimpleNamespace(platform="darwin"))
    monkeypatch.setattr(fcntl, "F_FULLFSYNC", flush, raising=False)
    monkeypatch.setattr(fcntl, "fcntl", control)
    monkeypatch.setattr(os, "fsync", lambda _: asked.append("system"))
    with path.open("wb") as file:
        portable.sync(file.fileno())
    portable.sync_folder(tmp_path)
    assert asked == (["disk"] * 2 if knows else ["disk", "system"] * 2)


def held_kb(name: str, access: str) -> int:
    """Return what this process holds of the mapped files with a name, where they have an access."""
    blocks = Path("/proc/self/smaps").read_text().split("VmFlags:")
    return sum(int(one.split("Rss:")[1].split()[0]) for one in blocks if name in one and f" {access} " in one)


@ON_LINUX
def test_code_and_constants_of_libraries_are_given_back_and_serve_all_the_same() -> None:
    name, code, constants = "_multiarray_umath", "r-xp", "r--p"  # of NumPy
    values = np.sort(np.sin(np.arange(1000.0)))
    before = {access: held_kb(name, access) for access in (code, constants)}
    portable.give_back_code()
    assert all(held_kb(name, access) < before[access] / 4 for access in before)
    np.testing.assert_array_equal(np.sort(values[::-1]), values)


@ON_LINUX
def test_of_a_mapped_file_what_is_touched_is_held_and_not_what_lies_around(tmp_path: Path) -> None:
    path, size, step = tmp_path / "held.bin", 64 << 20, 4 << 20
    with path.open("w+b") as file:
        file.truncate(size)
        with mmap.mmap(file.fileno(), size) as room:
            portable.hold_singly(room)
            room[:] = bytes(size)
            portable.give_back(room)
            assert not any(room[place] for place in range(step // 2, size, step))
            assert 0 < held_kb(path.name, "rw-s") <= 64 * size // step  # 64 KiB around each are the system's habit


@ON_LINUX
def test_what_a_script_began_ends_with_it() -> None:
    """Debian's command that starts a browser without windows is a script, whose end does not end the browser."""
    began = "import subprocess, sys; print(subprocess.Popen(['sleep', '600']).pid, flush=True); sys.stdin.read()"
    script = f'"{sys.executable}" -c "{began}"; true'  # else the shell would be replaced by it
    process = subprocess.Popen(["sh", "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline().strip()
    portable.kill_all(process)
    assert process.communicate(timeout=60)[0] == b""  # nobody is left who could write
    assert process.returncode
