"""A run on a Dask cluster, and the one of this process: the same tables, and what becomes of it is told."""

from __future__ import annotations

import logging
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from ronnaplan import scheduler
from ronnaplan.cli import main
from ronnaplan.cohort import run
from ronnaplan.cohort.cohort import Counts, run_cohort
from ronnaplan.cohort.rules import Rules
from ronnaplan.errors import InputError
from tests.cohort.runs import FAKE, RULE, begun, table
from tests.cohort.scans import tiny

pytestmark = pytest.mark.usefixtures("log")

HERE: dict[str, Any] = {"host": "127.0.0.1", "protocol": "tcp://", "processes": False, "dashboard_address": None}
"""A cluster within this process, reached as one elsewhere is."""


def test_a_cluster_gives_the_same_table_and_a_lost_or_absent_scheduler_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, log: Path
) -> None:
    from distributed import LocalCluster

    for name in range(20, 24):
        tiny(tmp_path / "in", str(name))
    rules = Rules(rule=(RULE,))
    given = [str(tmp_path / "in")]
    # Where workers are processes of their own, test_killed.py compares the tables.
    with LocalCluster(n_workers=2, threads_per_worker=1, **HERE) as cluster:
        counts = run_cohort(given, tmp_path / "out", rules, scheduler=cluster.scheduler_address, module=FAKE)
    assert (counts.worked, counts.done) == (4, 4)
    assert set(begun(log).values()) == {1}
    run_cohort(given, tmp_path / "here", rules, workers=1, module=FAKE)
    assert table(tmp_path, "markers") == table(tmp_path, "markers", "here")
    monkeypatch.setattr(scheduler, "ANSWERS_WITHIN", "1s")
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

    with LocalCluster(n_workers=0, threads_per_worker=1, **HERE) as cluster, ThreadPoolExecutor(1) as pool:
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


def test_the_cluster_of_this_process_takes_no_samples_of_itself_and_is_none_of_the_network() -> None:
    with run.connected(None, 1) as client:
        assert client.cluster is not None
        (worker,) = client.cluster.workers.values()
        servers = (worker.http_server, client.cluster.scheduler.http_server)
        assert {server.address for server in servers} == {"127.0.0.1"}
        assert not {"profile", "profile-cycle"} & set(worker.periodic_callbacks)
        assert worker.periodic_callbacks["tick"].callback_time == 1000.0
        for name in ("distributed.worker", "tornado.application"):  # what its end, or Ctrl-C, interrupts
            assert not logging.getLogger(name).isEnabledFor(logging.ERROR)


def test_a_run_on_this_machine_leaves_no_folder_of_dask_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    with run.connected(None, 1):
        assert not list(temporary.iterdir())  # nor one that is killed
    assert not list(temporary.iterdir())
