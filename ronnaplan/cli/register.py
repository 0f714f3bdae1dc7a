"""``ronnaplan register``: markers of a scan and tracker readings, to the registration and its expected error."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ronnaplan.cli.case_options import with_sigmas
from ronnaplan.cli.output import tell, warn
from ronnaplan.cli.values import number as any_number
from ronnaplan.cli.values import whole
from ronnaplan.sigmas import SIGMA_CT_MM

if TYPE_CHECKING:
    from ronnaplan.documents.fiducials import FiducialsDocument
    from ronnaplan.geometry import Points

HELP = "Pair a scan's markers with tracker readings, register them and predict the error at planned points."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("fiducials", metavar="FIDUCIALS", help="fiducials.json of the scan")
    parser.add_argument("readings", metavar="READINGS", help="CSV, NDI CSV, Slicer markups or PLUS sequence")
    number = parser.add_mutually_exclusive_group()
    number.add_argument(
        "--expected",
        type=whole(3),
        metavar="N",
        help="the number of markers that both should hold; where a few are missing the others pair and that is told; "
        "more are refused",
    )
    number.add_argument("--at-least", type=whole(3), metavar="N", help="the number of markers in both, or more")
    parser.add_argument("--plan", metavar="PLAN", help="predict the error at this plan's entries and targets")
    parser.add_argument(
        "--target",
        nargs=3,
        type=any_number,
        action="append",
        default=[],
        metavar=("X", "Y", "Z"),
        help="predict the error at this place of the scan, LPS mm; repeatable",
    )
    with_sigmas(parser)
    parser.add_argument(
        "--pair",
        action="append",
        default=[],
        metavar="CT=READING",
        help="a pair known by pointing at it; repeatable",
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="registration.json (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Register; a refused pairing is written with its rivals and returns 3."""
    from ronnaplan.documents.fiducials import read_fiducials
    from ronnaplan.documents.registration import read_registration
    from ronnaplan.documents.registration_made import registration_document
    from ronnaplan.documents.registration_text import registration_text
    from ronnaplan.documents.revision import write_document
    from ronnaplan.errors import RefusedError
    from ronnaplan.registration.marker_registration import register_markers
    from ronnaplan.tracking import find_markers, read_recording
    from ronnaplan.tracking.told import readings_told

    fiducials = read_fiducials(arguments.fiducials)
    targets = _targets(arguments, fiducials)
    recording = read_recording(arguments.readings)
    found = find_markers(recording, sigma_mm=arguments.sigma_ots)
    notes = readings_told(recording, found)
    warn(*fiducials.source.doubts, *fiducials.doubts, *notes)
    known = tuple(_pair(text, fiducials.points.labels, found.points.labels) for text in arguments.pair)
    registered = register_markers(
        fiducials.points,
        found.points,
        expected=arguments.expected,
        at_least=arguments.at_least,
        sigma_ct_mm=arguments.sigma_ct,
        known_pairs=known,
    )
    warn(*registered.notes)
    tell(_counted(arguments))
    document = registration_document(registered, fiducials.source, targets, notes)
    tell(registration_text(document))
    write_document(arguments.output, document, read_registration)
    if document.status != "unique":
        raise RefusedError(document.reason)
    return 0


def _counted(arguments: argparse.Namespace) -> str:
    """Say which errors of the markers count, and why, as the expected error rests on them."""
    skin = "the default: markers on skin shift between scan and tracking; bone screws have 0.1"
    why = f"{skin}; --sigma-ct" if arguments.sigma_ct == SIGMA_CT_MM else "as --sigma-ct states"
    return (
        f"counted per axis: {arguments.sigma_ct:g} mm of each marker beside the localizer's own error ({why}), "
        f"{arguments.sigma_ots:g} mm of each reading that states none (--sigma-ots)"
    )


def _targets(arguments: argparse.Namespace, fiducials: FiducialsDocument) -> Points:
    """Return where the error is to be predicted: the plan's points, then those of the command line."""
    import numpy as np

    from ronnaplan.documents.registration_made import target_names
    from ronnaplan.geometry import Points, as_points

    frame = fiducials.points.frame
    labels = target_names(len(arguments.target))
    places = as_points(arguments.target, "--target")
    if arguments.plan is not None:
        from ronnaplan.documents.plan import read_plan

        plan = read_plan(arguments.plan)
        fiducials.identity.require(plan.identity)
        labels = (*plan.points.labels, *labels)
        places = np.concatenate([plan.points.positions_mm, places])
    return Points.exact(places, labels, frame)


def _pair(text: str, ct: Sequence[str], readings: Sequence[str]) -> tuple[str, str]:
    """Return the two labels of ``text``, each of which may hold an equals sign: told by the labels that there are."""
    from ronnaplan.errors import UsageError

    splits = [
        (text[:k], text[k + 1 :]) for k, sign in enumerate(text) if sign == "=" and text[:k] and text[k + 1 :]
    ]
    if not splits:
        raise UsageError(f"--pair {text} is not of the form CT=READING, such as F1=3")
    there = [(marker, reading) for marker, reading in splits if marker in ct and reading in readings]
    if len(there) > 1:
        raise UsageError(f"--pair {text} names {len(there)} pairs, as labels hold '='; rename one of the markers")
    return (there or splits)[0]
