"""``ronnaplan localize``: the markers of one scan or of many, as fiducials.json."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ronnaplan.cli.output import tell, warn
from ronnaplan.cli.values import diameters, whole

if TYPE_CHECKING:
    from pathlib import Path

    from ronnaplan.cli.localize_batch import Job
    from ronnaplan.ct import CTVolume
    from ronnaplan.localization import Build, Fiducials, Template

HELP = "Find the spherical markers of a CT and write their centers with covariances."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "paths", nargs="+", metavar="PATH", help="a DICOM folder, file or zip archive, or an image"
    )
    parser.add_argument(
        "--diameter",
        required=True,
        action="append",
        metavar="MM",
        help="diameter of the markers, several as 11.5,5 or one after another, or 'auto'; repeatable",
    )
    parser.add_argument(
        "--expected", type=whole(0), metavar="N", help="refuse (exit 3) unless N markers are found"
    )
    parser.add_argument(
        "--marker",
        default="solid",
        metavar="BUILD",
        help="solid (default), shell:WALL for hollow markers, wrapped:THICKNESS for wrapped ones (mm)",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--series", metavar="UID", help="the series to use, where PATH holds several")
    which.add_argument(
        "--all-series", action="store_true", help="every usable series below PATH, as with several PATHs"
    )
    parser.add_argument("--template", metavar="FILE", help="a frame's distances: keep and label its markers only")
    parser.add_argument(
        "--report",
        metavar="PNG",
        help="draw accepted and nearly accepted markers to this picture, on refusal, too; of several PATHs one each",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        help="where to write (default: standard output); a folder for several PATHs, with summary.csv and summary.json",
    )


def run(arguments: argparse.Namespace) -> int:
    """Localize the markers below each path; with several, go on after a bad one and sum up."""
    from ronnaplan.localization import Build
    from ronnaplan.localization.localizer import check_request

    wanted = _Wanted(
        diameters(arguments.diameter),
        arguments.expected,
        _template(arguments.template),
        Build.parse(arguments.marker),
    )
    if wanted.diameters_mm is not None:
        check_request(wanted.diameters_mm, wanted.expected, wanted.build)
    _check_outputs(arguments)
    if arguments.all_series or len(arguments.paths) > 1:
        return _localize_many(arguments, wanted)
    _localize_one(arguments, wanted)
    return 0


@dataclass(frozen=True)
class _Wanted:
    """What is looked for in every scan; ``diameters_mm`` is None where the scan itself is to tell them."""

    diameters_mm: tuple[float, ...] | None
    expected: int | None
    template: Template | None
    build: Build


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Notice before the work that its result could not be written."""
    from ronnaplan.documents.files import check_target
    from ronnaplan.errors import UsageError

    if arguments.report is not None and not arguments.report.lower().endswith(".png"):
        raise UsageError(f"--report is '{arguments.report}'; the contact sheet is a .png")
    if len(arguments.paths) == 1 and not arguments.all_series:
        for path in (arguments.output, arguments.report):
            if path is not None:
                check_target(path)


def _template(path: str | None) -> Template | None:
    if path is None:
        return None
    from ronnaplan.documents.template import read_template

    return read_template(path)


def _localize_one(arguments: argparse.Namespace, wanted: _Wanted) -> None:
    from ronnaplan.ct.catalogue import SeveralSeriesError
    from ronnaplan.localization.localizer import require_count

    try:
        volume = _read(arguments.paths[0], arguments.series)
    except SeveralSeriesError as error:
        raise SeveralSeriesError(f"{error}; --all-series does them all") from error
    found = _localized(volume, wanted, arguments.report)
    require_count(found, wanted.expected, volume, progress=True)
    tell(_summary(found))
    if found.distortion is not None:
        warn(found.distortion)
    for line in _other_sizes(volume, found):
        tell(f"ronnaplan: {line}")
    _write(arguments.output, found)


def _localize_many(arguments: argparse.Namespace, wanted: _Wanted) -> int:
    from ronnaplan.cli.localize_batch import jobs_of, localize_all, results_folder
    from ronnaplan.errors import UsageError

    if arguments.output is None:
        raise UsageError("several scans were asked for; name a folder for their results with -o")
    folder = results_folder(arguments.output)
    jobs = jobs_of(arguments.paths, arguments.series, arguments.all_series)
    return localize_all(jobs, folder, _Steps(wanted, folder, arguments.report is not None))


@dataclass(frozen=True)
class _Steps:
    """What is done with each scan of a batch."""

    wanted: _Wanted
    folder: Path
    report: bool

    def read(self, job: Job) -> CTVolume:
        return _read(job.path, job.series, f"{job.name}: ")

    def find(self, job: Job, volume: CTVolume) -> Fiducials:
        return _localized(volume, self.wanted, str(self.folder / f"{job.name}.png") if self.report else None)

    def keep(self, job: Job, volume: CTVolume, found: Fiducials) -> str:
        from ronnaplan.localization.localizer import require_count

        require_count(found, self.wanted.expected, volume, progress=True)
        for line in _other_sizes(volume, found):
            tell(f"{job.name}: {line}")
        name = f"{job.name}.fiducials.json"
        _write(str(self.folder / name), found)
        return name


def _read(path: str, series: str | None, name: str = "ronnaplan: ") -> CTVolume:
    from ronnaplan.ct import read_ct

    volume = read_ct(path, series, progress=True)
    for flag in volume.flags:
        tell(f"{name}warning: {flag}")
    return volume


def _localized(volume: CTVolume, wanted: _Wanted, report: str | None) -> Fiducials:
    """Localize, however many markers there are, and draw the report, also where the answer is refused."""
    from ronnaplan.errors import RefusedError
    from ronnaplan.localization import localize

    try:
        found = localize(
            volume,
            diameter_mm=wanted.diameters_mm or _common_diameter(volume, wanted),
            template=wanted.template,
            marker=wanted.build,
            progress=True,
        )
    except RefusedError:  # of several sizes none, or of a template
        _draw(report, volume, wanted)
        raise
    told = (flag for flag in found.volume_flags if flag not in volume.flags)
    warn(*(f"{flag}; those that were computed are left out" for flag in told))
    _draw(report, volume, wanted, found)
    return found


def _common_diameter(volume: CTVolume, wanted: _Wanted) -> float:
    """Return the commonest diameter, and warn of other sets of balls where no number says which one is meant."""
    from ronnaplan.localization.size import common_sizes, told_of_others

    sizes = common_sizes(volume, wanted.expected, wanted.build, progress=True)
    warn(*told_of_others(sizes, wanted.expected))
    return sizes[0].diameter_mm


def _draw(report: str | None, volume: CTVolume, wanted: _Wanted, found: Fiducials | None = None) -> None:
    """Draw what was found; where that was refused, all markers of the sizes stated, or of those that are there."""
    if report is None:
        return
    from ronnaplan.documents.files import write_atomically
    from ronnaplan.localization import localize, sizes_seen
    from ronnaplan.report.contact import contact_sheet

    if found is None:
        seen = wanted.diameters_mm or [one.diameter_mm for one in sizes_seen(volume, wanted.build, progress=True)]
        found = localize(volume, diameter_mm=seen, marker=wanted.build, progress=True) if seen else None
    write_atomically(report, contact_sheet(volume, found))


def _other_sizes(volume: CTVolume, found: Fiducials) -> list[str]:
    """Say which sizes the scan shows where it shows none of those stated, or all markers are of another.

    Markers whose size the scale's end hides show none. Nothing where the scan's geometry may be wrong, which makes
    sizes wrong, too.
    """
    from ronnaplan.localization.fiducials import FiducialFlag
    from ronnaplan.localization.size import proposal, sizes_seen

    if found.distortion is not None:
        return []
    if all({FiducialFlag.DIAMETER, FiducialFlag.CLIPPED} <= set(one.flags) for one in found):
        return [proposal(sizes_seen(volume, found.marker, progress=True))]
    other = found.other_diameter_mm
    return [] if other is None else [f"of the markers {found.other_size}: try --diameter {other:.1f}"]


def _write(output: str | None, found: Fiducials) -> None:
    from ronnaplan.documents.fiducials import fiducials_document, read_fiducials
    from ronnaplan.documents.revision import write_document

    write_document(output, fiducials_document(found), read_fiducials)


def _summary(found: Fiducials) -> str:
    from ronnaplan.report.tables import counts_line, fiducials_table, layout_line, motion_line, resolution_line

    return "\n".join(
        [
            *([fiducials_table(found)] if len(found) else []),
            counts_line(found),
            *resolution_line(found),
            *motion_line(found),
            *layout_line(found),
        ]
    )
