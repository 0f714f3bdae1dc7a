"""Child processes of the program."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ronnaplan import __version__
from ronnaplan.jobs.processes import Child
from tests.node.peers import until


def test_a_child_is_of_this_very_package_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Begun in a folder with another copy of the source it was of that one."""
    for folder in (tmp_path / "other", tmp_path / "here"):
        (folder / "ronnaplan").mkdir(parents=True)
        (folder / "ronnaplan" / "__init__.py").touch()
    monkeypatch.setenv("PYTHONPATH", os.fspath(tmp_path / "other"))
    monkeypatch.chdir(tmp_path / "here")
    said: list[str] = []
    child = Child("ronnaplan", ["--version"], said.append, {})
    child.end()
    assert (child.status, "".join(said).split()) == (0, ["ronnaplan", __version__])


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are looked for in /proc")
def test_what_a_child_began_ends_with_it_where_it_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The browser that printed for it went on."""
    (tmp_path / "begins.py").write_text(
        "import subprocess, sys, time\n"
        "begun = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(300)'], stdout=subprocess.DEVNULL)\n"
        "print(begun.pid, flush=True)\n"
        "time.sleep(300)\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.fspath(tmp_path))
    said: list[str] = []
    child = Child("begins", [], said.append, {})
    until(lambda: said)
    child.kill()
    child.end()
    until(lambda: _is_over(int(said[0])))


def _is_over(process: int) -> bool:
    """Whether there is no such process, or one that waits for its end to be noticed."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True
