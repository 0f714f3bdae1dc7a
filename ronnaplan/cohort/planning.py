"""Which series are to be worked on, and the orders for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from ronnaplan import __version__
from ronnaplan.cohort.index import ASIDE, DONE, LEFT, TEXTS, WAITING, Index, SeriesRow
from ronnaplan.cohort.rules import Limits, Rules, Task
from ronnaplan.jobs.rules import first_fitting

CHUNK: Final = 1000
TO_DO_AGAIN: Final = ""
"""Settings of a series that the next run does again, whatever its own are."""


def tasks_of(rules: Rules) -> dict[str, Task]:
    """Return the rules with their documents read, by name; raises `RonnaplanError` for one that cannot be read."""
    return {rule.name: Task(rule, rules.home) for rule in rules.rule}


def decide(index: Index, rules: Rules, tasks: Mapping[str, Task], *, again: bool = False) -> None:
    """Set the state of every series: what was worked on stays so while its files, settings and version stay.

    A series that was set aside is tried again when its limits change, or ``again`` asks for it.
    """
    for chunk in _chunks(index, "1"):
        changes = []
        for series in chunk:
            rule = first_fitting(rules.rule, _texts(index, series))
            if rule is None:
                changes.append((LEFT, "", "no rule fits", series.id))
                continue
            state = _state(series, tasks[rule.name].settings, rules.limits, again)
            changes.append((state, rule.name, series.reason if state == series.state else "", series.id))
        with index.transaction():
            index.run_many("UPDATE series SET state = ?, rule = ?, reason = ?, attempts = 0 WHERE id = ?", changes)


def settings_of(task: Task, limits: Limits, state: str) -> str:
    """Return what results depend on beside the files: where there are none, the limits, too."""
    return f"{task.settings} {limits.model_dump_json()}" if state == ASIDE else task.settings


def orders(
    index: Index, rules: Rules, tasks: Mapping[str, Task]
) -> Iterator[tuple[SeriesRow, dict[str, Any], dict[str, Any]]]:
    """Yield each waiting series with its order and its limits; their states may change meanwhile."""
    limits = rules.limits.model_dump()
    for chunk in _chunks(index, f"state = '{WAITING}'"):
        for series in chunk:
            yield series, _order(index, series, tasks[series.rule]), limits


def _texts(index: Index, series: SeriesRow) -> dict[str, str]:
    """Return what rules look at; an archive below the root counts as one of the folders that the series lies in."""
    place = index.place_of(series.place)
    folders = [series.folder] if place.root.endswith(place.archive) else [place.archive, series.folder]
    return {name: getattr(series, name) for name in TEXTS} | {"folder": "/".join(filter(None, folders))}


def _state(series: SeriesRow, settings: str, limits: Limits, again: bool) -> str:
    if series.worked_revision != series.revision:
        return WAITING
    if series.worked_settings == settings:
        return DONE
    was_aside = series.worked_settings == f"{settings} {limits.model_dump_json()}"
    return ASIDE if was_aside and not again else WAITING


def _order(index: Index, series: SeriesRow, task: Task) -> dict[str, Any]:
    place = index.place_of(series.place)
    files = index.rows("SELECT folder, name, size FROM files WHERE series = ? ORDER BY folder, name", series.id)
    troubled = index.value(
        "SELECT 1 FROM files WHERE place = ? AND trouble AND folder IN"
        " (SELECT DISTINCT folder FROM files WHERE series = ?) LIMIT 1",
        series.place,
        series.id,
    )
    known = {}
    if series.worked_settings == task.settings:
        known = dict(index.rows("SELECT key, content FROM parts WHERE series = ?", series.id))
    return {
        "job": series.id,
        "root": place.root,
        "archive": place.archive,
        "series_uid": series.series_uid,
        "files": files,
        "troubled": troubled is not None,
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
