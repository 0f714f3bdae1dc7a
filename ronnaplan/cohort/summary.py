"""What the page tells of a cohort, gathered in one pass over the table of series."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from heapq import heappush, heappushpop
from typing import Any, Final

from ronnaplan.cohort.charts import LEAST, ControlChart, control_chart
from ronnaplan.jobs.serving import DONE

WORST: Final = 12
"""Contact sheets that are shown."""
CHARTED: Final = {
    "distance_mean_mm": "mean error of distances, mm",
    "distance_rms_mm": "RMS error of distances, mm",
}
MOMENT: Final = ("acquired", "acquired_time")
"""What tells when a scan was taken; an index of before has no times."""
UNKNOWN: Final = "scanner not named"

Row = dict[str, Any]


@dataclass
class Summary:
    """A cohort at a glance."""

    states: Counter[str] = field(default_factory=Counter)
    counts: Counter[tuple[int, int]] = field(default_factory=Counter)
    """(Expected, found) -> series."""
    rejected: Counter[str] = field(default_factory=Counter)
    """Test that candidates failed -> candidates."""
    reasons: Counter[str] = field(default_factory=Counter)
    """Why series have no result -> series."""
    scanners: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    """Scanner -> worst error of each series, RMS, mm."""
    thicknesses: list[tuple[float, float]] = field(default_factory=list)
    """Slice thickness and worst error, RMS, mm."""
    misfits: list[float] = field(default_factory=list)
    phantoms: dict[tuple[str, str], dict[tuple[Any, ...], Row]] = field(default_factory=lambda: defaultdict(dict))
    """(Scanner, phantom) -> its scans of which the day is told, by all that is charted of them: a copy counts once."""
    undated: Counter[tuple[str, str]] = field(default_factory=Counter)
    """(Scanner, phantom) -> scans that have no place in time, and so none in a chart."""
    worst: list[tuple[tuple[float, ...], int, Row]] = field(default_factory=list)

    @property
    def worst_first(self) -> list[Row]:
        """The series whose sheets should be looked at, worst first."""
        return [row for _, _, row in sorted(self.worst, key=lambda one: one[0], reverse=True)]

    @property
    def charts(self) -> list[ControlChart]:
        """Control charts of every scanner that scanned a phantom often enough; those that drift first."""
        charts = [
            control_chart(
                f"{scanner}, {phantom}",
                quantity,
                [row["acquired"] for row in rows],
                [row[name] for row in rows],
            )
            for (scanner, phantom), found in sorted(self.phantoms.items())
            for rows in [sorted(found.values(), key=_moment)]
            if len(rows) >= LEAST
            for name, quantity in CHARTED.items()
        ]
        return sorted(charts, key=lambda one: not (one.drifts.any() or one.leaps.any()))

    @property
    def uncharted(self) -> list[str]:
        """Scanners that scanned a phantom too rarely for a chart, with how often."""
        return [
            f"{scanner}, {phantom}: {len(rows)}"
            for (scanner, phantom), rows in sorted(self.phantoms.items())
            if len(rows) < LEAST
        ]


def summarize(rows: Iterable[Row]) -> Summary:
    """Gather the page's contents."""
    summary = Summary()
    for number, row in enumerate(rows):
        _add(summary, row, number)
    return summary


def scanner_of(row: Row) -> str:
    """Return what a scanner is called: station or maker, model and serial number."""
    told = [row.get(name) for name in ("manufacturer", "model", "serial", "station")]
    return " ".join(dict.fromkeys(part for part in told if part)) or UNKNOWN


def _add(summary: Summary, row: Row, number: int) -> None:
    summary.states[row["state"]] += 1
    if row["state"] != DONE and row["reason"]:
        summary.reasons[_kind(row["reason"])] += 1
    found, expected = row.get("found"), row.get("expected")
    if found is not None and expected is not None:
        summary.counts[expected, found] += 1
    summary.rejected.update(row.get("rejected") or ())
    error_mm = row.get("error_rms_mm")
    if error_mm is not None:
        summary.scanners[scanner_of(row)].append(error_mm)
        summary.misfits.append(row["misfit"])
        thickness_mm = row.get("thickness_mm") or row.get("spacing_mm")
        if thickness_mm is not None:
            summary.thicknesses.append((thickness_mm, error_mm))
    if row.get("phantom") is not None:
        scanned = scanner_of(row), row["phantom"]
        if row.get("acquired"):
            charted = {name: row.get(name) for name in (*MOMENT, "series", *CHARTED)}
            summary.phantoms[scanned][tuple(charted.values())] = charted
        else:
            summary.undated[scanned] += 1
    if row.get("sheet"):
        add = heappush if len(summary.worst) < WORST else heappushpop
        add(summary.worst, (badness(row), -number, row))


def badness(row: Row) -> tuple[float, ...]:
    """Sort series by how much they want looking at: refused, markers missed or too many, doubtful, ill fitted."""
    found, expected = row.get("found") or 0, row.get("expected")
    missed = 0 if expected is None else abs(expected - found)
    return (
        float(row["state"] != DONE),
        float(missed),
        float(bool(row.get("phantom_reasons") or row["reason"])),
        float(row.get("misfit") or 0.0),
    )


def _moment(row: Row) -> tuple[str, ...]:
    """Sort scans by their days, and those of one day by their times, as far as they are told."""
    return tuple(row[name] or "" for name in MOMENT)


def _kind(reason: str) -> str:
    """Return the beginning of a reason, without the numbers of this very series."""
    return "".join("#" if each.isdigit() else each for each in reason.partition(";")[0])[:80]
