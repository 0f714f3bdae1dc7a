"""What the index has of the files below a root: entered with the series that they are of, and removed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from ronnaplan.cohort.facts import rule_texts
from ronnaplan.cohort.index import TEXTS, Index
from ronnaplan.cohort.places import Met
from ronnaplan.ct.slices import Instance

FIRST: Final = "ORDER BY files.place, files.folder, files.name LIMIT 1"
"""Of a series' files, the one that describes it, whatever was listed when."""


class LookedInto(NamedTuple):
    """A file whose header was read; ``instance`` is None where it belongs to no series, for a reason."""

    met: Met
    instance: Instance | None
    reason: str = ""
    is_trouble: bool = False
    told: str = ""
    """What the user is told of a file that may hold images and was not looked into."""
    is_archive: bool = False


def enter(index: Index, place: int, looked: Sequence[LookedInto]) -> None:
    """Enter files that were looked into, within a transaction; the series that they are of, or were, have changed."""
    for one in looked:
        remove(index, "place = ? AND folder = ? AND name = ?", place, one.met.folder, one.met.name)
    known: dict[tuple[str, str], int] = {}
    rows = []
    for one in looked:
        series = None
        if one.instance is not None:
            uids = (one.instance.study_uid or "", one.instance.series_uid or "")
            series = known.get(uids) or _series(index, place, uids)
            known[uids] = series
        rows.append((place, *one.met, series, one.is_trouble, one.reason))
    index.run_many(  # archives may have several members of one name
        "INSERT OR REPLACE INTO files (place, folder, name, size, stamp, series, trouble, reason)"
        " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
        rows,
    )
    index.run_many("UPDATE series SET revision = revision + 1 WHERE id = ?", [(each,) for each in known.values()])
    headers = {(one.met.folder, one.met.name): one.instance for one in looked}
    for each in known.values():
        _describe(index, each, headers)


def enter_unopened(index: Index, number: int, unopened: Mapping[str, str]) -> None:
    """Enter folders and links of a root that cannot be opened, each with its reason, within a transaction.

    They are told on the page, and series beside them are flagged, as for files. What was a file stays one.
    """
    index.run_many(
        "INSERT INTO files (place, folder, name, size, stamp, trouble, reason) VALUES (?, ?, ?, 0, '', 1, ?)"
        " ON CONFLICT DO UPDATE SET reason = excluded.reason WHERE series IS NULL",
        [(number, *path.rpartition("/")[::2], reason) for path, reason in unopened.items()],
    )


def remove(index: Index, where: str, *values: object) -> None:
    """Remove files, within a transaction; the series that they were of have changed."""
    index.run(
        "UPDATE series SET revision = revision + 1 WHERE id IN"
        f" (SELECT series FROM files WHERE {where} AND series IS NOT NULL)",
        *values,
    )
    index.run(f"DELETE FROM files WHERE {where}", *values)


def _describe(index: Index, series: int, headers: Mapping[tuple[str, str], Instance | None]) -> None:
    """Describe a series as its first file does, within a transaction, if that is one of those whose header was read."""
    first = index.rows(f"SELECT folder, name FROM files WHERE series = ? {FIRST}", series)
    instance = headers.get(first[0]) if first else None
    if instance is not None:
        values = ", ".join(f"{text} = ?" for text in TEXTS)
        index.run(f"UPDATE series SET {values} WHERE id = ?", *rule_texts(instance, first[0][0]), series)


def _series(index: Index, place: int, uids: tuple[str, str]) -> int:
    """Return the number of a series; a new one is described once its files are entered."""
    index.run(
        f"INSERT INTO series (place, study_uid, series_uid, {', '.join(TEXTS)})"
        f" VALUES (?, ?, ?, {', '.join('?' * len(TEXTS))}) ON CONFLICT DO NOTHING",
        *(place, *uids, *("" for _ in TEXTS)),
    )
    number: int = index.value(
        "SELECT id FROM series WHERE place = ? AND study_uid = ? AND series_uid = ?", place, *uids
    )
    return number
