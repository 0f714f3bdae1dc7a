"""Brings the index up to date with what lies below the roots: headers are read of new and changed files only.

Nothing is held in memory for each file: what is met goes to a table on the disk, and SQL tells what is new.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import islice
from typing import Final, NamedTuple, TypeVar

from ronnaplan.cohort.facts import rule_texts
from ronnaplan.cohort.index import TEXTS, Index
from ronnaplan.cohort.places import LIMITS, Met, Place
from ronnaplan.ct.catalogue import read_instance
from ronnaplan.ct.files import Blob, Skipped
from ronnaplan.ct.slices import Instance
from ronnaplan.errors import InputError
from ronnaplan.text import printable

CHUNK: Final = 1000
"""Files whose headers are read between two commits: what a killed listing has to do again."""
REQUESTS: Final = 32
"""Headers that are fetched at one time from behind a URL."""
FIRST: Final = "ORDER BY files.place, files.folder, files.name LIMIT 1"
"""Of a series' files, the one that describes it, whatever was listed when."""
FIRST_FOLDER: Final = f"(SELECT files.folder FROM files WHERE files.series = series.id {FIRST})"
"""Where a series lies."""
PARTLY: Final = "some of its files cannot be read"
"""What the index has of an archive of which some members are missing."""
WAS_THERE: Final = "place = ? AND NOT (trouble AND stamp = '')"
"""Files of a root, without what could not be opened when it was listed last: of that there is nothing to lose."""
NESTED: Final = "an archive within an archive is not unpacked; unpack the outer one"

Item = TypeVar("Item")


@dataclass
class Listed:
    """What a listing met: files of roots, those that were new or changed, and what could not be opened."""

    files: int = 0
    changed: int = 0
    skipped: list[str] = field(default_factory=list)


class _LookedInto(NamedTuple):
    """A file whose header was read; ``instance`` is None where it belongs to no series, for a reason."""

    met: Met
    instance: Instance | None
    reason: str = ""
    is_trouble: bool = False
    told: str = ""
    """What the user is told of a file that may hold images and was not looked into."""
    is_archive: bool = False


def bring_up_to_date(index: Index, roots: Sequence[str], *, progress: bool = False) -> Listed:
    """List ``roots`` and enter what changed; raises `InputError` for a root that is not there.

    The index's own folder is left out, should it lie below a root: it holds results.
    """
    listed = Listed()
    for root in roots:
        _list_root(index, Place(root), listed, progress)
    with index.transaction():
        index.run("DELETE FROM series WHERE NOT EXISTS (SELECT 1 FROM files WHERE files.series = series.id)")
        index.run(f"UPDATE series SET folder = {FIRST_FOLDER} WHERE folder != {FIRST_FOLDER}")
        index.run(
            "DELETE FROM places WHERE archive != '' AND NOT EXISTS (SELECT 1 FROM files WHERE archive = places.id)"
        )
    for place in map(Place, roots):  # each time, though nothing is read of archives that are as they were
        left = index.left_out(place.root, NESTED)
        listed.skipped += [printable(f"{place.path('', archive)}:{member}: {NESTED}") for archive, member in left]
    return listed


def require_usable(root: str) -> None:
    """Raise `InputError` for a root that is not there, or is a file that holds no DICOM images."""
    place = Place(root)
    first = next(place.files([]), None)
    if first is None or not place.is_file:
        return
    looked = _looked_into(place, first, place.blob(first.folder, first.name, first.size))
    if looked.instance is None and not looked.is_archive and not looked.is_trouble:
        raise InputError(
            f"{printable(root)} is neither a DICOM image nor a zip archive; name a folder, an archive, a DICOMDIR or "
            "a URL"
        )


def _list_root(index: Index, place: Place, listed: Listed, progress: bool) -> None:
    number = index.place(place)
    skipped: list[Skipped] = []
    with index.transaction():
        index.run("DROP TABLE IF EXISTS temp.met")
        index.run("CREATE TEMP TABLE met (folder, name, size, stamp, PRIMARY KEY (folder, name)) WITHOUT ROWID")
        met = _shown(place.files(skipped, index.folder), None, progress, f"listing {printable(place.root)}")
        index.run_many("INSERT OR REPLACE INTO met VALUES (?, ?, ?, ?)", met)
        index.run("DROP TABLE IF EXISTS temp.changed")
        index.run(
            "CREATE TEMP TABLE changed AS SELECT met.* FROM met LEFT JOIN files AS old"
            " ON old.place = ? AND old.folder = met.folder AND old.name = met.name"
            " WHERE old.name IS NULL OR old.size != met.size OR old.stamp != met.stamp"
            " OR old.trouble OR (old.archive IS NOT NULL AND old.reason != '')"  # a disk or a network may have failed
            " ORDER BY met.folder, met.name",
            number,
        )
        count = index.value("SELECT COUNT(*) FROM met")
        trouble = [one for one in skipped if one.is_trouble]
        if not (count or trouble) and index.value(f"SELECT 1 FROM files WHERE {WAS_THERE} LIMIT 1", number):
            trouble.append(Skipped(printable(place.root), "it is empty, and was not; is its disk there?", True))
        unopened = {place.below(one.path): one.reason for one in trouble}
        _remove_lost(index, number, unopened)
        _enter_unopened(index, number, unopened)
    changed = index.value("SELECT COUNT(*) FROM changed")
    listed.files += count
    listed.changed += changed
    listed.skipped += [f"{one.name}: {one.reason}" for one in trouble]
    looked = _look_into(place, _shown(_changed(index), changed, progress, "reading headers"))
    for chunk in _chunks(looked, CHUNK):
        with index.transaction():
            _enter(index, number, [one for one in chunk if not one.is_archive], listed)
        for one in chunk:
            if one.is_archive:
                _list_archive(index, number, place.root, one.met, listed)


def _remove_lost(index: Index, number: int, unopened: Iterable[str]) -> None:
    """Remove the files of a root that were not met, within a transaction, but for those below what is ``unopened``."""
    index.run("CREATE TEMP TABLE IF NOT EXISTS unopened (path)")
    index.run("DELETE FROM unopened")
    index.run_many("INSERT INTO unopened VALUES (?)", [(path,) for path in unopened])
    _remove(
        index,
        "place = ? AND NOT EXISTS (SELECT 1 FROM met WHERE met.folder = files.folder AND met.name = files.name)"
        " AND NOT EXISTS (SELECT 1 FROM unopened WHERE path = ''"
        " OR instr(ltrim(files.folder || '/', '/') || files.name || '/', path || '/') = 1)",
        number,
    )


def _enter_unopened(index: Index, number: int, unopened: Mapping[str, str]) -> None:
    """Enter folders and links of a root that cannot be opened, each with its reason, within a transaction.

    They are told on the page, and series beside them are flagged, as for files. What was a file stays one.
    """
    index.run_many(
        "INSERT INTO files (place, folder, name, size, stamp, trouble, reason) VALUES (?, ?, ?, 0, '', 1, ?)"
        " ON CONFLICT DO UPDATE SET reason = excluded.reason WHERE series IS NULL",
        [(number, *path.rpartition("/")[::2], reason) for path, reason in unopened.items()],
    )


def _changed(index: Index) -> Iterator[Met]:
    """Yield what `_list_root` found new or changed; the index may be changed meanwhile."""
    last = 0
    while rows := index.rows("SELECT rowid, * FROM changed WHERE rowid > ? ORDER BY rowid LIMIT ?", last, CHUNK):
        yield from (Met(*row[1:]) for row in rows)
        last = rows[-1][0]


def _look_into(place: Place, changed: Iterable[Met]) -> Iterator[_LookedInto]:
    def look(met: Met) -> _LookedInto:
        return _looked_into(place, met, place.blob(met.folder, met.name, met.size))

    if not place.is_remote:
        yield from map(look, changed)
        return
    with ThreadPoolExecutor(REQUESTS) as pool:
        for chunk in _chunks(changed, 4 * REQUESTS):
            yield from pool.map(look, chunk)


def _looked_into(place: Place, met: Met, blob: Blob) -> _LookedInto:
    skipped: list[Skipped] = []
    instance = read_instance(blob, LIMITS, skipped)
    if instance is not None:
        return _LookedInto(met, instance)
    (why,) = skipped
    is_zip = met.name.lower().endswith(".zip")  # if it holds something else, it is told as damaged when opened
    if place.is_archive(met.folder, met.name, met.size) or (is_zip and not place.archive and not why.is_trouble):
        return _LookedInto(met, None, is_archive=True)
    if place.archive and is_zip:
        return _LookedInto(met, None, NESTED, why.is_trouble)
    told = f"{why.name}: {why.reason}" if why.is_trouble else ""
    return _LookedInto(met, None, why.reason, why.is_trouble, told)


def _list_archive(index: Index, number: int, root: str, met: Met, listed: Listed) -> None:
    """Enter a new or changed archive, as a place of its own, with all its members, or nothing of it.

    Of one that is as it was, only the members that could not be read are looked into.
    """
    place = Place(root, f"{met.folder}/{met.name}".lstrip("/"))
    skipped: list[Skipped] = []
    with index.transaction():
        inside = index.place(place)
        is_same = index.value(
            "SELECT 1 FROM files WHERE (place, folder, name, size, stamp, reason) = (?, ?, ?, ?, ?, ?)",
            *(number, *met, PARTLY),
        )
        _remove(index, "place = ? AND (trouble OR NOT ?)", inside, bool(is_same))
        known = set(index.rows("SELECT folder, name FROM files WHERE place = ?", inside))
        reason = ""
        try:
            members = (one for one in place.members(skipped) if one[0][:2] not in known)
            for chunk in _chunks((_looked_into(place, *member) for member in members), CHUNK):
                _enter(index, inside, chunk, listed)
        except InputError as error:
            reason = str(error)
            listed.skipped.append(reason)
        told = [f"{one.name}: {one.reason}" for one in skipped if one.is_trouble]
        listed.skipped += told
        if told or index.value("SELECT 1 FROM files WHERE place = ? AND trouble LIMIT 1", inside):
            reason = reason or PARTLY
        _remove(index, "place = ? AND folder = ? AND name = ?", number, met.folder, met.name)
        index.run(
            "INSERT INTO files (place, folder, name, size, stamp, archive, reason) VALUES (?, ?, ?, ?, ?, ?, ?)",
            *(number, *met, inside, reason),
        )


def _enter(index: Index, place: int, looked: Sequence[_LookedInto], listed: Listed) -> None:
    """Enter files that were looked into, within a transaction; the series that they are of, or were, have changed."""
    for one in looked:
        _remove(index, "place = ? AND folder = ? AND name = ?", place, one.met.folder, one.met.name)
    known: dict[tuple[str, str], int] = {}
    rows = []
    for one in looked:
        series = None
        if one.instance is not None:
            uids = (one.instance.study_uid or "", one.instance.series_uid or "")
            series = known.get(uids) or _series(index, place, uids)
            known[uids] = series
        rows.append((place, *one.met, series, one.is_trouble, one.reason))
    listed.skipped += [one.told for one in looked if one.told]
    index.run_many(  # archives may have several members of one name
        "INSERT OR REPLACE INTO files (place, folder, name, size, stamp, series, trouble, reason)"
        " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
        rows,
    )
    index.run_many("UPDATE series SET revision = revision + 1 WHERE id = ?", [(each,) for each in known.values()])
    headers = {(one.met.folder, one.met.name): one.instance for one in looked}
    for each in known.values():
        _describe(index, each, headers)


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


def _remove(index: Index, where: str, *values: object) -> None:
    """Remove files, within a transaction; the series that they were of have changed."""
    index.run(
        "UPDATE series SET revision = revision + 1 WHERE id IN"
        f" (SELECT series FROM files WHERE {where} AND series IS NOT NULL)",
        *values,
    )
    index.run(f"DELETE FROM files WHERE {where}", *values)


def _chunks(items: Iterable[Item], size: int) -> Iterator[list[Item]]:
    source = iter(items)
    while chunk := list(islice(source, size)):
        yield chunk


def _shown(items: Iterable[Item], total: int | None, progress: bool, what: str) -> Iterable[Item]:
    """Return ``items``, counted on a terminal as they come."""
    if not progress:
        return items
    from tqdm import tqdm

    return tqdm(items, total=total, desc=what, unit=" files", delay=1.0, leave=False, disable=None)
