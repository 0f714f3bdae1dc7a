"""Which series are to be worked on, and the orders for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from ronnaplan import __version__
from ronnaplan.cohort.index import ASIDE, DONE, LEFT, TEXTS, WAITING, Index, SeriesRow
from ronnaplan.cohort.listing import NESTED
from ronnaplan.cohort.rules import Limits, Rules, Task
from ronnaplan.jobs.rules import first_fitting

CHUNK: Final = 1000
"""Series that are taken out of the index together."""
TO_DO_AGAIN: Final = ""
"""Settings of a series that the next run does again, whatever its own are."""
TROUBLED: Final = "beside files that cannot be read"
"""Settings of a series whose results are flagged for that."""


def tasks_of(rules: Rules) -> dict[str, Task]:
    """Return the rules with their documents read, by name; raises `RonnaplanError` for one that cannot be read."""
    return {rule.name: Task(rule, rules.home) for rule in rules.rule}


def decide(index: Index, rules: Rules, tasks: Mapping[str, Task], *, again: bool = False) -> None:
    """Set the state of every series: what was worked on stays so while its files, settings and version stay.

    A series that was set aside is tried again when its limits change, or ``again`` asks for it; one of which documents
    were removed, too.
    """
    lost = _lost(index)
    with index.transaction():
        index.run_many("UPDATE series SET worked_settings = ? WHERE id = ?", [(TO_DO_AGAIN, one) for one in lost])
    troubled = _troubled(index)
    for chunk in _chunks(index, "1"):
        changes = []
        for series in chunk:
            rule = first_fitting(rules.rule, _texts(index, series))
            if rule is None:
                changes.append((LEFT, "", "no rule fits", series.id))
                continue
            state = _state(series, tasks[rule.name], rules.limits, series.id in troubled, again)
            changes.append((state, rule.name, series.reason if state == series.state else "", series.id))
        with index.transaction():
            index.run_many("UPDATE series SET state = ?, rule = ?, reason = ?, attempts = 0 WHERE id = ?", changes)


def settings_of(task: Task, limits: Limits, state: str, troubled: bool) -> str:
    """Return what results depend on beside the files of their series: where there are none, the limits, too."""
    settings = f"{task.settings} {TROUBLED}" if troubled else task.settings
    return f"{settings} {limits.model_dump_json()}" if state == ASIDE else settings


def orders(
    index: Index, rules: Rules, tasks: Mapping[str, Task]
) -> Iterator[tuple[SeriesRow, dict[str, Any], dict[str, Any]]]:
    """Yield each waiting series with its order and its limits; their states may change meanwhile."""
    limits = rules.limits.model_dump()
    troubled = _troubled(index)
    for chunk in _chunks(index, f"state = '{WAITING}'"):
        for series in chunk:
            task = tasks[series.rule]
            is_troubled = series.id in troubled
            is_known = series.worked_settings == settings_of(task, rules.limits, DONE, is_troubled)
            yield series, _order(index, series, task, is_troubled, is_known), limits


def _texts(index: Index, series: SeriesRow) -> dict[str, str]:
    """Return what rules look at; an archive below the root counts as one of the folders that the series lies in."""
    place = index.place_of(series.place)
    folders = [series.folder] if place.root.endswith(place.archive) else [place.archive, series.folder]
    return {name: getattr(series, name) for name in TEXTS} | {"folder": "/".join(filter(None, folders))}


def _troubled(index: Index) -> set[int]:
    """Return the series beside whose files, in one folder, something cannot be read: what they are flagged for."""
    rows = index.rows(
        "SELECT DISTINCT series FROM files WHERE series IS NOT NULL"
        " AND (place, folder) IN"
        " (SELECT place, folder FROM files WHERE (trouble OR reason = ?) AND name != '')",  # a root lies in none
        NESTED,
    )
    return {series for (series,) in rows}


def _lost(index: Index) -> set[int]:
    """Return the series of which a document is no longer there: somebody removed it."""
    rows = index.each("SELECT series, fiducials, sheet FROM parts")
    return {series for series, *names in rows if not all((index.folder / name).exists() for name in names if name)}


def _state(series: SeriesRow, task: Task, limits: Limits, troubled: bool, again: bool) -> str:
    if series.worked_revision != series.revision:
        return WAITING
    if series.worked_settings == settings_of(task, limits, DONE, troubled):
        return DONE
    was_aside = series.worked_settings == settings_of(task, limits, ASIDE, troubled)
    return ASIDE if was_aside and not again else WAITING


def _order(index: Index, series: SeriesRow, task: Task, troubled: bool, is_known: bool) -> dict[str, Any]:
    place = index.place_of(series.place)
    files = index.rows("SELECT folder, name, size FROM files WHERE series = ? ORDER BY folder, name", series.id)
    known = {}
    if is_known:
        known = dict(index.rows("SELECT key, content FROM parts WHERE series = ?", series.id))
    return {
        "job": series.id,
        "root": place.root,
        "archive": place.archive,
        "series_uid": series.series_uid,
        "files": files,
        "troubled": troubled,
        "known": known,
        "version": __version__,
        **task.order,
    }


def _chunks(index: Index, where: str) -> Iterator[list[SeriesRow]]:
    last = 0
    while chunk := index.records(
        SeriesRow, f"FROM series WHERE {where} AND id > ? ORDER BY id LIMIT ?", last, CHUNK
    ):
        yield chunk
        last = chunk[-1].id
