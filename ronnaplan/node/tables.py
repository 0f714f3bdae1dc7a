"""What the index holds, as a page for a person and as figures for Prometheus. Neither names a patient."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any, Final

from ronnaplan.ct.limits import MIB
from ronnaplan.node.index import Index
from ronnaplan.text import NOTICE, counted

METRICS: Final = "text/plain; version=0.0.4"
MOST_SHOWN: Final = 200
"""Rows of a table, the latest."""
AGAIN_S: Final = 5
"""After so long the page loads itself again."""
STILL: Final = "still"
"""In the page's address: it does not load itself again, by which focus and selection would be lost."""
STYLE: Final = """
body { font: 14px/1.45 system-ui, sans-serif; color: #1c2733; margin: 1.5rem }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums }
th, td { text-align: left; padding: .2rem 1rem .2rem 0; border-bottom: 1px solid #e4e9ee; vertical-align: top }
td:first-child { white-space: nowrap } td:nth-last-child(-n+2) { overflow-wrap: anywhere; min-width: 10rem }
th { color: #4a5a6a } .failed, .refused { color: #b3261e } form { display: inline } .note { color: #4a5a6a }
@media (max-width: 70rem) { /* a row stands upright, each cell beside its head */
  table, tbody, tr { display: block } tr { padding: .5rem 0; border-bottom: 1px solid #c8d2dc }
  tr.heads { display: none }
  td { display: flex; gap: .5rem; border: 0; overflow-wrap: anywhere; min-width: 0 }
  td::before { content: attr(data-head); flex: none; width: 6rem; color: #4a5a6a } td > span { min-width: 0 }
}
"""

SERIES: Final = """
SELECT series.received, calling, called, description, instances, expected, bytes, complete = series.revision,
       (SELECT count(*) FROM answers WHERE job = jobs.id),
       jobs.id, jobs.rule, jobs.state, jobs.attempts, jobs.reason, study_uid, series_uid
FROM series LEFT JOIN jobs ON jobs.series = series.id AND jobs.revision = series.revision
ORDER BY series.received DESC LIMIT ?
"""
DELIVERIES: Final = """
SELECT receiver, kind, deliveries.state, deliveries.attempts, deliveries.reason, answer
FROM deliveries JOIN answers ON answer = sop_uid WHERE deliveries.state = 'waiting' ORDER BY deliveries.due LIMIT ?
"""


def status_page(index: Index, *, still: bool = False) -> str:
    """Return the page: the newest series with their jobs, what waits to be delivered, what was kept aside.

    It loads itself again unless it is to stand ``still``, as for who reads it, or goes through it by keyboard.
    """
    series = [_series_row(*row) for row in index.rows(SERIES, MOST_SHOWN)]
    waiting = [[escape(str(cell)) for cell in row] for row in index.rows(DELIVERIES, MOST_SHOWN)]
    aside = [
        [_time(received), escape(calling), escape(sop_uid), escape(path)]
        for received, calling, sop_uid, path in index.rows(
            "SELECT received, calling, sop_uid, path FROM aside ORDER BY received DESC LIMIT ?", MOST_SHOWN
        )
    ]
    heads = (
        ("received", "from", "to", "description", "instances", "MiB", "complete", "rule", "job", "why", "series"),
        ("receiver", "answer", "state", "attempts", "why", "instance"),
        ("received", "from", "instance", "file"),
    )
    again = "" if still else f'<meta http-equiv="refresh" content="{AGAIN_S}">'
    other = '<a href="/">go on by itself</a>' if still else f'<a href="/?{STILL}">stand still</a>'
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8">{again}'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>ronnaplan node</title><style>{STYLE}</style></head><body><main><h1>ronnaplan node</h1>"
        f'<p class="note">{NOTICE}</p><p>as of {_time(time.time())} &middot; {other}</p>'
        f"<h2>Series</h2>{_table(heads[0], series)}"
        f"<h2>Answers that wait</h2>{_table(heads[1], waiting)}"
        f"<h2>Kept aside: another content under a known UID</h2>{_table(heads[2], aside)}</main></body></html>\n"
    )


def metrics_text(index: Index, folder: Path, counts: Mapping[str, int]) -> str:
    """Return the figures in Prometheus' text format."""
    lines: list[str] = []

    def add(name: str, kind: str, what: str, rows: Iterable[tuple[Any, ...]]) -> None:
        lines.extend((f"# HELP ronnaplan_{name} {what}", f"# TYPE ronnaplan_{name} {kind}"))
        for *labels, value in rows:
            shown = ",".join(f'{key}="{_quoted(text)}"' for key, text in labels)
            lines.append(f"ronnaplan_{name}{{{shown}}} {value}" if shown else f"ronnaplan_{name} {value}")

    def by_state(table: str) -> list[tuple[Any, ...]]:
        found = index.rows(f"SELECT state, count(*) FROM {table} GROUP BY state ORDER BY state")
        return [(("state", state), count) for state, count in found]

    add(
        "events_total",
        "counter",
        "Lines of the log by event.",
        [(("event", k), v) for k, v in sorted(counts.items())],
    )
    add("series", "gauge", "Series kept.", index.rows("SELECT count(*) FROM series"))
    add("instances", "gauge", "Instances kept.", index.rows("SELECT count(*) FROM instances"))
    add("bytes", "gauge", "Bytes of the instances.", index.rows("SELECT COALESCE(sum(bytes), 0) FROM instances"))
    add("aside", "gauge", "Instances kept aside.", index.rows("SELECT count(*) FROM aside"))
    add("jobs", "gauge", "Jobs by state.", by_state("jobs"))
    add("deliveries", "gauge", "Deliveries by state.", by_state("deliveries"))
    add("disk_free_bytes", "gauge", "Room on the disk.", [(shutil.disk_usage(folder).free,)])
    return "\n".join(lines) + "\n"


def _series_row(*row: Any) -> list[str]:
    received, calling, called, description, instances, expected, size, complete, answers, *rest = row
    job, rule, state, attempts, why, _, uid = rest
    told = "-"
    if job is not None:
        told = f'<span class="{escape(state)}">{escape(state)}</span>'
        told += f" (attempt {attempts})" if attempts > 1 else ""
        told += f", {counted(answers, 'answer')}" if answers else ""
    if state in ("refused", "failed"):
        told += f' <form method="post" action="/retry"><button name="job" value="{job}">retry</button></form>'
    texts = (
        _time(received),
        calling,
        called,
        description,
        instances if expected is None else f"{instances} of {expected}",
        f"{size / MIB:.1f}",
        "yes" if complete else "",
    )
    return [
        *(escape(str(text)) for text in texts),
        escape(rule or "-"),
        told,
        escape(why or ""),
        escape(uid),
    ]


def _table(head: Sequence[str], rows: list[list[str]]) -> str:
    if not rows:
        return "<p>none</p>"
    body = "".join(
        f"<tr>{''.join(_cell(name, cell) for name, cell in zip(head, row, strict=True))}</tr>" for row in rows
    )
    return f'<table><tr class="heads">{"".join(f"<th>{cell}</th>" for cell in head)}</tr>{body}</table>'


def _cell(head: str, cell: str) -> str:
    return f'<td data-head="{head}"><span>{cell}</span></td>'


def _time(seconds: float) -> str:
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _quoted(text: object) -> str:
    return str(text).replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
