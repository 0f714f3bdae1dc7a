"""The queue of jobs: given to workers, watched, tried again, and none that another one waits for."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from ronnaplan.jobs.processes import Child
from ronnaplan.jobs.serving import BROKEN, DONE, REFUSED, heard
from ronnaplan.node.audit import CREATED, MINOR_FAILURE, READ, SERIOUS_FAILURE, SUCCESS, Audit, Instances
from ronnaplan.node.config import Config
from ronnaplan.node.index import LONGEST_WAIT_S, Index, SeriesRow
from ronnaplan.node.logs import Log
from ronnaplan.node.retention import remove_unknown_answers
from ronnaplan.node.series import rule_for
from ronnaplan.node.store import INSTANCES
from ronnaplan.node.work import Order
from ronnaplan.portable import GIVING_BACK
from ronnaplan.text import counted

ANSWERS = "answers"
RESTART_S: Final = 1.0
"""Wait before a worker takes the place of one that ended without having had a job."""


def wait_s(attempts: int, first_s: float) -> float:
    """Return how long to wait after so many attempts: twice as long after each, up to `LONGEST_WAIT_S`.

    >>> [wait_s(number, 30.0) for number in (1, 2, 3, 20)]
    [30.0, 60.0, 120.0, 3600.0]
    """
    return float(min(first_s * 2.0 ** min(attempts - 1, 20), LONGEST_WAIT_S))


@dataclass(frozen=True)
class JobRow:
    """A job as the index knows it."""

    id: int
    series: int
    revision: int
    rule: str
    state: str
    attempts: int
    due: float
    reason: str


@dataclass
class Worker:
    """A process that works, the job it has, and when that must be done."""

    child: Child
    is_ready: bool = False
    job: JobRow | None = None
    last: float = 0.0
    fault: str = ""
    left_out: list[str] = field(default_factory=list)
    """Which answers of its job cannot be made, and why."""


class Foreman:
    """Has the jobs of the index done. What workers say is heard in `tick` only: one thread changes the index."""

    def __init__(self, config: Config, index: Index, log: Log, module: str) -> None:
        self._config, self._index, self._log, self._module = config, index, log, module
        self._said: deque[tuple[int, str]] = deque()
        self._workers: dict[int, Worker] = {}
        self._next, self._hire_due = 0, 0.0
        self._audit = Audit(config.data, config.audit, config.titles[0], log)
        # a node that was killed left them: nobody works on them now
        index.run("UPDATE jobs SET state = 'waiting' WHERE state = 'running'")
        remove_unknown_answers(config.data, config.data / ANSWERS, index)

    def tick(self, now: float) -> None:
        """Hear what workers say, give out what is due at ``now`` (seconds since 1970)."""
        self._hear(now)
        for number, worker in list(self._workers.items()):
            self._watch(number, worker, now)
        self._hire_or_dismiss(min(self._config.jobs.workers, self._wanted(now)), now)
        for worker in self._workers.values():
            if worker.is_ready and worker.job is None and not self._give(worker, now):
                break

    def set_clock_back(self, now: float) -> None:
        """Wait for nothing longer than from ``now``: by a clock ahead a job that hangs would be ended when that is."""
        self._hire_due = min(self._hire_due, now + RESTART_S)
        for worker in self._workers.values():
            worker.last = min(worker.last, now + self._config.jobs.seconds)

    def set_clock_ahead(self, by_s: float) -> None:
        """Give each job as much time as it had before the clock went on ``by_s`` seconds in which nobody worked."""
        for worker in self._workers.values():
            worker.last += by_s

    def close(self) -> None:
        """End the workers; what they work on is done again by the next node."""
        for worker in self._workers.values():
            worker.child.kill()
            worker.child.end()

    @property
    def pids(self) -> list[int]:
        """The workers' numbers in the system."""
        return [worker.child.pid for worker in self._workers.values()]

    def _wanted(self, now: float) -> int:
        """Return how many workers have or will have something to do: one loads its code while a series comes in."""
        busy = sum(worker.job is not None for worker in self._workers.values())
        due = self._index.value("SELECT count(*) FROM jobs WHERE state = 'waiting' AND due <= ?", now)
        coming = any(rule_for(one, self._config.rule) for one in self._index.open_series())
        return int(busy + due + coming)

    def _hire_or_dismiss(self, wanted: int, now: float) -> None:
        """Have as many workers as are wanted; those that have a job are among them."""
        idle = [number for number, worker in self._workers.items() if worker.job is None]
        for number in idle[: max(0, len(self._workers) - wanted)]:
            self._dismiss(number)
        while now >= self._hire_due and len(self._workers) < wanted:
            self._hire()

    def _hire(self) -> None:
        number, self._next = self._next, self._next + 1
        child = Child(
            self._module,
            [str(self._config.jobs.memory_mib)],
            lambda line: self._said.append((number, line)),
            GIVING_BACK,
        )
        self._workers[number] = Worker(child)

    def _give(self, worker: Worker, now: float) -> bool:
        found = self._index.records(
            JobRow, "FROM jobs WHERE state = 'waiting' AND due <= ? ORDER BY due, id LIMIT 1", now
        )
        if not found:
            return False
        job = found[0]
        (series,) = self._index.records(SeriesRow, "FROM series WHERE id = ?", job.series)
        rule = next((one for one in self._config.rule if one.name == job.rule), None)
        if rule is None or series.revision != job.revision:
            reason = (
                "its rule is no longer there, and no other fits" if rule is None else "instances came after it"
            )
            self._end(job, "outdated", reason, now)
            return True
        have = tuple(kind for (kind,) in self._index.rows("SELECT kind FROM answers WHERE job = ?", job.id))
        data = self._config.data
        folder = data / INSTANCES / series.study_uid / series.series_uid
        output = data / ANSWERS / str(job.id)
        order = Order(job.id, folder, series.instances, self._config.home, output, rule, have)
        self._index.run("UPDATE jobs SET state = 'running', attempts = attempts + 1 WHERE id = ?", job.id)
        worker.job, worker.fault = replace(job, attempts=job.attempts + 1), ""
        worker.last = now + self._config.jobs.seconds
        worker.child.say(order.text)
        self._tell(job, "started", READ, SUCCESS)
        return True

    def _tell(self, job: JobRow, event: str, action: str, outcome: str, reason: str = "") -> None:
        """Enter in the audit trail that a scan was read, or that its answers were made."""
        study = self._index.value("SELECT study_uid FROM series WHERE id = ?", job.series)
        if action == READ:
            what = Instances.received(self._index, study, job.series)
        else:
            what = Instances(study)
            for sop_class, path in self._index.each("SELECT sop_class, path FROM answers WHERE job = ?", job.id):
                what.add_file(sop_class, self._config.data / path)
        details = {"job": str(job.id), "attempt": str(job.attempts), "rule": job.rule, "event": event}
        self._audit.accessed(action, what, outcome=outcome, reason=reason, **details)

    def _watch(self, number: int, worker: Worker, now: float) -> None:
        """End a worker that is too slow; see to the job of one that ended."""
        if worker.job is not None and now > worker.last and not worker.fault:
            worker.fault = f"it took longer than {self._config.jobs.seconds:g} s"
            worker.child.kill()
        status = worker.child.status
        if status is None:
            return
        self._hear(now)
        if number not in self._workers:
            return
        if worker.job is not None:
            self._broken(worker.job, worker.fault or f"its worker ended with status {status}", now)
        else:
            self._hire_due = now + RESTART_S
            self._log.tell("worker ended", status=status)
        self._dismiss(number)

    def _dismiss(self, number: int) -> None:
        """End a worker: what it told of is on the disk, and its code and what it freed take room until it is gone."""
        worker = self._workers.pop(number)
        worker.child.kill()
        worker.child.end()

    def _hear(self, now: float) -> None:
        while self._said:
            self._note(*self._said[0], now)
            self._said.popleft()  # only now: what a full disk keeps from being noted is noted later

    def _note(self, number: int, line: str, now: float) -> None:
        """Note what a worker said; once more, where the index could not be written."""
        worker, told = self._workers.get(number), heard(line)
        if worker is None or told is None:
            return
        if told["event"] == "ready":
            worker.is_ready = True
            self._log.tell("worker ready", process=worker.child.pid)
        elif worker.job is None or worker.job.id != told.get("job"):
            return
        elif told["event"] == "answer":
            self._answer(worker.job, told, now)
        elif told["event"] == "left out":
            worker.left_out.append(f"no {told['answer']}: {told['reason']}")
            self._log.tell("answer left out", job=worker.job.id, answer=told["answer"], reason=told["reason"])
        elif told["event"] == "left empty":
            self._log.tell("left empty", job=worker.job.id, reason=told["reason"])
        elif told["event"] == "ended":
            self._ended(number, worker.job, told, now)

    def _ended(self, number: int, job: JobRow, told: dict[str, Any], now: float) -> None:
        if told["state"] == BROKEN:
            self._broken(job, told["reason"], now, passes=told.get("passes", False))
        else:
            reason = "; ".join([told["reason"], *self._workers[number].left_out, *self._lacking(job)])
            self._end(job, DONE if told["state"] == DONE else REFUSED, reason, now)
        self._dismiss(number)

    def _lacking(self, job: JobRow) -> list[str]:
        """Say what a job's series lacks, in a sentence where that is anything."""
        count = self._index.lacking(job.series)
        return (
            [f"{counted(count, 'instance')} of it did not come again, for which there was no room"]
            if count
            else []
        )

    def _answer(self, job: JobRow, told: dict[str, Any], now: float) -> None:
        """Enter an object that is to be delivered, unless its series has changed meanwhile."""
        rule = next(one for one in self._config.rule if one.name == job.rule)
        path = Path(told["path"]).relative_to(self._config.data).as_posix()
        with self._index.transaction():
            if self._index.value("SELECT revision FROM series WHERE id = ?", job.series) != job.revision:
                return
            self._index.run(
                "INSERT INTO answers VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT DO NOTHING",
                *(told["sop_uid"], job.id, told["kind"], told["sop_class"], path, now),
            )
            for receiver in rule.receivers:
                self._index.run(
                    "INSERT INTO deliveries (answer, receiver, state, due) VALUES (?, ?, 'waiting', ?)"
                    " ON CONFLICT DO NOTHING",
                    *(told["sop_uid"], receiver, now),
                )
        self._log.tell("answer", job=job.id, kind=told["kind"], sop_instance=told["sop_uid"])

    def _broken(self, job: JobRow, reason: str, now: float, *, passes: bool = False) -> None:
        """Have a job done again, but for the last attempt; a fault that ``passes`` is waited for without end."""
        jobs = self._config.jobs
        if job.attempts >= jobs.attempts and not passes:
            self._end(job, "failed", f"{reason} (attempt {job.attempts}, the last)", now)
            return
        due = now + wait_s(job.attempts, jobs.retry_s)
        self._index.run("UPDATE jobs SET state = 'waiting', due = ?, reason = ? WHERE id = ?", due, reason, job.id)
        self._tell(job, "broken", READ, MINOR_FAILURE, reason)
        self._log.tell("job broken", job=job.id, attempt=job.attempts, reason=reason, again_in_s=round(due - now))

    def _end(self, job: JobRow, state: str, reason: str, now: float) -> None:
        self._index.run(
            "UPDATE jobs SET state = ?, reason = ?, ended = ? WHERE id = ?", state, reason, now, job.id
        )
        remove_unknown_answers(self._config.data, self._config.data / ANSWERS / str(job.id), self._index)
        outcome = {DONE: SUCCESS, "failed": SERIOUS_FAILURE}.get(state, MINOR_FAILURE)
        if state != "outdated":  # nothing was read
            self._tell(job, state, CREATED if state == DONE else READ, outcome, "" if state == DONE else reason)
        self._log.tell("job ended", job=job.id, state=state, reason=reason)


def retry(index: Index, job: int) -> bool:
    """Have a job that was refused or failed done again at once, with all its attempts; False where there is none."""
    return bool(
        index.run(
            "UPDATE jobs SET state = 'waiting', attempts = 0, due = 0, reason = '' "
            "WHERE id = ? AND state IN ('refused', 'failed')",
            job,
        )
    )
