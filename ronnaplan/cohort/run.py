"""Works off the waiting series on Dask: on this machine, or on the cluster that a scheduler's address names."""

from __future__ import annotations

import logging
import math
import os
import shutil
import signal
import tempfile
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ronnaplan.cohort import children
from ronnaplan.cohort.children import Outcome
from ronnaplan.cohort.index import WAITING, Index, SeriesRow
from ronnaplan.cohort.planning import TO_DO_AGAIN, orders, settings_of
from ronnaplan.cohort.results import keep, state_of
from ronnaplan.cohort.rules import Rules, Task
from ronnaplan.cohort.work import GONE
from ronnaplan.errors import InputError
from ronnaplan.jobs.serving import BROKEN
from ronnaplan.scheduler import client_of
from ronnaplan.threads import cores

if TYPE_CHECKING:
    from distributed import Client

LOG = logging.getLogger(__name__)

QUIET: Final = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
"""Dask settings of a cluster within this process, which otherwise takes a look at itself a hundred times a second, and
shows to whoever asks."""
HIDDEN: Final = "127.0.0.1:0"
"""Where its two web servers, which Dask does not do without, are: any free port of this machine, not of the network."""
ASK_AGAIN_S: Final = 5.0
"""How often it is asked how many workers there are."""
GONE_S: Final = 30.0
"""That all workers are gone is told after so long: who restarts one, or a cluster's manager, takes some seconds."""
POLL_S: Final = 0.02
AHEAD: Final = 2
"""Series that are sent ahead for each thread of a worker: it never waits for the next."""


@dataclass
class _Sent:
    series: SeriesRow
    order: dict[str, Any]
    limits: dict[str, Any]
    attempts: int = 1


class _Workers:
    """The workers' threads, counted now and then: workers come and go. That there are none is told, once each time."""

    def __init__(self, client: Client) -> None:
        self._client, self._threads, self._is_told = client, 0, False
        self._asked = self._seen = -math.inf

    def threads(self) -> int:
        """Return how many threads they have, at least one."""
        now = time.monotonic()
        if now >= self._asked + ASK_AGAIN_S:
            self._asked = now
            with suppress(OSError):  # of a scheduler that is lost the futures tell
                self._threads = sum(self._client.nthreads().values())
                self._tell(now)
        return max(self._threads, 1)

    def _tell(self, now: float) -> None:
        if self._threads:
            if self._is_told:
                LOG.warning("the Dask cluster has workers now: the run goes on")
            self._seen, self._is_told = now, False
        elif not self._is_told and now >= self._seen + GONE_S:
            LOG.warning("the Dask cluster has no workers; the run waits, and goes on when some come")
            self._is_told = True


@contextmanager
def connected(scheduler: str | None, workers: int | None) -> Iterator[Client]:
    """Give a Dask client: of the scheduler, or of as many threads here, each with a child process that works.

    Raises `InputError` where no scheduler answers.
    """
    import dask
    import distributed

    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # a lost scheduler is told in one sentence
    if scheduler is None:
        # nor what the end of the cluster, or Ctrl-C, interrupts in the midst of a call, nor that its folder is gone
        for name in ("distributed.worker", "distributed.diskutils", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        count = workers or cores()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            distributed.utils.get_ip()  # a machine without a network would be warned of it
        with (
            _interrupted_once(),
            tempfile.TemporaryDirectory(prefix="ronnaplan-", ignore_cleanup_errors=True) as scratch,
            dask.config.set({**QUIET, "temporary-directory": scratch}),  # it leaves a folder behind in any other
            distributed.LocalCluster(
                n_workers=1,
                threads_per_worker=count,
                processes=False,
                dashboard_address=HIDDEN,
                worker_dashboard_address=HIDDEN,
                scheduler_kwargs={"dashboard": False},
                memory_limit=0,
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            shutil.rmtree(scratch, ignore_errors=True)  # nothing is spilled; a run that is killed would leave it
            try:
                yield client
            finally:
                children.dismiss(busy=True)
        return
    with client_of(scheduler) as client:
        yield client
        with suppress(Exception):  # a worker that does not answer has no children to end
            client.run(children.dismiss)


@contextmanager
def _interrupted_once() -> Iterator[None]:
    """After one Ctrl-C hear no other: to end takes a moment, and ended amidst that Dask leaves tracebacks."""

    def interrupt(*_: object) -> None:
        # not SIG_IGN: of a second one that came just before, Python would say that it was ignored
        signal.signal(signal.SIGINT, lambda *_: None)
        raise KeyboardInterrupt

    is_heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not is_heard or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def work_off(
    client: Client,
    index: Index,
    out: Path,
    rules: Rules,
    tasks: Mapping[str, Task],
    *,
    module: str = children.WORKER,
    progress: bool = False,
) -> None:
    """Work on all waiting series, a few ahead of the workers at a time; each is kept as soon as it is done.

    Raises `InputError` where the scheduler is lost: all that was kept stays, and the same call goes on.
    """
    from distributed import as_completed
    from tqdm import tqdm

    waiting = orders(index, rules, tasks)
    workers = _Workers(client)
    sent: dict[str, _Sent] = {}
    queue = as_completed(raise_errors=False)
    with tqdm(
        total=index.count(WAITING), unit=" series", smoothing=0.02, disable=None if progress else True
    ) as bar:
        _fill(client, workers, waiting, sent, queue, module)
        for future in _ended(queue, workers):
            one = sent.pop(future.key)
            outcome = _outcome(future)
            if outcome is None:
                raise InputError(
                    "the Dask scheduler was lost; start it again, and then the same command: it goes on where it was"
                )
            future.release()
            if outcome["is_lost"] and one.attempts < one.limits["attempts"]:
                one.attempts += 1
                _send(client, one, sent, queue, module)
                continue
            if outcome["is_lost"]:
                outcome["reason"] += f", {one.attempts} times"
            settings = settings_of(tasks[one.series.rule], rules.limits, state_of(outcome), one.order["troubled"])
            keep(index, out, one.series, TO_DO_AGAIN if outcome["state"] == GONE else settings, outcome)
            bar.update()
            _fill(client, workers, waiting, sent, queue, module)


def _fill(
    client: Client,
    workers: _Workers,
    waiting: Iterator[tuple[SeriesRow, dict[str, Any], dict[str, Any]]],
    sent: dict[str, _Sent],
    queue: Any,
    module: str,
) -> None:
    """Send as many series as the workers' threads need, and no more: neither orders nor results pile up."""
    while len(sent) < AHEAD * workers.threads():
        given = next(waiting, None)
        if given is None:
            return
        _send(client, _Sent(*given), sent, queue, module)


def _send(client: Client, one: _Sent, sent: dict[str, _Sent], queue: Any, module: str) -> None:
    key = f"series-{one.series.id}-{one.attempts}-{os.urandom(4).hex()}"
    future = client.submit(children.work_on, one.order, one.limits, module, key=key, pure=False)
    sent[key] = one
    queue.add(future)


def _ended(queue: Any, workers: _Workers) -> Iterator[Any]:
    """Yield each future as it ends, and see meanwhile whether there are workers."""
    while not queue.is_empty():
        if queue.has_ready():
            yield next(queue)
        else:
            time.sleep(POLL_S)
            workers.threads()


def _outcome(future: Any) -> Outcome | None:
    """Return what became of an order; None where nobody knows, as the scheduler is gone."""
    if future.status == "finished":
        outcome: Outcome = future.result()
        return outcome
    if future.status != "error":
        return None
    error = future.exception()
    died = type(error).__name__ == "KilledWorker"
    reason = "the Dask workers that had it died" if died else f"{type(error).__name__}: {error}"
    return {"state": BROKEN, "reason": reason, "is_lost": died, "parts": [], "seconds": None, "peak_bytes": None}
