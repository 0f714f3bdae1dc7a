"""Many scans in one ``ronnaplan localize``: on after a bad one, every line names its scan, a summary at the end."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from ronnaplan.cli.output import tell, warn
from ronnaplan.errors import InputError, RonnaplanError
from ronnaplan.text import LONGEST_SENTENCE, printable, sizes

if TYPE_CHECKING:
    from ronnaplan.ct import CTVolume
    from ronnaplan.localization import Fiducials

LONGEST_NAME = 100
"""Characters of a scan's name that go into its results' names."""

SUMMARY_FORMAT = "ronnaplan.localize-summary"

RESULTS = ("summary.json", "summary.csv", "[0-9][0-9][0-9]*-*.fiducials.json", "[0-9][0-9][0-9]*-*.png")
"""What a batch writes."""


@dataclass(frozen=True)
class Job:
    """One scan of a batch: its path, the series in it (None: the only one), and the name of its results.

    ``first_file`` is the series' first one where all series of a path are done: what a person tells them apart by.
    """

    name: str
    path: str
    series: str | None
    first_file: str | None


@dataclass(frozen=True)
class Outcome:
    """What became of one scan; ``status`` is the exit status that it would have had by itself.

    What was known of a scan when it was refused is told, too. ``diameters_mm`` are those looked for, and
    ``markers_by_diameter`` how many of the markers are nearest to each.
    """

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
    markers_by_diameter: str
    first_file: str | None


class Steps(Protocol):
    """What is done with each scan of a batch; any step may raise a `RonnaplanError`."""

    def read(self, job: Job) -> CTVolume:
        """Return the scan."""

    def find(self, job: Job, volume: CTVolume) -> Fiducials:
        """Return its markers, however many there are."""

    def keep(self, job: Job, volume: CTVolume, found: Fiducials) -> str:
        """Write the markers, unless their number is refused; return the file's name."""


def jobs_of(paths: Sequence[str], series: str | None, all_series: bool) -> list[Job]:
    """Return the scans below ``paths``, numbered in order; a path that cannot be used is one of them."""
    found: list[tuple[str, str | None, str | None]] = []
    for path in paths:
        found += [(path, *one) for one in _usable(path)] if all_series else [(path, series, None)]
    return [
        Job(f"{number:03d}-{printable(Path(path).resolve().name, LONGEST_NAME)}", path, key, first_file)
        for number, (path, key, first_file) in enumerate(found, start=1)
    ]


def results_folder(path: str) -> Path:
    """Return the folder of a batch's results, made if it is not there.

    Raises `InputError` where an earlier batch's lie in it: they would pass for this one's where a scan is refused or
    was not asked for again.
    """
    from ronnaplan.documents.files import make_folder

    folder = make_folder(path)
    for pattern in RESULTS:
        for earlier in sorted(folder.glob(pattern)):
            raise InputError(
                f"{folder} has results of an earlier run ({earlier.name}), which would pass for this one's; "
                "name a new folder, or take them away"
            )
    return folder


def localize_all(jobs: Sequence[Job], folder: Path, steps: Steps) -> int:
    """Localize scan after scan, tell each in a line, write the summaries; returns the worst status."""
    from ronnaplan.documents.files import write_atomically
    from ronnaplan.documents.reading import plain_json

    outcomes = []
    for job in jobs:
        outcome = _outcome(job, steps)
        tell(f"{job.name}: {outcome.message}")
        outcomes.append(outcome)
    document = {"format": SUMMARY_FORMAT, "version": 1, "unit": "mm", "scans": [asdict(one) for one in outcomes]}
    write_atomically(folder / "summary.json", plain_json(document))
    write_atomically(folder / "summary.csv", _table(outcomes))
    return max((one.status for one in outcomes), default=0)


def _usable(path: str) -> Iterable[tuple[str | None, str | None]]:
    """Return the keys of a path's usable series, each with its first file.

    None stands for an image file, and for what is refused later.
    """
    from ronnaplan.ct import find_series
    from ronnaplan.ct.files import given_path
    from ronnaplan.ct.images import is_image_file

    try:
        given = given_path(path)
        if is_image_file(given) and given.is_file():
            return ((None, None),)
        found = find_series(path, progress=True)
    except RonnaplanError:
        return ((None, None),)
    usable = found.usable
    if any(found.may_mean_another(one) for one in usable):
        warn(f"{printable(path)} holds a scan that cannot be used, too, and is left out; see `ronnaplan series`")
    return [(one.key, one.first.blob.name) for one in usable] or ((None, None),)


def _outcome(job: Job, steps: Steps) -> Outcome:
    series, file, found = job.series, None, None
    try:
        volume = steps.read(job)
        series = series or volume.source.series_instance_uid
        found = steps.find(job, volume)
        file = steps.keep(job, volume, found)
        status, message = 0, _counted(found)
    except RonnaplanError as error:
        status, message = error.exit_status, printable(error, LONGEST_SENTENCE)
    of_markers = {flag.name.lower() for one in found or () for flag in one.flags}
    of_scan = {flag.name.lower() for flag in (found.volume_flags if found is not None else ())}
    return Outcome(
        scan=job.name,
        path=printable(job.path, LONGEST_SENTENCE),
        series=series,
        status=status,
        markers=None if found is None else len(found),
        rejected=None if found is None else len(found.rejected),
        diameters_mm="" if found is None else sizes(found.diameters_mm),
        flags=" ".join(sorted(of_markers | of_scan)),
        fiducials=file,
        message=message,
        markers_by_diameter="" if found is None else _by_diameter(found),
        first_file=job.first_file,
    )


def _by_diameter(found: Fiducials) -> str:
    nearest = [
        min((abs(size_mm - one.diameter_mm), size_mm) for size_mm in found.diameters_mm)[1] for one in found
    ]
    return " ".join(f"{size_mm:g}:{nearest.count(size_mm)}" for size_mm in found.diameters_mm)


def _counted(found: Fiducials) -> str:
    from ronnaplan.report.tables import counts_line

    doubt = "" if found.distortion is None else f"; warning: {found.distortion}"
    return f"{counts_line(found)}{doubt}"


def _table(outcomes: Sequence[Outcome]) -> str:
    from ronnaplan.tracking.cells import plain_text

    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([field.name for field in fields(Outcome)])
    for one in outcomes:
        values = asdict(one).values()
        writer.writerow(["" if v is None else plain_text(v) if isinstance(v, str) else v for v in values])
    return stream.getvalue()
