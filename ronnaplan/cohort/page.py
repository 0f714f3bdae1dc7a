"""index.html: a cohort at a glance, without a server; nothing in it is fetched from anywhere."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Final

from ronnaplan import __version__
from ronnaplan.cohort import plots
from ronnaplan.cohort.charts import BASELINE, LEAST
from ronnaplan.cohort.index import ASIDE, Index
from ronnaplan.cohort.listing import NESTED
from ronnaplan.cohort.summary import Row, Summary, scanner_of, summarize
from ronnaplan.cohort.tables import MARKERS, SERIES, series_rows
from ronnaplan.ct.limits import MIB
from ronnaplan.documents.files import write_atomically
from ronnaplan.report.html import box, element, link, page, picture, section, table
from ronnaplan.text import NOTICE, counted, printable

PAGE: Final = "index.html"
MOST_ROWS: Final = 15
MOST_CHARTS: Final = 40
UNREAD: Final = f"(trouble OR (files.archive IS NOT NULL AND reason != '') OR reason = '{NESTED}')"
STATES: Final = {
    "done": "localized, with the number of markers that was expected, where one was",
    "refused": "refused: not the expected number, or no single answer",
    "unusable": "not a CT that can be localized",
    "aside": "set aside by a fault",
    "left": "no rule fits",
    "waiting": "not yet worked on",
}


def write_page(index: Index, out: Path) -> None:
    """Write the page from the index."""
    summary = summarize(series_rows(index))
    body = [
        element("h1", "Markers of a cohort"),
        element("p", f"ronnaplan {__version__}. {NOTICE}", "note"),
        *_numbers(index, summary),
        *_quality(summary),
        *_figures(summary),
        *_worst(summary, out),
    ]
    write_atomically(out / PAGE, page("ronnaplan cohort", body))


def _numbers(index: Index, summary: Summary) -> list[str]:
    rows = [[str(summary.states[name]), told] for name, told in STATES.items() if summary.states[name]]
    seconds, count, peak = index.rows(
        "SELECT AVG(seconds), COUNT(seconds), MAX(peak_bytes) FROM series WHERE seconds IS NOT NULL"
    )[0]
    parts = [table([], rows)]
    if count:
        told = f"A series took {seconds:.1f} s of one process on average"
        parts.append(element("p", f"{told}, the largest {peak / MIB:.0f} MiB of memory." if peak else f"{told}."))
    parts.append(f"<p>Tables: {link(SERIES, SERIES)}, {link(MARKERS, MARKERS)}</p>")
    found = [section("Series", parts)]
    if summary.states[ASIDE]:
        rows_aside = index.rows(
            "SELECT folder, series_uid, reason FROM series WHERE state = ? ORDER BY id LIMIT ?", ASIDE, MOST_ROWS
        )
        items = [f"{printable(folder)}, {uid}: {printable(reason)}" for folder, uid, reason in rows_aside]
        found.append(box("warnings", f"{summary.states[ASIDE]} series were set aside by a fault", items))
    return found + _unread(index)


def _unread(index: Index) -> list[str]:
    """Return a box of files, folders and archives that could not be read: no other row tells of them."""
    count = index.value(f"SELECT COUNT(*) FROM files WHERE {UNREAD}")
    if not count:
        return []
    rows = index.rows(
        "SELECT places.root, places.archive, folder, name, reason FROM files JOIN places ON places.id = place"
        f" WHERE {UNREAD} ORDER BY place, folder, name LIMIT ?",
        MOST_ROWS,
    )
    items = [printable(f"{'/'.join(filter(None, where)) or root}: {reason}") for root, *where, reason in rows]
    title = "1 file or folder could not be read" if count == 1 else f"{count} files or folders could not be read"
    return [box("warnings", title if count <= MOST_ROWS else f"{title}, the first {MOST_ROWS} of them", items)]


def _quality(summary: Summary) -> list[str]:
    charts, uncharted = summary.charts, summary.uncharted
    few = []
    undated = [f"{scanner}, {phantom}: {count}" for (scanner, phantom), count in sorted(summary.undated.items())]
    for what, scans in (
        (f", too few for a chart, which takes {LEAST}", uncharted),
        (" that tell no day, and are in no chart", undated),
    ):
        if scans:
            told = "; ".join(map(printable, scans[:MOST_ROWS]))
            few.append(element("p", f"Scans of phantoms{what}: {told}.", "note"))
    if not charts:
        return [section("Quality over time", few)] if few else []
    alarms = [
        f"{one.scanner}, {one.quantity}: {one.verdict}" for one in charts if one.drifts.any() or one.leaps.any()
    ]
    top = (
        box("warnings", f"A change in {len(alarms)} of {counted(len(charts), 'chart')}", alarms)
        if alarms
        else box("clear", f"No change in {counted(len(charts), 'chart')}", [])
    )
    text = (
        "A known phantom, scanned again and again. Points are single scans and dashed lines their limits; the line is "
        "their moving average and the band its limits, which a drift leaves first. Limits come from the first "
        f"{BASELINE} scans; where something changes among these, from those before the change."
    )
    pictures = [picture(plots.chart_plot(one), f"{one.scanner}: {one.quantity}") for one in charts[:MOST_CHARTS]]
    return [section("Quality over time", [top, *few, element("p", text, "note"), *pictures])]


def _figures(summary: Summary) -> list[str]:
    found = []
    if summary.counts:
        found.append(picture(plots.found_plot(summary.counts), "Found against expected; the number is of series"))
    if summary.scanners:
        found.append(picture(plots.scanners_plot(summary.scanners), "RMS error by scanner (number of series)"))
        found.append(picture(plots.misfit_plot(summary.misfits), "Misfit"))
    if summary.thicknesses:
        found.append(picture(plots.thickness_plot(summary.thicknesses), "RMS error by slice thickness"))
    if summary.rejected:
        found.append(picture(plots.reasons_plot(summary.rejected), "Why candidates were rejected"))
    if summary.reasons:
        rows = [[str(count), printable(why)] for why, count in summary.reasons.most_common(MOST_ROWS)]
        found.append(
            element("h3", "Why series have no result (# stands for a digit)") + table(["series", "reason"], rows)
        )
    return [section("Figures", found)] if found else []


def _worst(summary: Summary, out: Path) -> list[str]:
    shown = [_sheet(row, out) for row in summary.worst_first]
    if not shown:
        return []
    text = "Refused first, then markers missed, warnings and phantoms that do not pass, the worst fits."
    return [section("Sheets to look at first", [element("p", text, "note"), *shown])]


def _sheet(row: Row, out: Path) -> str:
    where = printable("/".join(part for part in (row["archive"], row["folder"]) if part) or row["root"])
    expected = "" if row.get("expected") is None else f" of {row['expected']}"
    found = "" if row.get("found") is None else f"{row['found']}{expected} markers"
    reasons = (printable(one) for one in (row["reason"], *(row.get("phantom_reasons") or ())) if one)
    told = "; ".join(part for part in (where, scanner_of(row), found, *reasons) if part)
    try:
        content = _jpeg((out / row["sheet"]).read_bytes())
    except OSError:
        return element("p", f"{told}: its sheet is gone")
    return f"{element('h3', told)}<p>{link(row['sheet'], 'whole sheet')}</p>{picture(content, where, 'jpeg')}"


def _jpeg(content: bytes) -> bytes:
    """Return a sheet as a quarter of its bytes; the exact one is a click away."""
    from PIL import Image

    stream = io.BytesIO()
    with Image.open(io.BytesIO(content)) as sheet:
        sheet.convert("RGB").save(stream, "JPEG", quality=85)
    return stream.getvalue()
