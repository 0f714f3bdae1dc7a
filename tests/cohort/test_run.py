"""A cohort is worked off once, whatever dies or hangs; what changed is done again and nothing else."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.cli import main
from ronnaplan.cohort import children, run
from ronnaplan.cohort.cohort import Counts, run_cohort
from ronnaplan.cohort.index import Index
from ronnaplan.cohort.results import keep
from ronnaplan.cohort.rules import CohortRule, Limits, Rules
from ronnaplan.errors import InputError
from ronnaplan.jobs.processes import Child
from tests.cohort.scans import SLICES, tiny

pytest.importorskip("distributed")
parquet = pytest.importorskip("pyarrow.parquet")

FAKE = "tests.cohort.fake_work"
RULE = CohortRule(name="all", diameters=(11.5,))


@pytest.fixture(autouse=True)
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "log"
    path.touch()
    monkeypatch.setenv("FAKE_LOG", str(path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path.cwd()), os.environ.get("PYTHONPATH", "")]))
    return path


def begun(log: Path) -> Counter[str]:
    found = Counter(line.rpartition(".")[2] for line in log.read_text().split())
    log.write_text("")
    return found


def cohort(tmp_path: Path, rule: CohortRule = RULE, limits: Limits | None = None, **given: Any) -> Counts:
    rules = Rules(rule=(rule,), limits=limits or Limits())
    return run_cohort([str(tmp_path / "in")], tmp_path / "out", rules, module=FAKE, workers=1, **given)


def table(tmp_path: Path, name: str = "series", out: str = "out") -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = parquet.read_table(tmp_path / out / f"{name}.parquet").to_pylist()
    return rows


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


def test_a_cluster_gives_the_same_table_and_a_lost_or_absent_scheduler_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, log: Path
) -> None:
    from distributed import LocalCluster

    for name in range(20, 24):
        tiny(tmp_path / "in", str(name))
    rules = Rules(rule=(RULE,))
    given = [str(tmp_path / "in")]
    with LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, processes=True
    ) as cluster:
        counts = run_cohort(given, tmp_path / "out", rules, scheduler=cluster.scheduler_address, module=FAKE)
    assert (counts.worked, counts.done) == (4, 4)
    assert set(begun(log).values()) == {1}
    run_cohort(given, tmp_path / "here", rules, workers=1, module=FAKE)
    assert table(tmp_path, "markers") == table(tmp_path, "markers", "here")
    monkeypatch.setattr(run, "CONNECT", "1s")
    tiny(tmp_path / "in", "25")
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        run_cohort(given, tmp_path / "out", rules, scheduler="tcp://127.0.0.1:1", module=FAKE)


def test_a_cluster_without_workers_is_told_of_once_each_time_and_the_run_goes_on_when_some_come(
    tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    from distributed import LocalCluster

    monkeypatch.setattr(run, "ASK_AGAIN_S", 0.05)
    monkeypatch.setattr(run, "GONE_S", 0.2)
    monkeypatch.setenv("FAKE_SECONDS", "0.3")
    for name in range(20, 24):
        tiny(tmp_path / "in", str(name))

    def told() -> list[str]:
        return [record.message for record in caplog.records if record.name == run.__name__]

    def see(what: Callable[[], str | list[str]], count: int) -> None:
        last = time.monotonic() + 30
        while len(what()) < count:
            assert time.monotonic() < last
            time.sleep(0.02)

    here = {"host": "127.0.0.1", "protocol": "tcp://", "processes": False, "dashboard_address": None}
    with LocalCluster(n_workers=0, threads_per_worker=1, **here) as cluster, ThreadPoolExecutor(1) as pool:
        given = [str(tmp_path / "in")], tmp_path / "out", Rules(rule=(RULE,))
        ended = pool.submit(run_cohort, *given, scheduler=cluster.scheduler_address, module=FAKE)
        for count, workers in enumerate((1, 0, 1), start=1):
            see(told, count)
            if not workers:
                see(log.read_text, 1)
            cluster.scale(workers)
        assert ended.result(30).done == 4
    none = "the Dask cluster has no workers; the run waits, and goes on when some come"
    assert told() == 2 * [none, "the Dask cluster has workers now: the run goes on"]


def test_what_a_cohort_warns_of_is_shown_where_it_is_run_from_a_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def warned(*_: Any, **__: Any) -> Counts:
        run.LOG.warning("no workers")
        raise InputError("ended")

    monkeypatch.setattr("ronnaplan.cohort.cohort.run_cohort", warned)
    assert main(["cohort", str(tmp_path), "-o", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err == "no workers\nronnaplan: ended\n"


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


def test_a_folder_that_another_run_has_is_left_alone(tmp_path: Path) -> None:
    from filelock import FileLock

    tiny(tmp_path / "in", "6")
    (tmp_path / "out").mkdir()
    with FileLock(tmp_path / "out" / "cohort.lock"), pytest.raises(InputError, match="another run has the folder"):
        cohort(tmp_path)


@pytest.mark.parametrize("protocol", ["", "file://"])
def test_a_root_below_another_is_refused_for_its_series_would_count_twice(tmp_path: Path, protocol: str) -> None:
    tiny(tmp_path / "in" / "a", "6")
    tiny(tmp_path / "in b", "7")

    def run(*names: str) -> Counts:
        roots = [f"{protocol}{tmp_path}/{name}" for name in names]
        return run_cohort(roots, tmp_path / "out", Rules(rule=(RULE,)), module=FAKE, workers=1)

    with pytest.raises(InputError, match=r"in/a lies below .*/in,"):
        run("in", "in b", "in/a/")
    with pytest.raises(InputError, match="no file or folder"):
        run("in/misspelt")
    assert run("in", "in/", "in b").done == 2  # the same by two names
    with pytest.raises(InputError, match=r"in/a lies below .*/in,"):  # of an earlier run, too
        run("in/a")


def test_a_folder_that_cannot_be_used_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny(tmp_path / "in", "6")
    cohort(tmp_path)

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(parquet, "ParquetWriter", full)
        with pytest.raises(InputError, match=r"cannot write .*series\.parquet: .*No space left"):
            cohort(tmp_path)
    with Index(tmp_path / "out") as index:
        index.run("ALTER TABLE series DROP COLUMN reason")  # as another version may have it
    with pytest.raises(InputError, match="no such column: reason"):
        cohort(tmp_path)
    (tmp_path / "out" / "index.sqlite").write_bytes(b"damaged" * 1000)
    with pytest.raises(InputError, match="not a database"):
        cohort(tmp_path)
    (tmp_path / "out" / "cohort.lock").unlink()
    (tmp_path / "out" / "cohort.lock").mkdir()
    with pytest.raises(InputError, match=r"cannot write .*cohort\.lock"):
        cohort(tmp_path)


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="the system has no groups of processes")
def test_a_run_that_is_interrupted_at_the_terminal_says_no_more_than_that(tmp_path: Path, log: Path) -> None:
    tiny(tmp_path / "in", "1")  # hangs
    code = (
        "import pathlib, sys\n"
        "from ronnaplan.cohort.cohort import run_cohort\n"
        "from ronnaplan.cohort.rules import Rules\n"
        f"try: run_cohort(['in'], pathlib.Path('out'), Rules(), module={FAKE!r}, workers=1)\n"
        "except KeyboardInterrupt: print('stopped', file=sys.stderr)"
    )
    command = [sys.executable, "-c", code]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True)
    while process.poll() is None and not log.read_text():
        time.sleep(0.05)
    for _ in range(3):  # whoever is impatient
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all of its group
        time.sleep(0.03)
    assert process.communicate(timeout=60)[1] == "stopped\n"


def test_series_of_no_rule_are_left_and_the_last_listing_can_be_taken(
    tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny(tmp_path / "in" / "a", "6")
    tiny(tmp_path / "in" / "b", "7")
    rule = CohortRule(name="a", diameters=(11.5,), folder="A*")
    counts = cohort(tmp_path, rule)
    assert (counts.done, counts.left, counts.idle_rules) == (1, 1, ())
    assert {row["folder"]: row["state"] for row in table(tmp_path)} == {"a": "done", "b": "left"}
    tiny(tmp_path / "in" / "a", "8")
    begun(log)
    cohort(tmp_path, RULE, list_roots=False)
    assert begun(log) == {"7": 1}
    counts = cohort(tmp_path, CohortRule(name="misspelt", diameters=(11.5,), folder="c*"), list_roots=False)
    assert (counts.done, counts.left, counts.idle_rules) == (0, 2, ("misspelt",))
    assert {row["state"] for row in table(tmp_path)} == {"left"}
    assert not table(tmp_path, "markers")
    monkeypatch.chdir(tmp_path / "in" / "a")  # the same root by another name
    run_cohort(["../../in/"], tmp_path / "out", Rules(rule=(RULE,)), module=FAKE, workers=1)
    assert begun(log) == {"8": 1}
    with Index(tmp_path / "out") as index:
        assert index.count("done") == 3
    with pytest.raises(InputError, match="nothing has been listed"):
        run_cohort([], tmp_path / "misspelt", Rules(rule=(RULE,)), list_roots=False)


def test_the_cluster_of_this_process_takes_no_samples_of_itself_and_is_none_of_the_network() -> None:
    with run.connected(None, 1) as client:
        assert client.cluster is not None
        (worker,) = client.cluster.workers.values()
        servers = (worker.http_server, client.cluster.scheduler.http_server)
        assert {server.address for server in servers} == {"127.0.0.1"}
        assert not {"profile", "profile-cycle"} & set(worker.periodic_callbacks)
        assert worker.periodic_callbacks["tick"].callback_time == 1000.0
        assert not logging.getLogger("tornado.application").isEnabledFor(logging.ERROR)  # what Ctrl-C interrupts
