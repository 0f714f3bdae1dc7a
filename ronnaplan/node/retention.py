"""What was kept long enough is removed: by the thread that takes instances, so that it removes none that just came."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Final

from ronnaplan.node.audit import DELETED, Audit, Instances
from ronnaplan.node.index import Index, SeriesRow
from ronnaplan.node.logs import Log

DAY_S: Final = 86_400.0
OLD = """
FROM series WHERE received < ? AND complete = revision
AND id NOT IN (SELECT series FROM jobs WHERE state IN ('waiting', 'running'))
AND id NOT IN (SELECT series FROM jobs JOIN answers ON job = jobs.id JOIN deliveries ON answer = sop_uid
               WHERE deliveries.state = 'waiting')
"""
"""Series that nothing was added to since a time, and that owe nobody an answer."""


LONGEST_STEP_S: Final = DAY_S
"""A clock that has gone on by more since it was last looked at may be wrong; nothing is removed for as long then."""


def is_held_back(index: Index, now: float, log: Log) -> bool:
    """Note that the clock says ``now`` (seconds since 1970); whether it went on so far that nothing may be removed.

    A node that did not run for so long has as much time to be told of it, which does no harm.
    """
    looked, held = next(iter(index.rows("SELECT looked, held FROM clock")), (now, now))
    if now - looked > LONGEST_STEP_S:
        held = now + LONGEST_STEP_S
        log.tell(
            "held back",
            reason=f"the clock went on by {(now - looked) / DAY_S:.1f} days since it was last looked at; it may be "
            "wrong, so nothing is removed for a day",
        )
    index.run("INSERT OR REPLACE INTO clock VALUES (1, ?, ?)", now, held)
    return bool(now < held <= now + LONGEST_STEP_S)  # later than that by a clock that was ahead


def remove_old(folder: Path, index: Index, before: float, log: Log, audit: Audit) -> None:
    """Remove all that came before a time (seconds since 1970): series, their answers, what was kept aside.

    Their rows go first: files without one are removed when the node starts.
    """
    with index.transaction():
        old = index.records(SeriesRow, OLD, before)
        files = [path for series in old for path in _files(index, series.id)]
        gone = [Instances.received(index, series.study_uid, series.id) for series in old]
        files += [path for (path,) in index.rows("SELECT path FROM aside WHERE received < ?", before)]
        for series in old:
            index.run("DELETE FROM series WHERE id = ?", series.id)
        for table in ("aside", "commitments", "steps", "announced"):
            index.run(f"DELETE FROM {table} WHERE received < ?", before)
    for path in files:
        (folder / path).unlink(missing_ok=True)
        with suppress(OSError):  # not empty
            (folder / path).parent.rmdir()
            (folder / path).parent.parent.rmdir()
    for series, instances in zip(old, gone, strict=True):
        audit.accessed(DELETED, instances, reason="kept long enough", series=series.series_uid)
        log.tell("removed", study=series.study_uid, series=series.series_uid, reason="kept long enough")


def remove_unknown_answers(data: Path, folder: Path, index: Index) -> None:
    """Remove the files in ``folder`` that are no answers: of a worker that was killed, or that came too late."""
    known = {path for (path,) in index.rows("SELECT path FROM answers")}
    for path in list(folder.rglob("*")):
        if path.is_file() and path.relative_to(data).as_posix() not in known:
            path.unlink(missing_ok=True)
            with suppress(OSError):  # not empty
                path.parent.rmdir()


def _files(index: Index, series: int) -> list[str]:
    return [
        path
        for (path,) in index.rows(
            "SELECT path FROM instances WHERE series = ?"
            " UNION ALL SELECT path FROM answers JOIN jobs ON job = jobs.id WHERE series = ?",
            series,
            series,
        )
    ]
