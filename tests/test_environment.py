"""What scripts/environment.sh installs for the demo and for the tests, with a python3 that only notes its orders."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
PYTHON = """#!/bin/sh
case "$*" in
    "-m venv .venv") mkdir -p .venv/bin; cp "$0" .venv/bin/python; echo new ;;
    *--require-hashes*) echo "${*##* }" ;;
    *demo*) echo "ran with $PATH" ;;
esac >> told
"""

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the scripts are for POSIX shells")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A tree with the scripts, the project file and two locks, and a python3 in ``bin``."""
    for folder in ("scripts", "bin"):
        (tmp_path / folder).mkdir()
    for name in ("demo", "environment.sh"):
        shutil.copy(SCRIPTS / name, tmp_path / "scripts")
    for name in ("requirements.lock", "requirements-demo.lock", "pyproject.toml"):
        (tmp_path / name).write_text("numpy==2.0\n")
    (tmp_path / "bin" / "python3").write_text(PYTHON)
    (tmp_path / "bin" / "python3").chmod(0o755)
    return tmp_path


def told(tree: Path, command: str) -> list[str]:
    """Return what python3 notes while a shell runs ``command`` in the tree."""
    (tree / "told").write_text("")
    path = os.pathsep.join([str(tree / "bin"), os.environ["PATH"]])
    subprocess.run(["bash", "-c", command], cwd=tree, env={"PATH": path}, check=True, capture_output=True)
    return (tree / "told").read_text().splitlines()


def test_the_tests_add_to_what_the_demo_installed_and_the_demo_keeps_what_they_had(tree: Path) -> None:
    demo, tests = "LOCK=requirements-demo.lock; source scripts/environment.sh", "source scripts/environment.sh"
    assert told(tree, demo) == ["new", "requirements-demo.lock"]
    assert told(tree, demo) == []
    assert told(tree, tests) == ["requirements.lock"]
    assert told(tree, demo) == []
    (tree / "pyproject.toml").write_text("changed\n")
    assert told(tree, demo) == ["new", "requirements.lock"]
    assert told(tree, tests) == []
    (tree / "requirements-demo.lock").write_text("numpy==2.1\n")
    assert told(tree, demo) == []


def test_the_demo_finds_no_more_than_who_calls_it(tree: Path) -> None:
    """So that it tells how to activate the environment where that was not done."""
    (ran,) = (line for line in told(tree, "scripts/demo") if line.startswith("ran"))
    assert str(tree / ".venv") not in ran
