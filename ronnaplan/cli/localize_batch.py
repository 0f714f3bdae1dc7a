"""Many scans in one ``ronnaplan localize``: on after a bad one, every line names its scan, a summary at the end."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from ronnaplan.errors import RonnaplanError
from ronnaplan.text import LONGEST_SENTENCE, printable

if TYPE_CHECKING:
    from ronnaplan.localization import Fiducials

LONGEST_NAME = 100
"""Characters of a scan's name that go into its results' names."""

SUMMARY_FORMAT = "ronnaplan.localize-summary"


@dataclass(frozen=True)
class Job:
    """One scan of a batch: its path, the series in it (None: the only one), and the name of its results."""

    name: str
    path: str
    series: str | None


@dataclass(frozen=True)
class Outcome:
    """What became of one scan; ``status`` is the exit status that it would have had by itself."""

    scan: str
    path: str
    series: str | None
    status: int
    markers: int | None
    rejected: int | None
    diameters_mm: str
    flags: str
    fiducials: str | None
    message: str


Localize = Callable[[Job, Path], "Fiducials"]
"""Localizes a scan and writes its results to a folder."""


def jobs_of(paths: Sequence[str], series: str | None, all_series: bool) -> list[Job]:
    """Return the scans below ``paths``, numbered in order; raises `InputError` for a path without a series."""
    found: list[tuple[str, str | None]] = []
    for path in paths:
        found += [(path, key) for key in _usable(path)] if all_series else [(path, series)]
    return [
        Job(f"{number:03d}-{printable(Path(path).resolve().name, LONGEST_NAME)}", path, key)
        for number, (path, key) in enumerate(found, start=1)
    ]


def localize_all(jobs: Sequence[Job], folder: Path, localize: Localize) -> int:
    """Localize scan after scan, tell each in a line, write the summaries; returns the worst status."""
    from ronnaplan.documents.files import write_atomically
    from ronnaplan.documents.reading import plain_json

    outcomes = []
    for job in jobs:
        outcome = _outcome(job, folder, localize)
        print(f"{job.name}: {outcome.message}", file=sys.stderr)
        outcomes.append(outcome)
    document = {"format": SUMMARY_FORMAT, "version": 1, "unit": "mm", "scans": [asdict(one) for one in outcomes]}
    write_atomically(folder / "summary.json", plain_json(document))
    write_atomically(folder / "summary.csv", _table(outcomes))
    return max((one.status for one in outcomes), default=0)


def _usable(path: str) -> Iterable[str | None]:
    """Return the keys of a path's usable series; None stands for an image file, and for what is refused later."""
    from ronnaplan.ct import find_series
    from ronnaplan.ct.files import given_path
    from ronnaplan.ct.images import is_image_file

    given = given_path(path)
    if is_image_file(given) and given.is_file():
        return (None,)
    return [one.key for one in find_series(path, progress=True).usable] or (None,)


def _outcome(job: Job, folder: Path, localize: Localize) -> Outcome:
    try:
        found = localize(job, folder)
    except RonnaplanError as error:
        message = printable(error, LONGEST_SENTENCE)
        return Outcome(job.name, job.path, job.series, error.exit_status, None, None, "", "", None, message)
    sizes = " or ".join(f"{diameter:g}" for diameter in found.diameters_mm)
    flags = sorted({flag.name.lower() for one in found.fiducials for flag in one.flags})
    return Outcome(
        scan=job.name,
        path=job.path,
        series=found.source.series_instance_uid or job.series,
        status=0,
        markers=len(found),
        rejected=len(found.rejected),
        diameters_mm=sizes,
        flags=" ".join(flags),
        fiducials=f"{job.name}.fiducials.json",
        message=f"{len(found)} markers of {sizes} mm; {len(found.rejected)} candidates rejected",
    )


def _table(outcomes: Sequence[Outcome]) -> str:
    from ronnaplan.tracking.tables import plain_text

    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([field.name for field in fields(Outcome)])
    for one in outcomes:
        values = asdict(one).values()
        writer.writerow(["" if v is None else plain_text(v) if isinstance(v, str) else v for v in values])
    return stream.getvalue()
