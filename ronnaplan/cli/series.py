"""``ronnaplan series``: every series below a path, and whether it can be used."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ronnaplan.text import counted, table

if TYPE_CHECKING:
    from ronnaplan.ct.files import Skipped
    from ronnaplan.ct.summary import SeriesSummary

HELP = "List every series in a folder, file or zip archive, and say whether it can be localized and if not why."
HEADINGS = (
    "use",
    "modality",
    "slices",
    "matrix",
    "pixel mm",
    "gap mm",
    "tilt deg",
    "kernel",
    "description",
    "series",
)
MOST_SKIPPED_SHOWN = 10


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("path", metavar="PATH", help="a DICOM folder, file or zip archive, or an image file")
    parser.add_argument("--json", action="store_true", help="write JSON instead of a table")
    parser.add_argument("--patient", action="store_true", help="show patient names, which are left out otherwise")


def run(arguments: argparse.Namespace) -> int:
    """List the series of ``arguments.path``."""
    from ronnaplan.ct.summary import summarize
    from ronnaplan.documents.reading import plain_json

    series, skipped = summarize(arguments.path, progress=True)
    if arguments.json:
        print(plain_json(_document(series, skipped, arguments.patient)), end="")
    else:
        print(_table(series, skipped, arguments.patient))
    return 0


def _document(series: Sequence[SeriesSummary], skipped: Sequence[Skipped], with_patient: bool) -> dict[str, Any]:
    from dataclasses import asdict

    entries = [{**asdict(one), "usable": one.is_usable} for one in series]
    if not with_patient:
        for entry in entries:
            del entry["patient_name"]
    files = [{"file": one.name, "reason": one.reason} for one in skipped]
    return {"format": "ronnaplan.series", "version": 1, "unit": "mm", "series": entries, "skipped": files}


def _table(series: Sequence[SeriesSummary], skipped: Sequence[Skipped], with_patient: bool) -> str:
    rows = [HEADINGS, *(_row(one) for one in series)]
    lines = table(rows)
    shown = [lines[0]]
    for line, one in zip(lines[1:], series, strict=True):
        shown.append(line)
        if with_patient:
            shown.append(f"     patient: {one.patient_name or '(no name)'}")
        if one.apart:
            told = f"; this one: {', '.join(one.part)}" if one.part else ""
            shown.append(f"     a part of its series, which mixes {', '.join(one.apart)}{told}")
        shown += [f"     cannot be used: {problem}" for problem in one.problems]
        shown += [f"     note: {note}" for note in one.notes]
    if skipped:
        shown.append(f"{counted(len(skipped), 'other file')}:")
        shown += [f"     {one.name}: {one.reason}" for one in skipped[:MOST_SKIPPED_SHOWN]]
        if len(skipped) > MOST_SKIPPED_SHOWN:
            shown.append(f"     and {len(skipped) - MOST_SKIPPED_SHOWN} more")
    return "\n".join(shown)


def _row(one: SeriesSummary) -> tuple[str, ...]:
    return (
        "yes" if one.is_usable else "no",
        one.modality or "-",
        str(one.images),
        "-" if one.matrix is None else f"{one.matrix[0]} x {one.matrix[1]}",
        "-" if one.pixel_mm is None else f"{one.pixel_mm[0]:.3f} x {one.pixel_mm[1]:.3f}",
        "-" if one.spacing_mm is None else _range(*one.spacing_mm),
        "-" if one.tilt_deg is None else f"{one.tilt_deg:.1f}",
        one.kernel or "-",
        one.description or "-",
        one.series,
    )


def _range(low: float, high: float) -> str:
    shown = f"{low:.3f}", f"{high:.3f}"
    return shown[0] if shown[0] == shown[1] else "-".join(shown)
