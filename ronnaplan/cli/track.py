"""``ronnaplan track``: record a tracker's live stream over OpenIGTLink, and tell whether the patient has moved."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ronnaplan.cli.case_options import with_server, with_sigma_ots
from ronnaplan.cli.output import ended_gently, tell, warn
from ronnaplan.cli.values import seconds

if TYPE_CHECKING:
    from ronnaplan.documents.registration import RegistrationDocument
    from ronnaplan.tracking import Recording

MOST_TOLD = 40
"""Markers, and kinds of flagged readings, that are told one by one."""

MOST_JUDGED = 5000
"""Frames that are looked at for movement: four minutes at 20 Hz; of more, every so many, the last among them."""

HELP = "Record marker and tool readings from an OpenIGTLink server into a readings CSV."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    with_server(parser)
    parser.add_argument("--seconds", type=seconds, default=5.0, help="how long to record (default %(default)s)")
    parser.add_argument(
        "--registration", metavar="FILE", help="warn when markers have moved since this registration.json"
    )
    with_sigma_ots(parser)
    parser.add_argument("-o", "--output", metavar="FILE", help="readings CSV (default: standard output)")


@ended_gently()
def run(arguments: argparse.Namespace) -> int:
    """Record, write every reading, and say on standard error what was seen."""
    from ronnaplan.documents.files import check_target, write_result
    from ronnaplan.documents.registration import read_registration
    from ronnaplan.errors import InputError
    from ronnaplan.text import counted
    from ronnaplan.tracking import find_markers
    from ronnaplan.tracking.csv_file import write_csv
    from ronnaplan.tracking.openigtlink import record

    if arguments.output is not None:
        check_target(arguments.output)
    registered = read_registration(arguments.registration) if arguments.registration else None
    if registered is not None:
        registered.require_unique()
        registered.require_tracker()
    recording = record(arguments.host, arguments.port, seconds=arguments.seconds)
    write_result(arguments.output, write_csv(recording))
    warn(*recording.notes)
    flagged = recording.flagged()
    for reason, count in list(flagged.items())[:MOST_TOLD]:
        tell(f"ronnaplan: {counted(count, 'reading')} flagged: {reason}")
    if len(flagged) > MOST_TOLD:
        tell(f"ronnaplan: readings flagged for {len(flagged) - MOST_TOLD} more reasons")
    if registered is not None:
        tell(movement(recording, registered, arguments.sigma_ots))
    try:
        found = find_markers(recording, sigma_mm=arguments.sigma_ots)
    except InputError as error:
        warn(str(error))
        return 0
    tell(f"{counted(len(found.markers), 'marker')} in {counted(found.frames, 'frame')}")
    for marker in found.markers[:MOST_TOLD]:
        x, y, z = marker.position_mm
        doubts = "".join(f"; {flag}" for flag in marker.flags)
        tell(f"{marker.label:<12} {x:9.2f} {y:9.2f} {z:9.2f}  {counted(marker.readings, 'reading')}{doubts}")
    if len(found.markers) > MOST_TOLD:
        tell(f"and {len(found.markers) - MOST_TOLD} more")
    return 0


def movement(recording: Recording, registered: RegistrationDocument, sigma_mm: float) -> str:
    """Say in how many frames the registered markers rested or moved, and how they moved lastly.

    One reading errs by ``sigma_mm`` per axis, and by no less than those that were registered, which may be means.
    """
    from ronnaplan.registration import DriftStatus, drift_over_time
    from ronnaplan.tracking.frames import labelled_frames

    frames = labelled_frames(
        recording, registered.readings, sigma_mm=max(sigma_mm, registered.sigma_ots_mm or 0.0)
    )
    every = 1 + len(frames) // MOST_JUDGED
    drifts = drift_over_time(registered.readings, [points for _, points in frames[::-1][::every][::-1]])
    counts = {status: sum(drift.status is status for drift in drifts) for status in DriftStatus}
    lines = [f"{count} of {len(drifts)} frames: {status}" for status, count in counts.items() if count]
    if every > 1:
        lines.append(f"every {every}th of {len(frames)} frames was looked at")
    moved = [drift for drift in drifts if drift.status in (DriftStatus.PATIENT_MOVED, DriftStatus.MARKER_MOVED)]
    if moved:
        last = moved[-1]
        who = f"; loose: {' or '.join(last.loose)}" if last.loose else ""
        lines.append(f"warning: lastly moved by {last.shift_mm:.2f} mm and {last.rotation_deg:.2f} degrees{who}")
    return "\n".join(lines) or _nothing_seen(recording)


def _nothing_seen(recording: Recording) -> str:
    """Say why no frame tells whether the registered markers moved."""
    from ronnaplan.text import printable

    told = "warning: whether the head moved is not known: "
    if not recording.tools:
        return f"{told}no frame shows the registered markers"
    tools = printable(", ".join(recording.tool_names))
    return (
        f"{told}only poses of tools came ({tools}), and no points, which the registered markers are; have the tracker "
        "send these, too"
    )
