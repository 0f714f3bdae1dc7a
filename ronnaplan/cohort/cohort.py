"""From roots to tables: lists, decides, works off, sums up. Killed at any time, the same call goes on."""

from __future__ import annotations

import logging
import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from ronnaplan.cohort import children
from ronnaplan.cohort.index import ASIDE, FILE, LEFT, WAITING, Index
from ronnaplan.cohort.listing import Listed, bring_up_to_date, require_usable
from ronnaplan.cohort.places import disk_name, is_url, kept_name
from ronnaplan.cohort.planning import decide, tasks_of
from ronnaplan.cohort.rules import Rules
from ronnaplan.cohort.run import connected, work_off
from ronnaplan.cohort.work import UNUSABLE
from ronnaplan.ct.catalogue import folder_of_index
from ronnaplan.ct.files import given_path
from ronnaplan.documents.files import make_folder
from ronnaplan.errors import InputError
from ronnaplan.extras import require_packages
from ronnaplan.jobs.rules import never_reached
from ronnaplan.jobs.serving import DONE, REFUSED
from ronnaplan.text import printable

LOG = logging.getLogger(__name__)
LOCK = "cohort.lock"
THIS_MACHINE = ("", "file", "local")
"""Protocols of URLs that mean a path here; "" where there is none."""
_ROOTS = "SELECT DISTINCT root FROM places WHERE EXISTS (SELECT 1 FROM files WHERE place = places.id)"


@dataclass(frozen=True)
class Counts:
    """What a run met and did: how many series it worked on, and how many are in each state now (parts of them)."""

    listed: Listed
    worked: int
    done: int
    refused: int
    unusable: int
    aside: int
    left: int
    idle_rules: tuple[str, ...]
    """Names of rules that no series goes by."""


def run_cohort(
    roots: Sequence[str],
    out: Path,
    rules: Rules,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    list_roots: bool = True,
    again: bool = False,
    module: str = children.WORKER,
    progress: bool = False,
) -> Counts:
    """Find the markers of every series below ``roots``; results, tables and page go to the folder ``out``.

    Without ``list_roots`` the series are those of the last listing; ``again`` tries once more what was set aside.
    Raises `InputError` where

    - a package of the extra ``cohort`` is not installed;
    - a root is not there, holds no images, is ``out``, or lies below another one;
    - another run has ``out``, nobody can write in it, its index is damaged, or it is removed meanwhile;
    - there is no last listing, or none of a root that is named;
    - the scheduler is lost.
    """
    require_packages("a cohort", "cohort", "distributed", "pyarrow", "fsspec")
    from ronnaplan.cohort.page import write_page
    from ronnaplan.cohort.tables import write_tables

    tasks = tasks_of(rules)
    for hidden, rule in never_reached(rules.rule):
        LOG.warning(
            "the rule '%s' is never reached: '%s', before it, fits all that it does", hidden.name, rule.name
        )
    places = list(dict.fromkeys(_whole(root) for root in roots))
    if list_roots:
        _check_roots(places, out)  # before there is a folder that tells of a run
    elif not (out / FILE).exists():
        raise _nothing_listed(out)
    make_folder(out)
    with _opened(out) as index:
        known = {root for (root,) in index.rows(_ROOTS)}
        if not list_roots:
            if not known:
                raise _nothing_listed(out)
            _require_listed(index, places)
        _require_apart({*places, *known})
        listed = bring_up_to_date(index, places, progress=progress) if list_roots else Listed()
        decide(index, rules, tasks, again=again)
        waiting = index.count(WAITING)
        if waiting:
            with connected(scheduler, workers) as client:
                work_off(client, index, out, rules, tasks, module=module, progress=progress)
        if not (out / FILE).exists():  # tables would tell of documents that are gone
            raise InputError(f"{printable(out)} was removed while the run wrote to it; run the same again")
        write_tables(index, out)
        write_page(index, out)
        return _counts(index, rules, listed, waiting)


def _counts(index: Index, rules: Rules, listed: Listed, worked: int) -> Counts:
    kept = (
        "SELECT parts.state, COUNT(*) FROM parts JOIN series ON series.id = parts.series WHERE series.state != ?"
    )
    parts = dict(index.rows(f"{kept} GROUP BY parts.state", LEFT))
    done, refused, unusable = (parts.get(state, 0) for state in (DONE, REFUSED, UNUSABLE))
    used = {name for (name,) in index.rows("SELECT DISTINCT rule FROM series")}
    idle = tuple(rule.name for rule in rules.rule if rule.name not in used)
    return Counts(listed, worked, done, refused, unusable, index.count(ASIDE), index.count(LEFT), idle)


def _whole(root: str) -> str:
    """Return a root by the one name that the index has for it."""
    if not is_url(root):
        return kept_name(os.path.abspath(given_path(root)))  # noqa: PTH100
    protocol, _, path = root.partition("://")
    return kept_name(f"{protocol}://{path.rstrip('/')}")


def _require_listed(index: Index, roots: Iterable[str]) -> None:
    """Raise `InputError` for a root that was never listed: it would be passed over."""
    listed = {root for (root,) in index.rows("SELECT root FROM places WHERE archive = ''")}
    for root in roots:
        if root not in listed:
            raise InputError(f"{printable(root)} has not been listed in {index.folder} yet; leave --as-listed out")


def _nothing_listed(out: Path) -> InputError:
    return InputError(f"nothing has been listed in {out} yet; name the roots, without --as-listed")


def _check_roots(roots: Sequence[str], out: Path) -> None:
    """Raise `InputError` for roots that cannot be listed into ``out``, which need not be there."""
    if _lies_at(_whole(str(out))) in map(_lies_at, roots):
        raise InputError(
            f"{printable(out)} is a root, too, so that results would lie among scans; name another OUT"
        )
    _require_apart(roots)
    for root in roots:
        require_usable(root)


def _require_apart(roots: Iterable[str]) -> None:
    """Raise `InputError` where a root lies below another, or is it by another name: its series would count twice."""
    placed = sorted((_lies_at(root).rstrip("/").split("/"), root) for root in roots)
    for (outer, other), (inner, one) in pairwise(placed):
        if inner[: len(outer)] == outer:
            where = "is the same as" if inner == outer else "lies below"
            raise InputError(
                f"{printable(one)} {where} {printable(other)}, so that its series would count twice; name one, in an "
                "OUT of its own"
            )


def _lies_at(root: str) -> str:
    """Return where a root really is, by whatever links, index or URL of this machine it is named."""
    protocol, _, path = root.rpartition("://")
    if protocol not in THIS_MACHINE:
        return root
    if protocol:
        from fsspec.core import strip_protocol  # file:///C:/x is C:/x, and ~ somebody's home

        path = strip_protocol(root)
    return os.path.realpath(folder_of_index(given_path(disk_name(path)))).replace(os.sep, "/")


@contextmanager
def _opened(out: Path) -> Iterator[Index]:
    """Give the index of a folder that no other run has meanwhile."""
    from filelock import FileLock, Timeout

    lock = FileLock(out / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise InputError(f"another run has the folder {out}; let it finish, or name another folder") from error
    except OSError as error:
        raise InputError(f"cannot write {out / LOCK}: {error.strerror}; choose another folder") from error
    try:
        with Index(out) as index:
            yield index
    except sqlite3.Error as error:  # a full disk, damage, an index of another version
        raise InputError(
            f"the index {out / FILE} cannot be used ({error}); see to its disk, or name another folder"
        ) from error
    finally:
        lock.release()
