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
"""A clock that has gone on by more since it was last looked at may be wrong, and is not trusted for as long."""


def trusted_time(index: Index, now: float, log: Log) -> float:
    """Note that the clock says ``now`` (seconds since 1970); return the time by which it is to be told what is old.

    For a day after the clock went on by more than a day that is when it was last looked at before. So a node that
    runs seldom, each time for less than a day, removes what was old when it ran last.
    """
    looked, trusted, until = next(iter(index.rows("SELECT looked, trusted, until FROM clock")), (now, now, now))
    if now - looked > LONGEST_STEP_S:
        trusted, until = looked, now + LONGEST_STEP_S
        log.tell(
            "held back",
            reason=f"the clock went on by {(now - looked) / DAY_S:.1f} days since it was last looked at; it may be "
            "wrong, so for a day nothing is removed that was not old by then",
        )
    index.run("INSERT OR REPLACE INTO clock VALUES (1, ?, ?, ?)", now, trusted, until)
    # it ends later than in a day by a clock that was ahead
    return float(min(now, trusted)) if now < until <= now + LONGEST_STEP_S else now


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
        for table in ("aside", "commitments", "steps", "announced", "lacking"):
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
    """Remove what in ``folder`` is no answer: of a worker that was killed, or that came too late."""
    known = {path for (path,) in index.rows("SELECT path FROM answers")}
    for path in sorted(folder.rglob("*"), reverse=True):  # what a folder holds before the folder
        if path.is_dir() and not path.is_symlink():
            with suppress(OSError):  # not empty
                path.rmdir()
        elif path.relative_to(data).as_posix() not in known:
            path.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


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
