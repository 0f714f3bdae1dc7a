"""``ronnaplan robot pivot``: the tip of a tool from poses about a divot."""

from __future__ import annotations

import argparse

from ronnaplan.cli.output import tell, warn
from ronnaplan.cli.robot_options import RECORDED, calibrated_tool, with_output, with_tool

HELP = "Find a tool's tip from poses about a divot, with its covariance."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``robot pivot``."""
    parser.add_argument("recording", metavar="RECORDING", help=f"poses of the tool about a divot: {RECORDED}")
    with_tool(parser)
    with_output(parser, "pivot.json")


def run(arguments: argparse.Namespace) -> int:
    """Find the tip."""
    from ronnaplan.documents.revision import write_document
    from ronnaplan.documents.tool import pivot_document, read_pivot
    from ronnaplan.robot.pivot import calibrate_pivot
    from ronnaplan.robot.recorded import trackers_poses, uncounted
    from ronnaplan.text import runs
    from ronnaplan.tracking import read_recording

    recording = read_recording(arguments.recording)
    poses = trackers_poses(recording, arguments.tool)
    found = calibrate_pivot(list(poses.values()))
    notes = (*recording.notes, *uncounted(recording, arguments.tool), *found.doubts)
    warn(*notes)
    document = pivot_document(found, calibrated_tool(recording, arguments.tool), notes)
    write_document(arguments.output, document, read_pivot)
    x, y, z = found.tip_mm
    errors = [found.tip_covariance_mm2[axis, axis] ** 0.5 for axis in range(3)]
    slips = ", ".join(runs(list(poses), found.slipped.nonzero()[0]))
    counted = int(found.kept.sum())
    kept = f"{counted} of " if counted < len(poses) else ""
    tell(
        f"tip {x:.3f} {y:.3f} {z:.3f} mm, standard errors {errors[0]:.3f} {errors[1]:.3f} {errors[2]:.3f} mm",
        f"{found.rms_mm:.3f} mm RMS about the pivot over {kept}{len(poses)} poses"
        + (f"; left out as slipped: frames {slips}" if slips else "")
        + (f"; left out of a tool held still: {found.rested.sum()}" if found.rested.any() else ""),
    )
    return 0
