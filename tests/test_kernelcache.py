"""A compiled copy on disk is used again while all that it was made of is the same, and only then."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

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


@pytest.fixture
def pack(tmp_path: Path) -> Path:
    folder = tmp_path / "pack"
    folder.mkdir()
    for name, text in MODULES.items():
        (folder / f"{name}.py").write_text(text.replace("\n        ", "\n"))
    return folder


def answer(pack: Path) -> tuple[float, int]:
    """What a new process computes, and how often it took a copy from the disk."""
    paths = [str(pack.parent), str(Path(__file__).parents[1])]
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        cwd=pack.parent,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    value, hits = done.stdout.split()
    return float(value), int(hits)


def change(path: Path, old: str, new: str) -> None:
    path.write_text(path.read_text().replace(old, new))


def test_a_copy_is_made_anew_where_a_constant_or_a_kernel_of_another_module_changed(pack: Path) -> None:
    assert answer(pack) == (16.0, 0)
    change(pack / "aside.py", "nothing", "still nothing")
    assert answer(pack) == (16.0, 1)
    change(pack / "constants.py", "FACTOR = 2.0", "FACTOR = 5.0")  # two kernels further down
    assert answer(pack) == (25.0, 0)
    change(pack / "deep.py", "FACTOR * x", "FACTOR - x")
    assert answer(pack) == (12.0, 0)
    change(pack / "constants.py", "10.0", "20.0")
    assert answer(pack) == (22.0, 0)
