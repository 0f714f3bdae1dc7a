"""Answers on their way: each waits in the index until its receiver has it, over restarts, however long it takes."""

from __future__ import annotations

import sqlite3
import threading
import time
from dataclasses import dataclass
from typing import Final

from pydicom.dataset import Dataset

from ronnaplan.errors import InputError, RonnaplanError
from ronnaplan.node.audit import Audit, Instances
from ronnaplan.node.channels import Channel, open_channel
from ronnaplan.node.commitment import (
    COMMITMENT,
    WELL_KNOWN,
    Named,
    Promise,
    begin_asking,
    note_report,
    outcome,
)
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.index import Index
from ronnaplan.node.jobs import wait_s
from ronnaplan.node.logs import Log
from ronnaplan.node.services import Services
from ronnaplan.text import printable

MOST_AT_ONCE: Final = 32
"""Answers that go on one association."""
IDLE_S: Final = 0.2
RESTART_S: Final = 1.0
"""So often it is looked whether something is to be sent; after a failure of its own a sender waits for longer."""


@dataclass(frozen=True)
class Delivery:
    """An answer that its receiver does not have yet."""

    answer: str
    attempts: int
    sop_class: str
    path: str
    study_uid: str


class Sender(threading.Thread):
    """Delivers to one peer, in a thread of its own: one that is down delays no other one."""

    def __init__(self, config: Config, peer: Peer, log: Log) -> None:
        super().__init__(name=f"to {peer.name}", daemon=True)
        self._config, self._peer, self._log = config, peer, log
        self._audit = Audit(config.data, config.audit, config.titles[0], log)
        self._services = Services(config, log, lambda _: peer)
        self._ending = threading.Event()
        self._went = 0
        """How often, one time after the other, the receiver has gone when it was asked for storage commitment."""

    def run(self) -> None:
        """Deliver what is due until `stop`."""
        while not self._ending.is_set():
            try:
                with Index(self._config.data) as index:
                    while not self._ending.wait(IDLE_S):
                        self.deliver(index, time.time())
                        self.report(index, time.time())
            except (OSError, sqlite3.Error) as error:
                # a full disk, an index that another one holds: tried again
                self._log.tell("cannot deliver", receiver=self._peer.name, reason=str(error))
                self._ending.wait(RESTART_S)

    def stop(self) -> None:
        """End after what is being sent."""
        self._ending.set()
        self.join()

    def deliver(self, index: Index, now: float) -> None:
        """Send what is due at ``now`` (seconds since 1970)."""
        due = index.records(
            Delivery,
            "FROM (SELECT answer, deliveries.attempts AS attempts, sop_class, path, study_uid"
            " FROM deliveries JOIN answers ON answer = sop_uid JOIN jobs ON job = jobs.id"
            " JOIN series ON series = series.id"
            " WHERE receiver = ? AND deliveries.state = 'waiting' AND deliveries.due <= ? ORDER BY made LIMIT ?)",
            *(self._peer.name, now, MOST_AT_ONCE),
        )
        if not due:
            return
        self._count_attempt(index, due)
        sent: dict[tuple[str, str], Instances] = {}
        waiting = list(due)
        try:
            with open_channel(self._config, self._peer, self._services.note) as channel:
                taken: list[Named] = []
                while waiting:
                    one = waiting[0]
                    try:
                        channel.send(self._config.data / one.path)
                    except RonnaplanError as error:
                        self._later(index, one, str(error), now, sent)
                    else:
                        self._done(index, one, now, sent)
                        taken.append((one.sop_class, one.answer))
                    del waiting[0]
                if taken:
                    self._ask(index, channel, taken, now)
        except Exception as error:  # whatever a peer makes of it: told, and tried again
            for one in waiting:
                self._later(index, one, str(error), now, sent)
        address = self._peer.url or self._peer.host
        for (_, failure), moved in sent.items():
            self._audit.transferred(
                moved,
                source=self._config.titles[0],
                destination=self._peer.title,
                peer_address=address,
                failure=failure,
            )

    def _count_attempt(self, index: Index, due: list[Delivery]) -> None:
        """Count an attempt before anything is sent: what cannot be noted would be sent again and again."""
        with index.transaction():
            index.run_many(
                "UPDATE deliveries SET attempts = attempts + 1 WHERE answer = ? AND receiver = ?",
                [(one.answer, self._peer.name) for one in due],
            )

    def _ask(self, index: Index, channel: Channel, taken: list[Named], now: float) -> None:
        """Ask the receiver to promise to keep what it has taken, where it offers that; sent again if it goes.

        One that goes each time, as Orthanc does where it does not list this node, will promise nothing.
        """
        if not channel.commits:
            return
        with index.transaction():  # the report may come at once
            transaction, request = begin_asking(index, self._peer.name, taken)
        try:
            channel.ask(request)
        except InputError as error:
            self._unasked(index, transaction, error)
        except (RuntimeError, ValueError, OSError) as error:  # no connection any more
            self._went += 1
            if self._went > self._config.jobs.attempts:
                self._unasked(index, transaction, error)
                return
            asked = Dataset()
            asked.TransactionUID = transaction
            note_report(index, self._peer.name, asked, now, self._config.jobs.retry_s)
            self._log.tell("no commitment", receiver=self._peer.name, reason=str(error), again=True)
            return
        self._went = 0

    def _unasked(self, index: Index, transaction: str, error: Exception) -> None:
        """Be content with what was taken: nothing is promised."""
        index.run("DELETE FROM asked WHERE transaction_uid = ?", transaction)
        self._log.tell("no commitment", receiver=self._peer.name, reason=str(error))

    def report(self, index: Index, now: float) -> None:
        """Tell the peer what is kept of what it asked to have kept."""
        from ronnaplan.node.association import associated

        due = index.records(Promise, "FROM commitments WHERE peer = ? AND due <= ?", self._peer.name, now)
        for promise in due:
            try:
                with associated(self._config, self._peer, [], provided=[COMMITMENT]) as association:
                    kind, report = outcome(index, promise)
                    answer, _ = association.send_n_event_report(report, kind, COMMITMENT, WELL_KNOWN)
                    if answer.get("Status") != 0:
                        raise InputError(f"{self._peer.name} does not take the report")
            except Exception as error:  # whatever a peer makes of it: told, and tried again
                wait = wait_s(promise.attempts + 1, self._config.jobs.retry_s)
                index.run(
                    "UPDATE commitments SET attempts = attempts + 1, due = ? WHERE transaction_uid = ? AND peer = ?",
                    *(now + wait, promise.transaction_uid, promise.peer),
                )
                self._log.tell("not reported", peer=promise.peer, reason=str(error), again_in_s=round(wait))
            else:
                index.run(
                    "DELETE FROM commitments WHERE transaction_uid = ? AND peer = ?",
                    *(promise.transaction_uid, promise.peer),
                )
                self._log.tell(
                    "reported", peer=promise.peer, transaction=promise.transaction_uid, all_kept=kind == 1
                )

    def _done(self, index: Index, one: Delivery, now: float, sent: dict[tuple[str, str], Instances]) -> None:
        index.run(
            "UPDATE deliveries SET state = 'sent', reason = '', sent = ? WHERE answer = ? AND receiver = ?",
            *(now, one.answer, self._peer.name),
        )
        self._note(one, "", sent)
        self._log.tell("delivered", receiver=self._peer.name, sop_instance=one.answer)

    def _later(
        self, index: Index, one: Delivery, reason: str, now: float, sent: dict[tuple[str, str], Instances]
    ) -> None:
        wait = wait_s(one.attempts + 1, self._config.jobs.retry_s)
        index.run(
            "UPDATE deliveries SET due = ?, reason = ? WHERE answer = ? AND receiver = ?",
            *(now + wait, printable(reason), one.answer, self._peer.name),
        )
        self._note(one, reason, sent)
        self._log.tell(
            "not delivered",
            receiver=self._peer.name,
            sop_instance=one.answer,
            reason=reason,
            again_in_s=round(wait),
        )

    def _note(self, one: Delivery, failure: str, sent: dict[tuple[str, str], Instances]) -> None:
        """Note an answer for the audit trail, with those of its study that fared alike."""
        moved = sent.setdefault((one.study_uid, failure), Instances(one.study_uid))
        moved.add_file(one.sop_class, self._config.data / one.path)


def senders_of(config: Config, log: Log) -> list[Sender]:
    """Return one for each peer that gets answers, or reports on what is kept of its scans."""
    receivers = {name for rule in config.rule for name in rule.receivers}
    receivers |= {peer.name for peer in config.peer if peer.sends and peer.port}
    return [Sender(config, peer, log) for peer in config.peer if peer.name in receivers]
