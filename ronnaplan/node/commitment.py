"""Storage commitment, push model (PS3.4, annex J): what senders are promised, and what receivers promise for answers.

Promises live in the index: what a sender asks for is told to it, and what a receiver tells is noted, over restarts.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from pydicom.dataset import Dataset
from pydicom.uid import generate_uid

from ronnaplan.errors import InputError
from ronnaplan.node.facts import UID
from ronnaplan.node.index import Index
from ronnaplan.node.jobs import wait_s
from ronnaplan.text import printable

COMMITMENT: Final = "1.2.840.10008.1.20.1"
WELL_KNOWN: Final = "1.2.840.10008.1.20.1.1"
"""The one instance of the class that there is."""

ASK: Final = 1
ALL_KEPT, NOT_ALL_KEPT = 1, 2
"""Event types of a report."""

NO_SUCH_INSTANCE, OTHER_CLASS = 0x0112, 0x0119
"""Why an instance is not committed to (PS3.3, C.14.1.1)."""

MOST_NAMED: Final = 100_000
"""Instances in one request at most."""

Named = tuple[str, str]
"""SOP class and instance."""


@dataclass(frozen=True)
class Promise:
    """What a sender asked for and has not been told of."""

    transaction_uid: str
    peer: str
    named: str
    attempts: int


def asked_for(information: Dataset) -> tuple[str, list[Named]]:
    """Return the transaction and the instances that a request names; raises `InputError` for one that is none."""
    transaction, named = str(information.get("TransactionUID", "")), _named(information, "ReferencedSOPSequence")
    if UID.fullmatch(transaction) is None or not 0 < len(named) <= MOST_NAMED:
        raise InputError("a storage commitment request names no transaction or no instances; expected both")
    return transaction, named


def note_request(index: Index, peer: str, transaction: str, named: Sequence[Named], now: float) -> None:
    """Note what ``peer`` is to be told of, once for each transaction."""
    index.run(
        "INSERT INTO commitments VALUES (?, ?, ?, 0, ?, ?) ON CONFLICT DO NOTHING",
        *(transaction, peer, json.dumps(named), now, now),
    )


def announce_named(index: Index, named: Sequence[Named], now: float) -> None:
    """Take a request that names all of its series for their whole; one that names what is not there says nothing."""
    counts: Counter[str] = Counter()
    for _, uid in named:
        series = index.value(
            "SELECT series_uid FROM instances JOIN series ON series.id = series WHERE sop_uid = ?", uid
        )
        if series is None:
            return
        counts[series] += 1
    for series, count in counts.items():
        index.announce(series, count, now)


def outcome(index: Index, promise: Promise) -> tuple[int, Dataset]:
    """Return the event type and the report of what is kept, and what is not, of what a sender named."""
    kept, failed = [], []
    for sop_class, uid in json.loads(promise.named):
        found = index.value("SELECT sop_class FROM instances WHERE sop_uid = ?", uid)
        if found == sop_class:
            kept.append(_item(sop_class, uid))
        else:
            failed.append(_item(sop_class, uid, NO_SUCH_INSTANCE if found is None else OTHER_CLASS))
    report = Dataset()
    report.TransactionUID = promise.transaction_uid
    if kept:
        report.ReferencedSOPSequence = kept
    if failed:
        report.FailedSOPSequence = failed
    return NOT_ALL_KEPT if failed else ALL_KEPT, report


def begin_asking(index: Index, receiver: str, named: Sequence[Named]) -> tuple[str, Dataset]:
    """Note answers that ``receiver`` has taken and is to promise to keep; return the transaction and the request."""
    transaction = generate_uid()
    for _, uid in named:
        index.run("INSERT INTO asked VALUES (?, ?, ?)", transaction, uid, receiver)
    request = Dataset()
    request.TransactionUID = transaction
    request.ReferencedSOPSequence = [_item(sop_class, uid) for sop_class, uid in named]
    return transaction, request


def note_report(index: Index, receiver: str, report: Dataset, now: float, retry_s: float) -> tuple[int, int]:
    """Note what ``receiver`` keeps; all else that it was asked for is delivered again. Returns the numbers of both.

    Raises `InputError` for a transaction that it was not asked for.
    """
    transaction = str(report.get("TransactionUID", ""))
    with index.transaction():
        waited = dict(
            index.rows(
                "SELECT asked.answer, attempts FROM asked JOIN deliveries USING (answer, receiver)"
                " WHERE transaction_uid = ? AND receiver = ?",
                *(transaction, receiver),
            )
        )
        if not waited:
            raise InputError(f"nothing was asked for in transaction '{printable(transaction, 80)}'")
        refused = {uid for _, uid in _named(report, "FailedSOPSequence")}
        kept = [uid for _, uid in _named(report, "ReferencedSOPSequence") if uid in waited and uid not in refused]
        failed = [uid for uid in waited if uid not in kept]  # what it passes over it does not promise to keep
        for uid in kept:
            index.run("UPDATE deliveries SET state = 'kept' WHERE answer = ? AND receiver = ?", uid, receiver)
        for uid in failed:
            index.run(
                "UPDATE deliveries SET state = 'waiting', due = ?, reason = 'it was taken but is not kept'"
                " WHERE answer = ? AND receiver = ?",
                *(now + wait_s(waited[uid], retry_s), uid, receiver),
            )
        index.run("DELETE FROM asked WHERE transaction_uid = ?", transaction)
    return len(kept), len(failed)


def _item(sop_class: str, uid: str, reason: int | None = None) -> Dataset:
    item = Dataset()
    item.ReferencedSOPClassUID, item.ReferencedSOPInstanceUID = sop_class, uid
    if reason is not None:
        item.FailureReason = reason
    return item


def _named(information: Dataset, keyword: str) -> list[Named]:
    items: Any = information.get(keyword) or []
    return [
        (str(one.get("ReferencedSOPClassUID", "")), str(one.get("ReferencedSOPInstanceUID", ""))) for one in items
    ]
