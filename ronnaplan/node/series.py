"""When a series is complete, and which rule it falls under."""

from __future__ import annotations

from ronnaplan.jobs.rules import first_fitting
from ronnaplan.node.classes import SCANS
from ronnaplan.node.config import Config, Rule
from ronnaplan.node.index import Index, SeriesRow
from ronnaplan.node.logs import Log

HOLDS_SCAN = f"""EXISTS (SELECT 1 FROM instances WHERE series = series.id
AND sop_class IN ({", ".join(f"'{one}'" for one in SCANS)}))"""
"""Of a series; dose reports, pictures of the screen and the like are kept, and not worked on."""
UNRULED = f"""
FROM series WHERE complete = revision AND {HOLDS_SCAN}
AND NOT EXISTS (SELECT 1 FROM jobs WHERE series = series.id AND jobs.revision = series.revision AND state != 'outdated')
"""
"""Series that are complete and that nothing was done with: no rule fitted, or theirs was gone and no other one did."""


def rule_for(series: SeriesRow, rules: tuple[Rule, ...]) -> Rule | None:
    """Return the first rule whose patterns all fit."""
    return first_fitting(rules, {name: getattr(series, name) for name in Rule.patterns})


class SeriesWatch:
    """Makes one job of every complete series, and another one when late slices opened it again.

    Rules may have changed since the last node ended: what none fitted and one fits now is opened at the beginning.
    """

    def __init__(self, config: Config, index: Index, log: Log) -> None:
        self._config, self._index, self._log = config, index, log
        for series in index.records(SeriesRow, UNRULED):
            if rule_for(series, config.rule) is not None:
                index.run("UPDATE series SET complete = 0 WHERE id = ?", series.id)
        self._rename()

    def _rename(self) -> None:
        """Put the jobs of rules that are no longer there under those that fit: a rule may have another name now."""
        names = {rule.name for rule in self._config.rule}
        for job, series_id, name in self._index.rows("SELECT id, series, rule FROM jobs"):
            if name in names:
                continue
            (series,) = self._index.records(SeriesRow, "FROM series WHERE id = ?", series_id)
            rule = rule_for(series, self._config.rule)
            if rule is not None:
                self._index.run("UPDATE jobs SET rule = ? WHERE id = ?", rule.name, job)

    def tick(self, now: float, listening_since: float = 0.0) -> None:
        """Note what is complete at ``now`` (both in seconds since 1970).

        A time in which nobody could send is no quiet one.
        """
        quiet_since, missing_since = (
            since if listening_since <= since else 0.0
            for since in (now - self._config.quiet_s, now - self._config.missing_s)
        )
        for series in self._index.complete_series(quiet_since, missing_since):
            self._complete(series, now)

    def _complete(self, series: SeriesRow, now: float) -> None:
        is_scan = self._index.rows(f"SELECT 1 FROM series WHERE id = ? AND {HOLDS_SCAN}", series.id)
        rule = rule_for(series, self._config.rule) if is_scan else None
        with self._index.transaction():
            # only as it was looked at: an instance that came meanwhile keeps it open
            found = self._index.run(
                "UPDATE series SET complete = revision WHERE id = ? AND revision = ?", series.id, series.revision
            )
            if found and rule is not None:
                self._index.run(
                    "INSERT INTO jobs (series, revision, rule, state, due, completed) VALUES (?, ?, ?, 'waiting', ?, ?)"
                    " ON CONFLICT DO UPDATE SET rule = excluded.rule, state = excluded.state, attempts = 0,"
                    " due = excluded.due WHERE state = 'outdated'",
                    *(series.id, series.revision, rule.name, now, now),
                )
        if found:
            self._log.tell(
                "complete",
                study=series.study_uid,
                series=series.series_uid,
                instances=series.instances,
                announced=series.expected,
                rule=None if rule is None else rule.name,
            )
