"""Modality performed procedure steps (PS3.4, F.7): a scanner says that it is done, and with how many instances."""

from __future__ import annotations

from typing import Any, Final

from pydicom.dataset import Dataset

from ronnaplan.node.facts import UID
from ronnaplan.node.index import Index

PROCEDURE_STEP: Final = "1.2.840.10008.3.1.2.3.3"
IN_PROGRESS, COMPLETED, DISCONTINUED = "IN PROGRESS", "COMPLETED", "DISCONTINUED"

SUCCESS, INVALID_VALUE, NO_SUCH_INSTANCE, KNOWN_ALREADY, FINAL = 0x0000, 0x0106, 0x0112, 0x0111, 0x0110
"""Statuses of N-CREATE and N-SET (PS3.7, annex C)."""


def begin_step(index: Index, uid: str, calling: str, told: Dataset, now: float) -> int:
    """Note a step that a scanner begins; returns the status that it is told."""
    if UID.fullmatch(uid) is None or told.get("PerformedProcedureStepStatus") != IN_PROGRESS:
        return INVALID_VALUE
    new = index.run("INSERT INTO steps VALUES (?, ?, ?, ?) ON CONFLICT DO NOTHING", uid, calling, IN_PROGRESS, now)
    return SUCCESS if new else KNOWN_ALREADY


def change_step(index: Index, uid: str, calling: str, told: Dataset, now: float) -> tuple[int, dict[str, int]]:
    """Note what became of a step; of a completed one also how many instances each of its series has.

    Returns the status that the scanner is told, and these numbers.
    """
    with index.transaction():
        before = index.value("SELECT state FROM steps WHERE sop_uid = ? AND calling = ?", uid, calling)
        if before is None:
            return NO_SUCH_INSTANCE, {}
        if before != IN_PROGRESS:
            return FINAL, {}
        state = str(told.get("PerformedProcedureStepStatus", IN_PROGRESS))
        if state not in (IN_PROGRESS, COMPLETED, DISCONTINUED):
            return INVALID_VALUE, {}
        index.run("UPDATE steps SET state = ? WHERE sop_uid = ?", state, uid)
        counts = _instances(told) if state == COMPLETED else {}
        for series, count in counts.items():
            index.announce(series, count, now)
    return SUCCESS, counts


def _instances(told: Dataset) -> dict[str, int]:
    found: dict[str, int] = {}
    performed: Any = told.get("PerformedSeriesSequence") or []
    for series in performed:
        uid = str(series.get("SeriesInstanceUID", ""))
        count = sum(
            len(series.get(keyword) or [])
            for keyword in ("ReferencedImageSequence", "ReferencedNonImageCompositeSOPInstanceSequence")
        )
        if UID.fullmatch(uid) and count:
            found[uid] = count
    return found
