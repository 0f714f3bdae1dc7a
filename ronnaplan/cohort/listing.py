"""Brings the index up to date with what lies below the roots: headers are read of new and changed files only.

Nothing is held in memory for each file: what is met goes to a table on the disk, and SQL tells what is new.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import islice
from typing import Final, TypeVar

from ronnaplan.cohort.entries import FIRST, LookedInto, enter, enter_unopened, remove
from ronnaplan.cohort.index import Index
from ronnaplan.cohort.places import LIMITS, Met, Place
from ronnaplan.ct.catalogue import read_instance
from ronnaplan.ct.files import Blob, Skipped
from ronnaplan.errors import InputError
from ronnaplan.text import printable

CHUNK: Final = 1000
"""Files whose headers are read between two commits: what a killed listing has to do again."""
REQUESTS: Final = 32
"""Headers that are fetched at one time from behind a URL."""
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
        enter_unopened(index, number, unopened)
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
    remove(
        index,
        "place = ? AND NOT EXISTS (SELECT 1 FROM met WHERE met.folder = files.folder AND met.name = files.name)"
        " AND NOT EXISTS (SELECT 1 FROM unopened WHERE path = ''"
        " OR instr(ltrim(files.folder || '/', '/') || files.name || '/', path || '/') = 1)",
        number,
    )


def _changed(index: Index) -> Iterator[Met]:
    """Yield what `_list_root` found new or changed; the index may be changed meanwhile."""
    last = 0
    while rows := index.rows("SELECT rowid, * FROM changed WHERE rowid > ? ORDER BY rowid LIMIT ?", last, CHUNK):
        yield from (Met(*row[1:]) for row in rows)
        last = rows[-1][0]


def _look_into(place: Place, changed: Iterable[Met]) -> Iterator[LookedInto]:
    def look(met: Met) -> LookedInto:
        return _looked_into(place, met, place.blob(met.folder, met.name, met.size))

    if not place.is_remote:
        yield from map(look, changed)
        return
    with ThreadPoolExecutor(REQUESTS) as pool:
        for chunk in _chunks(changed, 4 * REQUESTS):
            yield from pool.map(look, chunk)


def _looked_into(place: Place, met: Met, blob: Blob) -> LookedInto:
    skipped: list[Skipped] = []
    instance = read_instance(blob, LIMITS, skipped)
    if instance is not None:
        return LookedInto(met, instance)
    (why,) = skipped
    is_zip = met.name.lower().endswith(".zip")  # if it holds something else, it is told as damaged when opened
    if place.is_archive(met.folder, met.name, met.size) or (is_zip and not place.archive and not why.is_trouble):
        return LookedInto(met, None, is_archive=True)
    if place.archive and is_zip:
        return LookedInto(met, None, NESTED, why.is_trouble)
    told = f"{why.name}: {why.reason}" if why.is_trouble else ""
    return LookedInto(met, None, why.reason, why.is_trouble, told)


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
        remove(index, "place = ? AND (trouble OR NOT ?)", inside, bool(is_same))
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
        remove(index, "place = ? AND folder = ? AND name = ?", number, met.folder, met.name)
        index.run(
            "INSERT INTO files (place, folder, name, size, stamp, archive, reason) VALUES (?, ?, ?, ?, ?, ?, ?)",
            *(number, *met, inside, reason),
        )


def _enter(index: Index, place: int, looked: Sequence[LookedInto], listed: Listed) -> None:
    """Enter files that were looked into, within a transaction, and note what the user is told of them."""
    enter(index, place, looked)
    listed.skipped += [one.told for one in looked if one.told]


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
