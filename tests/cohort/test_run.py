"""A cohort is worked off once, whatever dies or hangs; what changed is done again and nothing else."""

from __future__ import annotations

import os
import re
import select
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.cohort import children, run
from ronnaplan.cohort.results import keep
from ronnaplan.cohort.rules import CohortRule, Limits
from ronnaplan.errors import InputError
from ronnaplan.jobs.processes import Child
from tests.cohort.runs import FAKE, begun, cohort, table
from tests.cohort.scans import SLICES, tiny

pytestmark = pytest.mark.usefixtures("log")


def test_a_series_that_hangs_dies_or_takes_too_much_is_set_aside_and_stops_no_other(
    tmp_path: Path, log: Path
) -> None:
    for name in "12345678":
        tiny(tmp_path / "in", name)
    limits = Limits(seconds=3.0, memory_mib=256, attempts=2)
    counts = cohort(tmp_path, limits=limits)
    assert (counts.worked, counts.done, counts.unusable, counts.aside) == (8, 3, 1, 4)
    found = {row["series_uid"][-1]: (row["state"], row["reason"]) for row in table(tmp_path)}
    assert found["1"] == ("aside", "it took longer than 3 s")
    assert found["4"] == ("unusable", "nothing of it is left")
    assert found["5"] == ("aside", "KeyError: 'a fault of ours'")
    assert {found[name][0] for name in "678"} == {"done"}
    if sys.platform != "win32":
        assert found["2"] == ("aside", "its process died (by signal SIGKILL), 2 times")
        assert found["3"] == ("aside", "it took more memory than 256 MiB")
    assert begun(log) == {name: 2 if name == "2" else 1 for name in "12345678"}
    cohort(tmp_path, limits=limits)
    assert not begun(log)  # neither what was done nor what was set aside
    cohort(tmp_path, limits=Limits(seconds=2.0, memory_mib=256, attempts=1))
    assert begun(log) == dict.fromkeys("1235", 1)  # other limits may be enough


def test_what_the_page_does_with_the_tables_needs_no_other_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny(tmp_path / "in", "6")
    cohort(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "cohorts.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^ {4}import pyarrow.*\n(?: {4}.*\n)+", page, re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "pandas", None)  # it is not of the extra
    exec(compile(textwrap.dedent(block), "cohorts.md", "exec"), {})
    assert "error_rms_mm_approximate_median" in capsys.readouterr().out


def test_what_could_not_be_read_in_one_run_is_done_in_the_next(
    tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in "67":
        tiny(tmp_path / "in", name)
    with monkeypatch.context() as patched:
        patched.setenv("FAKE_OUTAGE", "1")
        counts = cohort(tmp_path)
    assert (counts.worked, counts.aside) == (2, 2)
    assert {row["reason"] for row in table(tmp_path)} == {"its disk is not there"}
    counts = cohort(tmp_path)
    assert (counts.worked, counts.done, counts.aside) == (2, 2, 0)
    cohort(tmp_path)
    assert begun(log) == {"6": 2, "7": 2}


def test_only_what_changed_is_done_again(tmp_path: Path, log: Path) -> None:
    for name in "678":
        tiny(tmp_path / "in" / name, name)
    cohort(tmp_path)
    assert begun(log) == {"6": 1, "7": 1, "8": 1}
    before = table(tmp_path, "markers")
    first = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.json")}
    for path in (tmp_path / "in" / "6").iterdir():  # another time, the same content
        os.utime(path, ns=(1, 1))
    tiny(tmp_path / "in" / "7", "7", shift_hu=50)
    (tmp_path / "in" / "7" / "7-000").unlink()
    (tmp_path / "in" / "8").rename(tmp_path / "gone")
    tiny(tmp_path / "in" / "9", "9")
    counts = cohort(tmp_path)
    assert (counts.listed.files, counts.worked) == (3 * SLICES - 1, 3)
    assert begun(log) == {"6": 1, "7": 1, "9": 1}
    after = table(tmp_path, "markers")
    assert [(row["series_uid"][-1], row["y_mm"]) for row in after] == [("6", 4.0), ("7", 3.0), ("9", 4.0)]
    assert after[0] == before[0]
    kept = [path for path in first if path.exists() and path.stat().st_mtime_ns == first[path]]
    assert len(kept) >= 1  # what was unchanged was not written again
    cohort(tmp_path, CohortRule(name="another name", diameters=(11.5,), folder="*"))
    assert not begun(log)
    cohort(tmp_path, CohortRule(name="all", diameters=(5.0,)))
    assert begun(log) == {"6": 1, "7": 1, "9": 1}
    assert {row["diameter_mm"] for row in table(tmp_path, "markers")} == {5.0}


def test_a_series_whose_documents_were_removed_is_done_again(tmp_path: Path, log: Path) -> None:
    for name in "67":
        tiny(tmp_path / "in", name)
    cohort(tmp_path)
    before = table(tmp_path)
    (tmp_path / "out" / before[0]["fiducials"]).unlink()
    begun(log)
    assert cohort(tmp_path).worked == 1
    assert begun(log) == {"6": 1}
    assert table(tmp_path) == before
    assert all((tmp_path / "out" / row["fiducials"]).exists() for row in before)


def test_a_series_is_flagged_for_files_beside_it_only_while_they_cannot_be_read(tmp_path: Path, log: Path) -> None:
    for name in "67":
        tiny(tmp_path / "in" / name, name)
    copy = tmp_path / "in" / "6" / "copy.dcm"
    copy.touch()
    for flagged in (["unreadable_files"], [], ["unreadable_files"]):
        copy.touch() if flagged else copy.unlink()
        cohort(tmp_path)
        assert [row["scan_flags"] for row in table(tmp_path)] == [flagged, []]
        assert begun(log)["6"] == 1
        cohort(tmp_path)
        assert not begun(log)


def test_a_series_in_an_archive_is_flagged_for_an_archive_among_its_slices(tmp_path: Path, log: Path) -> None:
    folder = tiny(tmp_path / "made", "6")
    (folder / "rest.zip").write_bytes(b"PK\x03\x04")
    shutil.make_archive(str(tmp_path / "in" / "a"), "zip", folder)
    cohort(tmp_path)
    assert [row["scan_flags"] for row in table(tmp_path)] == [["unreadable_files"]]
    assert begun(log) == {"6": 1}


def test_a_run_that_was_killed_goes_on_and_its_table_is_that_of_an_undisturbed_one(
    tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in range(10, 18):
        tiny(tmp_path / "in", str(name))
    cohort(tmp_path)
    begun(log)
    (tmp_path / "out").rename(tmp_path / "undisturbed")

    class Killed(BaseException):
        pass

    kept, children_killed = [0], [0]
    tell = Child.say

    def say(self: Child, line: str) -> None:
        tell(self, line)
        if children_killed[0] < 2:  # kill -9 of the processes that work
            children_killed[0] += 1
            os.kill(self.pid, getattr(signal, "SIGKILL", signal.SIGTERM))

    real = keep

    def keeping(*given: Any) -> None:
        real(*given)
        kept[0] += 1
        if kept[0] % 3 == 0:  # the client dies right after, or
            raise Killed
        if kept[0] % 4 == 0:
            raise InputError("the scheduler is lost")

    monkeypatch.setattr(Child, "say", say)
    monkeypatch.setattr(run, "keep", keeping)
    for _ in range(10):
        try:
            cohort(tmp_path)
        except (Killed, InputError):
            continue
        break
    for kind in ("series", "markers"):
        assert table(tmp_path, kind) == table(tmp_path, kind, "undisturbed")
    assert kept[0] == 8  # nothing was kept twice
    assert children_killed[0] == 2


def test_a_child_that_gets_no_more_work_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a cluster it stayed, with its memory, until another run came, where a client was interrupted or killed."""
    order = {"job": 1, "series_uid": "1.20", "files": [["f", "content", 1]], "known": {"1.20": "content"}}
    limits = {"seconds": 60, "memory_mib": 4096}
    assert children.work_on(order, limits, FAKE)["state"] == "done"
    (hand,) = children._idle
    monkeypatch.setattr(children, "IDLE_S", 0.3)
    assert children.work_on(order, limits, FAKE)["state"] == "done"
    assert hand.orders == 2  # it was there for the next
    last = time.monotonic() + 30
    while hand.child.status is None and time.monotonic() < last:
        time.sleep(0.05)
    assert hand.child.status is not None
    assert children._idle == []


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="the system has no groups of processes")
def test_a_run_that_is_interrupted_at_the_terminal_says_no_more_than_that(tmp_path: Path, log: Path) -> None:
    tiny(tmp_path / "in", "1")  # hangs
    code = (
        "import pathlib, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # tests in the background ignore it
        "handle = signal.signal\n"
        "def handle_late(number, handler):\n"  # once no more are sent: one that comes after the end is heard again
        "    if handler is signal.default_int_handler:\n"
        "        print('ended', flush=True)\n"
        "        sys.stdin.readline()\n"
        "    return handle(number, handler)\n"
        "signal.signal = handle_late\n"
        "from ronnaplan.cohort.cohort import run_cohort\n"
        "from ronnaplan.cohort.rules import Rules\n"
        f"try: run_cohort(['in'], pathlib.Path('out'), Rules(), module={FAKE!r}, workers=1)\n"
        "except KeyboardInterrupt: print('stopped', file=sys.stderr)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while process.poll() is None and not log.read_text():
        time.sleep(0.05)
    assert process.stdout is not None
    while process.poll() is None and not select.select([process.stdout], [], [], 0.03)[0]:  # whoever is impatient
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all of its group
    assert process.communicate("\n", timeout=60) == ("ended\n", "stopped\n")


def test_a_child_whose_parent_was_killed_ends_without_a_traceback(log: Path) -> None:
    child = subprocess.Popen(
        [sys.executable, "-m", FAKE, "512"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert child.stdin is not None
    assert child.stdout is not None
    assert b"ready" in child.stdout.readline() + child.stdout.readline()  # each begins with a line of its own
    child.stdout.close()
    child.stdin.write(b'{"job": 1, "series_uid": "1.4"}\n')
    child.stdin.flush()
    for _ in range(500):
        if log.read_text():
            break
        time.sleep(0.02)
    time.sleep(0.1)  # until it has told
    assert child.communicate(timeout=20)[1] == b""
    assert child.returncode == 0
