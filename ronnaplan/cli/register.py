"""``ronnaplan register``: markers of a scan and tracker readings, to the registration and its expected error."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from ronnaplan.cli.case_options import with_sigmas
from ronnaplan.cli.values import whole

if TYPE_CHECKING:
    from ronnaplan.registration.markers import MarkerRegistration
    from ronnaplan.tracking import Recording
    from ronnaplan.tracking.markers import MarkerReadings

MOST_WARNINGS = 5
"""Kinds of flagged readings that are told one by one; more are summed up."""

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
        help="the number of markers in both; a few less are given and named, more are refused",
    )
    number.add_argument("--at-least", type=whole(3), metavar="N", help="the number of markers in both, or more")
    parser.add_argument("--plan", metavar="PLAN", help="predict the error at this plan's entries and targets")
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
    from ronnaplan.documents.registration import read_registration, registration_document
    from ronnaplan.documents.registration_text import registration_text
    from ronnaplan.documents.revision import write_document
    from ronnaplan.errors import RefusedError
    from ronnaplan.registration.markers import register_markers
    from ronnaplan.tracking import find_markers, read_recording

    fiducials = read_fiducials(arguments.fiducials)
    known = tuple(_pair(text) for text in arguments.pair)
    targets = None
    if arguments.plan is not None:
        from ronnaplan.documents.plan import read_plan

        plan = read_plan(arguments.plan)
        plan.require_source(fiducials.points.frame, fiducials.source.voxel_sha256)
        targets = plan.points
    recording = read_recording(arguments.readings)
    found = find_markers(recording, sigma_mm=arguments.sigma_ots)
    for warning in (*recording.notes, *_left_out(recording), *_doubts(found)):
        print(f"ronnaplan: warning: {warning}", file=sys.stderr)
    registered = register_markers(
        fiducials.points,
        found.points,
        expected=arguments.expected,
        at_least=arguments.at_least,
        sigma_ct_mm=arguments.sigma_ct,
        known_pairs=known,
    )
    for warning in _moved(registered):
        print(f"ronnaplan: warning: {warning}", file=sys.stderr)
    document = registration_document(registered, fiducials.source, targets)
    print(registration_text(document), file=sys.stderr)
    write_document(arguments.output, document, read_registration)
    if document.status != "unique":
        raise RefusedError(document.reason)
    return 0


def _left_out(recording: Recording) -> list[str]:
    """Say which readings of the file were not used, and why."""
    flagged = recording.flagged()
    if len(flagged) > MOST_WARNINGS:
        return [f"{sum(flagged.values())} readings left out for {len(flagged)} reasons; see their status"]
    return [f"{count} reading{'s' * (count > 1)} left out: {reason}" for reason, count in sorted(flagged.items())]


def _doubts(found: MarkerReadings) -> list[str]:
    """Say what is doubtful about the markers, and which tracks of readings are no marker."""
    from ronnaplan.tracking.markers import MarkerFlag

    once = MarkerFlag.SINGLE_READING
    all_once = len(found.markers) > 1 and all(once in marker.flags for marker in found.markers)
    told = [f"all {len(found.markers)} markers were {once}"] if all_once else []
    told += [
        f"reading {marker.label}: {flag}"
        for marker in found.markers
        for flag in marker.flags
        if not (all_once and flag is once)
    ]
    return told + [
        f"{track.readings} readings near {_place(track.position_mm)} left out: {track.reason}"
        for track in found.rejected
    ]


def _moved(registered: MarkerRegistration) -> list[str]:
    """Name the markers that were left out because they lie beside the place that the others give them."""
    moved = [(registered.ct.labels[i], registered.ots.labels[j]) for i, j in registered.pairing.moved]
    return [
        f"marker {ct} and reading {ots} were left out: they lie side by side, as if the marker had moved"
        for ct, ots in moved
    ]


def _pair(text: str) -> tuple[str, str]:
    from ronnaplan.errors import UsageError

    ct, equals, reading = text.partition("=")
    if not (ct and equals and reading):
        raise UsageError(f"--pair {text} is not of the form CT=READING, such as F1=3")
    return ct, reading


def _place(position: object) -> str:
    import numpy as np

    return ", ".join(f"{value:.1f}" for value in np.asarray(position, dtype=float))
