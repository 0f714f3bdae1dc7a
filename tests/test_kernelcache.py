"""A compiled copy on disk is used again while all that it was made of is the same, and only then."""

from __future__ import annotations

import ast
import errno
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import invalidate_caches
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock
from numba.core import caching

import kernelcache
from kernelcache import njit

Anew = Callable[[str], str]

MODULES = {
    "__init__": "",
    "constants": "FACTOR = 2.0\nTABLE = (1.0, 10.0)\n",
    "deep": """
        from kernelcache import njit
        from pack.constants import FACTOR
        @njit(cache=True)
        def scaled(x: float) -> float:
            return FACTOR * x
    """,
    "middle": """
        from kernelcache import njit
        from pack.deep import scaled
        @njit(cache=True)
        def passed(x: float) -> float:
            return scaled(x)
    """,
    "top": """
        from kernelcache import njit
        from pack.constants import TABLE
        from pack.middle import passed
        @njit(cache=True)
        def outer(x: float) -> float:
            return passed(x) + TABLE[1]
    """,
    "aside": "WORD = 'nothing of the kernels'\n",
}
RUN = "import pack.aside; from pack.top import outer; print(outer(3.0), sum(outer.stats.cache_hits.values()))"

MIXED = """
import sys
from concurrent.futures import ThreadPoolExecutor

from kernelcache import njit
import numpy as np
@njit(cache=True)
def mixed(n: int) -> tuple[int, float]:
    seen = {}
    for k in range(n):
        seen[k] = k
    volume = np.linalg.det(np.eye(n))
    if n > 9:
        raise ValueError("too many")
    return len(seen), volume
@njit()
def around(n: int) -> float:
    return mixed(n)[1] + 1.0
first = mixed(4)
compiler = "numba.np.polynomial.polynomial_core" in sys.modules
print(*first, *mixed.stats.cache_hits.values(), compiler, around(6), sep=", ")
"""


@pytest.fixture
def pack(tmp_path: Path) -> Path:
    folder = tmp_path / "pack"
    folder.mkdir()
    for name, text in MODULES.items():
        (folder / f"{name}.py").write_text(text.replace("\n        ", "\n"))
    return folder


@pytest.fixture
def anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Anew]:
    """Runs a line of Python as a new process would, for which none of the modules beneath was imported before.

    A process of its own takes a second to begin to compile, which is longer than these kernels take.
    """
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # it would be taken for a source's that changed at once

    def forget() -> None:
        for name in [name for name in sys.modules if name.split(".")[0] in ("pack", "counting")]:
            del sys.modules[name]
        kernelcache._module.cache_clear()
        invalidate_caches()

    def printed(line: str) -> str:
        forget()
        exec(line, {})
        return capsys.readouterr().out.strip()

    yield printed
    forget()


def told(folder: Path, script: str) -> str:
    """What Python prints in a new process."""
    paths = [str(folder), str(Path(__file__).parents[1])]
    return subprocess.run(
        [sys.executable, script],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()


def change(path: Path, old: str, new: str) -> None:
    path.write_text(path.read_text().replace(old, new))


def test_a_kernel_runs_where_the_disk_takes_no_copy_of_it(
    pack: Path, anew: Anew, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(caching.IndexDataCacheFile, "_save_data", full)
    assert anew(RUN) == anew(RUN) == "16.0 0"


@pytest.mark.usefixtures("pack", "anew")
@pytest.mark.parametrize(("is_terminal", "lines"), [(True, 1), (False, 0)])
def test_who_sits_at_a_terminal_is_told_once_what_is_waited_for(
    is_terminal: bool, lines: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    kernelcache._say_what_is_waited_for.cache_clear()
    exec(RUN, {})
    assert capsys.readouterr().err.count("compiling the inner loops") == lines


def test_kernels_run_where_no_folder_takes_copies_and_that_is_told_once(
    pack: Path, anew: Anew, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(kernelcache._Copy, "_locator_classes", [])
    monkeypatch.setattr(kernelcache, "homeless", [])
    assert anew(RUN) == anew(RUN) == "16.0 0"
    assert [one.message.partition(",")[0] for one in caplog.records] == [
        "no folder takes compiled copies of the inner loops"
    ]


def test_a_copy_is_made_anew_where_a_constant_or_a_kernel_of_another_module_changed(
    pack: Path, anew: Anew
) -> None:
    assert anew(RUN) == "16.0 0"
    change(pack / "aside.py", "nothing", "still nothing")
    assert anew(RUN) == "16.0 1"
    change(pack / "constants.py", "FACTOR = 2.0", "FACTOR = 5.0")  # two kernels further down
    assert anew(RUN) == "25.0 0"
    change(pack / "deep.py", "FACTOR * x", "FACTOR - x")
    assert anew(RUN) == "12.0 0"
    change(pack / "constants.py", "10.0", "20.0")
    assert anew(RUN) == "22.0 0"


def test_a_copy_counts_in_a_folder_that_was_moved(pack: Path, anew: Anew, monkeypatch: pytest.MonkeyPatch) -> None:
    assert anew(RUN) == "16.0 0"
    monkeypatch.syspath_prepend(pack.parent / "moved")
    shutil.copytree(pack, pack.parent / "moved" / "pack")
    shutil.rmtree(pack)
    assert anew(RUN) == "16.0 1"


def test_a_copy_runs_as_before_and_loads_nothing_that_only_compiling_takes(tmp_path: Path) -> None:
    """What is compiled after it, and calls it, is none the worse."""
    (tmp_path / "mixed.py").write_text(MIXED)
    assert told(tmp_path, "mixed.py") == "4, 1.0, True, 2.0"
    assert told(tmp_path, "mixed.py") == "4, 1.0, 1, False, 2.0"


def test_an_index_that_names_a_type_of_another_version_is_no_index(pack: Path, anew: Anew) -> None:
    """It ended in a traceback: numba reads the whole index before it asks whether it is stale."""
    (pack / "shapes.py").write_text(
        "from typing import NamedTuple\nfrom kernelcache import njit\nclass Arm(NamedTuple):\n    reach: float\n"
        "@njit(cache=True)\ndef reached(arm: Arm) -> float:\n    return 2.0 * arm.reach\n"
    )
    run = "import pack.shapes as s; print(s.reached(s.{}(3.0)), sum(s.reached.stats.cache_hits.values()))"
    assert anew(run.format("Arm")) == "6.0 0"
    assert anew(run.format("Arm")) == "6.0 1"
    shapes = (pack / "shapes.py").read_text()
    (pack / "shapes.py").write_text(shapes.replace("Arm", "Robot"))
    assert anew(run.format("Robot")) == "6.0 0"
    for index in pack.rglob("*.nbi"):
        index.write_bytes(index.read_bytes()[:20])
    assert anew(run.format("Robot")) == "6.0 0"


COUNTING = """
from kernelcache import njit
@njit(cache=True)
def added(count: int, by: int) -> int:
    return count + by
@njit()
def counted(n: int) -> int:
    count = 0
    for _ in range(n):
        count = added(count, 1)
    return added(count, 2)
print(counted(3), len(added.signatures), sum(added.stats.cache_misses.values()))
"""


def test_a_constant_that_is_handed_on_compiles_no_kernel_of_its_own(tmp_path: Path, anew: Anew) -> None:
    """There were four: for a count that is 0, or any, by 1 or by 2."""
    (tmp_path / "counting.py").write_text(COUNTING)
    assert anew("import counting") == "5 1 1"
    assert anew("import counting") == "5 1 0"


def test_who_waits_too_long_for_a_process_that_hangs_compiles_for_itself(
    tmp_path: Path, anew: Anew, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "counting.py").write_text(COUNTING)
    assert anew("import counting") == "5 1 1"
    (lock,) = (tmp_path / "__pycache__").glob("counting.added*.lock")
    for copy in lock.parent.glob("counting.added*.nb*"):
        copy.unlink()
    monkeypatch.setattr(kernelcache, "PATIENCE_S", 0.2)
    with FileLock(lock):
        assert anew("import counting") == "5 1 1"


def test_of_processes_that_want_a_kernel_at_once_one_compiles_it(tmp_path: Path) -> None:
    (tmp_path / "counting.py").write_text(COUNTING.replace("count + by", "count + by + 0 * len([by])"))
    with ThreadPoolExecutor() as pool:
        found = list(pool.map(lambda _: told(tmp_path, "counting.py"), range(3)))
    assert sorted(found) == ["5 1 0"] * 2 + ["5 1 1"]


def filled_slices(path: Path) -> list[str]:
    """Where a kernel of a module assigns to a slice what is no number, or adds a slice to a row."""
    found = []
    text = path.read_text(encoding="utf-8")
    for function in ast.walk(ast.parse(text)) if re.search(r"@(njit|compiled)\b", text) else ():
        decorators = map(ast.unparse, getattr(function, "decorator_list", ()))
        if any(one.startswith(("njit(", "compiled(")) for one in decorators):
            for line in (one for one in ast.walk(function) if isinstance(one, ast.Assign | ast.AugAssign)):
                targets, _, value = ast.unparse(line).rpartition("= ")
                adds_to_row = isinstance(line, ast.AugAssign) and isinstance(line.target, ast.Subscript)
                sliced = ":" in targets + value * adds_to_row
                if sliced and not re.fullmatch(r"[\d.,() -]+|-?np\.inf|True|False|[A-Z_]+", value):
                    found.append(f"{path.name}:{line.lineno}: {ast.unparse(line)}")
    return found


def test_kernels_fill_slices_by_loops() -> None:
    """Numba compiled with each what tells two shapes in an error: a fifth of what `ronnaplan prepare` took."""
    root = Path(__file__).parents[1]
    modules = [*(root / "ronnaplan").rglob("*.py"), *(root / "phantoms").rglob("*.py")]
    assert [line for path in sorted(modules) for line in filled_slices(path)] == []


def test_what_only_callers_in_c_would_need_is_not_compiled() -> None:
    """It took a tenth of all the time that compiling takes."""

    @njit()
    def doubled(x: float) -> float:
        return 2.0 * x

    kernel: Any = doubled
    assert kernel(1.5) == 3.0
    assert "cfunc." not in kernel.inspect_llvm(kernel.signatures[0])
