"""``ronnaplan localize``: the markers of one scan or of many, as fiducials.json."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ronnaplan.cli.values import whole
from ronnaplan.text import plain_number

if TYPE_CHECKING:
    from ronnaplan.localization import Fiducials, Template

HELP = "Find the spherical markers of a CT and write their centers with covariances."
LONGEST_NAME = 100
"""Characters of a scan's name that go into its results' names."""

LAYOUT_MARKERS = (3, 32)
"""Numbers of markers whose layout can be described."""

WORTH_A_WARNING = 0.01
"""A layout that a tracker's pairing would refuse more often than this is worth a warning."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "paths", nargs="+", metavar="PATH", help="a DICOM folder, file or zip archive, or an image"
    )
    parser.add_argument(
        "--diameter", required=True, metavar="MM", help="diameter of the markers, several as 11.5,5, or 'auto'"
    )
    parser.add_argument("--expected", type=whole(), metavar="N", help="refuse (exit 3) unless N markers are found")
    parser.add_argument(
        "--marker",
        default="solid",
        metavar="BUILD",
        help="solid (default), shell:WALL for hollow markers, wrapped:THICKNESS for wrapped ones (mm)",
    )
    parser.add_argument("--series", metavar="UID", help="the series to use, where PATH holds several")
    parser.add_argument("--template", metavar="FILE", help="a frame's distances: keep and label its markers only")
    parser.add_argument(
        "--report",
        metavar="PNG",
        help="draw accepted and nearly accepted markers to this picture; of several PATHs one each, beside the results",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        help="where to write (default: standard output); a folder for several PATHs",
    )


def run(arguments: argparse.Namespace) -> int:
    """Localize the markers below each path; with several, go on after a bad one and sum up."""
    from ronnaplan.localization import Build, check_request

    diameters = _diameters(arguments.diameter)
    if diameters is not None:
        check_request(diameters, arguments.expected)
    Build.parse(arguments.marker)
    template = _template(arguments.template)
    _check_outputs(arguments)
    if len(arguments.paths) == 1:
        _localize_one(arguments, arguments.paths[0], diameters, template, arguments.output, arguments.report)
        return 0
    return _localize_many(arguments, diameters, template)


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Notice before the work that its result could not be written."""
    from ronnaplan.documents.files import check_target
    from ronnaplan.errors import UsageError

    if arguments.report is not None and not arguments.report.lower().endswith(".png"):
        raise UsageError(f"--report is '{arguments.report}'; the contact sheet is a .png")
    if len(arguments.paths) == 1:
        for path in (arguments.output, arguments.report):
            if path is not None:
                check_target(path)


def _diameters(text: str) -> tuple[float, ...] | None:
    """Parse ``--diameter``; None stands for 'auto'.

    A comma may be a decimal one: several diameters are told by a point in at least one of them.
    """
    from ronnaplan.errors import UsageError

    if text == "auto":
        return None
    found = [plain_number(part) for part in text.split(",")]
    if None in found:
        raise UsageError(f"--diameter is '{text}'; a positive number of mm, several as 11.5,5, or 'auto'")
    if len(found) > 1 and "." not in text:
        raise UsageError(
            f"--diameter is '{text}', which may be {text.replace(',', '.', 1)} mm or {len(found)} diameters; "
            f"write a point, or for several {','.join(f'{part}.0' for part in text.split(','))}"
        )
    return tuple(value for value in found if value is not None)


def _template(path: str | None) -> Template | None:
    if path is None:
        return None
    from ronnaplan.documents.template import read_template

    return read_template(path)


def _localize_one(
    arguments: argparse.Namespace,
    path: str,
    diameters: tuple[float, ...] | None,
    template: Template | None,
    output: str | None,
    report: str | None,
) -> Fiducials:
    from ronnaplan.ct import read_ct
    from ronnaplan.documents.fiducials import fiducials_document, read_fiducials
    from ronnaplan.documents.files import write_atomically
    from ronnaplan.documents.revision import write_document
    from ronnaplan.localization import Build, common_diameter, localize

    volume = read_ct(path, arguments.series, progress=True)
    for flag in volume.flags:
        print(f"ronnaplan: warning: {flag}", file=sys.stderr)
    found = localize(
        volume,
        diameter_mm=diameters or common_diameter(volume),
        expected=arguments.expected,
        template=template,
        marker=Build.parse(arguments.marker),
    )
    print(_summary(found), file=sys.stderr)
    write_document(output, fiducials_document(found), read_fiducials)
    if report is not None:
        from ronnaplan.report.contact import contact_sheet

        write_atomically(report, contact_sheet(volume, found))
    return found


def _localize_many(
    arguments: argparse.Namespace, diameters: tuple[float, ...] | None, template: Template | None
) -> int:
    from ronnaplan.documents.files import make_folder
    from ronnaplan.errors import RonnaplanError, UsageError
    from ronnaplan.text import LONGEST_SENTENCE, printable

    if arguments.output is None:
        raise UsageError("several PATHs were given; name a folder for their results with -o")
    folder = make_folder(arguments.output)
    status = 0
    lines = []
    for number, path in enumerate(arguments.paths, start=1):
        name = f"{number:03d}-{printable(Path(path).resolve().name, LONGEST_NAME)}"
        report = str(folder / f"{name}.png") if arguments.report else None
        try:
            found = _localize_one(
                arguments, path, diameters, template, str(folder / f"{name}.fiducials.json"), report
            )
        except RonnaplanError as error:
            status = max(status, error.exit_status)
            lines.append(f"{name}: {printable(error, LONGEST_SENTENCE)}")
        else:
            lines.append(f"{name}: {len(found)} markers")
    print("\n".join(lines), file=sys.stderr)
    return status


def _summary(found: Fiducials) -> str:
    from ronnaplan.report.tables import fiducials_table, resolution_line

    sizes = " or ".join(f"{diameter:g}" for diameter in found.diameters_mm)
    count = f"{len(found)} markers of {sizes} mm; {len(found.rejected)} candidates rejected"
    return "\n".join(
        [
            *([fiducials_table(found)] if len(found) else []),
            count,
            *resolution_line(found),
            *_motion(found),
            *_layout(found),
        ]
    )


def _motion(found: Fiducials) -> list[str]:
    """Say what is assumed of a patient who moved between the markers, or what known distances say of it."""
    from ronnaplan.localization.motion import UNSEEN_MOTION_MM

    if not len(found):
        return []
    if found.distance_error_mm is not None:
        return [f"motion: the markers' distances are the template's within {found.distance_error_mm:.2f} mm"]
    return [
        f"motion between the markers' slices is in no image: {UNSEEN_MOTION_MM:g} mm per axis are assumed, "
        "beside the stated errors; a --template tests it"
    ]


def _layout(found: Fiducials) -> list[str]:
    """Say how well this layout can be told from its rivals once a tracker sees the markers."""
    from ronnaplan.correspondence import describe_layout

    if not LAYOUT_MARKERS[0] <= len(found) <= LAYOUT_MARKERS[1]:
        return []
    layout = describe_layout(found.centers)
    refused = layout.refusal_probability()
    line = f"layout: nearest rival order is {layout.rival_distance_mm:.1f} mm away"
    if refused < WORTH_A_WARNING:
        return [line]
    return [f"{line}; pairing with a tracker would be refused in {refused:.0%} of cases, move a marker"]
